"""Write an arm or a rig for other simulators: a folder with the model, its meshes and a README.

A name that an arm and a rig share (psm, ecm) is the arm, alone and without a table; the path of
the rig's file exports the rig. Nothing is written unless all of it is.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_calibrations, add_json
from trocar.cli.output import print_json, warn

if TYPE_CHECKING:
    from trocar.apps.exports import Export

MESH_FILES = (".obj", ".stl")


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument(
        "subject", metavar="ARM|RIG", help="a built-in arm or rig (trocar list), or a TOML file"
    )
    parser.add_argument("--format", required=True, metavar="FORMAT", help="urdf, sdf or mjcf")
    parser.add_argument(
        "-o", "--out", required=True, metavar="DIR", help="a new folder, or an empty one"
    )
    parser.add_argument(
        "--tool",
        action="append",
        default=[],
        metavar="[ARM=]TOOL",
        help='another tool, its TOML file, or "none"; of a rig for this arm; may be repeated',
    )
    add_calibrations(parser)
    parser.add_argument(
        "--package", default="", metavar="NAME", help="URDF: a ROS package of this name"
    )
    parser.add_argument(
        "--sdf-version", default="1.9", metavar="V", help="SDF: 1.9 (default), 1.7 or 1.11"
    )
    parser.add_argument(
        "--force", action="store_true", help="replace what DIR has under the same names"
    )
    add_json(parser)


def run(args: Namespace) -> int:
    """Export, and say what was written."""
    from trocar.apps.exports import Options, export, find_rig

    rig = find_rig(args.subject, args.tool, args.calibration or ())
    options = Options(args.package, args.sdf_version)
    done = export(rig, args.format, args.out, options, force=args.force)
    for text in done.warnings:
        warn(text)
    if args.json:
        print_json({**asdict(done), "folder": str(done.folder)})
    else:
        print(_report(done))
    return 0


def _report(done: Export) -> str:
    meshes = [name for name in done.files if name.endswith(MESH_FILES)]
    beside = {name.rpartition("/")[0] for name in meshes}
    files = [f"  {n}" for n in done.files if n.rpartition("/")[0] not in beside or "/" not in n]
    more = f"  and {len(meshes)} meshes, {done.triangles} triangles to be seen"
    head = f"{done.folder}: {done.format}, {done.links} links, {done.joints} joints"
    return "\n".join([head, *files, *([more] if meshes else [])])
