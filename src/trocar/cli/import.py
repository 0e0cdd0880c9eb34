"""Import a robot or an object as an arm or a prop that can be placed in a rig.

FILE is URDF (expand xacro first), SDF with one model, MJCF, or a mesh (OBJ, STL, PLY, glTF, DAE);
meshes are decomposed into convex pieces. The output is a folder with one TOML file and its meshes.
See docs/exports.md for the supported elements.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from pathlib import Path

from trocar.cli.arguments import add_json, add_overwrite, number
from trocar.cli.output import print_json, warn

SUMMARY = "import an arm or a prop from URDF, SDF, MJCF or a mesh"
ORDER = 170


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument("file", metavar="FILE", help="URDF, SDF, MJCF or mesh file")
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="output folder")
    parser.add_argument(
        "--as",
        dest="kind",
        choices=("arm", "prop"),
        help="import as arm or as prop (default: arm if it has movable joints)",
    )
    parser.add_argument("--name", default="", help="name (default: the name in FILE)")
    add_overwrite(parser, "existing files in DIR")
    add_json(parser)
    robot = parser.add_argument_group("robot files")
    robot.add_argument(
        "--package-path",
        action="append",
        default=[],
        metavar="DIR",
        help="search DIR for package:// files (repeatable)",
    )
    robot.add_argument(
        "--passive",
        default="",
        metavar="JOINT,...",
        help="passive joints, determined by the closed loops",
    )
    mesh = parser.add_argument_group("mesh files")
    mesh.add_argument(
        "--unit",
        default="m",
        choices=("m", "mm", "cm", "in"),
        help="length unit of the mesh (default: m)",
    )
    mesh.add_argument("--mass", type=number, metavar="KG", help="mass of the body")
    mesh.add_argument(
        "--hull", action="store_true", help="use the convex hull, without decomposition"
    )


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
        args.overwrite,
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
        f" {found.triangles} triangles, {found.pieces} collision geoms\nwritten to {found.file}"
    )
    return 0
