"""A robot or an object from another tool's file, as an arm or a prop that a rig can place.

Reads URDF (after xacro), SDF of one model, MJCF, and meshes (OBJ, STL, PLY, glTF, DAE), which are
taken apart into convex pieces. Writes a folder with one TOML file and its meshes.
docs/exports.md says what comes along and what does not.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from pathlib import Path

from trocar.cli.arguments import add_json, number
from trocar.cli.output import print_json, warn


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument("file", metavar="FILE", help="URDF, SDF, MJCF, or a mesh")
    parser.add_argument(
        "-o", "--output", required=True, metavar="DIR", help="the folder that is written"
    )
    parser.add_argument(
        "--as", dest="kind", choices=("arm", "prop"), help="default: an arm where joints move"
    )
    parser.add_argument("--name", default="", help="default: the name in the file")
    parser.add_argument(
        "--unit", default="m", choices=("m", "mm", "cm", "in"), help="of a mesh; default: m"
    )
    parser.add_argument("--mass", type=number, metavar="KG", help="of a mesh")
    parser.add_argument("--hull", action="store_true", help="take a mesh's convex hull")
    parser.add_argument(
        "--package-path", action="append", default=[], metavar="DIR", help="where package:// looks"
    )
    parser.add_argument(
        "--passive", default="", metavar="JOINT,...", help="joints that loops determine"
    )
    parser.add_argument("--force", action="store_true", help="replace what has the same name")
    add_json(parser)


def run(args: Namespace) -> int:
    """Read, write, print."""
    from trocar.apps.importers import Options, import_file

    options = Options(
        args.name,
        args.kind,
        args.unit,
        args.mass,
        args.hull,
        tuple(Path(folder) for folder in args.package_path),
        tuple(name.strip() for name in args.passive.split(",") if name.strip()),
        args.force,
    )
    found = import_file(args.file, args.output, options)
    for text in found.warnings:
        warn(text)
    if args.json:
        print_json(asdict(found))
        return 0
    joints = f", joints {', '.join(found.joints)}" if found.joints else ""
    print(
        f"{found.kind} {found.name}: {found.links} links{joints}; {found.mass:.4g} kg,"
        f" {found.triangles} triangles, {found.pieces} colliding pieces\nwritten to {found.file}"
    )
    return 0
