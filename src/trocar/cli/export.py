"""Export an arm or a rig for other simulators: a folder with the model, its meshes and a README.

If an arm and a rig have the same name (psm, ecm), the arm is exported; give the path of the rig's
file to export the rig. If the export fails, nothing is written. See docs/exports.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_calibrations, add_json, add_overwrite, options
from trocar.cli.output import print_result, progress_steps, warn

if TYPE_CHECKING:
    from trocar.formats.exports import Export

SUMMARY = "export an arm or a rig as URDF, SDF or MJCF"
ORDER = 160

MESH_FILES = (".obj", ".stl")


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        subject ARM|RIG           built-in arm or rig (see trocar list) or TOML file
        --format FORMAT required  output format: urdf, sdf or mjcf
        -o,--out DIR required     output folder, new or empty
        --tool [ARM=]TOOL ...     mount another tool: built-in, TOML file, or "none"; ARM= selects
                                  an arm of a rig (repeatable)
    """)  # fmt: skip
    add_calibrations(parser)
    parser.add_argument(
        "--package", default="", metavar="NAME", help="urdf: write a ROS package NAME"
    )
    options(parser, """
        --fit-tip              urdf of a calibrated arm: add helper joints that fit the chain to its
                               tip
        --sdf-version V = 1.9  sdf: format version, 1.7, 1.9 or 1.11
    """)  # fmt: skip
    add_overwrite(parser, "existing files in DIR")
    add_json(parser)


def run(args: Namespace) -> int:
    """Export, and print what was written."""
    from trocar.formats.exports import ExportOptions, export, find_rig

    rig = find_rig(args.subject, args.tool, args.calibration or ())
    options = ExportOptions(args.package, args.fit_tip, args.sdf_version)
    with progress_steps() as watch:
        watch(f"exporting {args.subject} as {args.format}")
        done = export(rig, args.format, args.out, options, overwrite=args.overwrite)
    for text in done.warnings:
        warn(text)
    print_result(args, done, lambda: _report(done))
    return 0


def _report(done: Export) -> str:
    meshes = [name for name in done.files if name.endswith(MESH_FILES)]
    beside = {name.rpartition("/")[0] for name in meshes}
    files = [f"  {n}" for n in done.files if n.rpartition("/")[0] not in beside or "/" not in n]
    more = f"  and {len(meshes)} meshes, {done.triangles} visual triangles"
    head = f"{done.folder}: {done.format}, {done.links} links, {done.joints} joints"
    return "\n".join([head, *files, *([more] if meshes else [])])
