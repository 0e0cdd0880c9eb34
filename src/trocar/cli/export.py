"""Export an arm or a rig for other simulators: a folder with the model, its meshes and a README.

If an arm and a rig have the same name (psm, ecm), the arm is exported; give the path of the rig's
file to export the rig. If the export fails, nothing is written. See docs/exports.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_calibrations, add_json, add_overwrite, options
from trocar.cli.output import print_result, progress_steps, warn

if TYPE_CHECKING:
    from trocar.descriptions import RigDescription
    from trocar.formats.export import Export

SUMMARY = "export an arm or a rig as URDF, SDF or MJCF"
ORDER = 160

MESH_FILES = (".obj", ".stl")
#: Size of the picture [px]. Source: our own choice; Menagerie's READMEs show theirs 400 px wide.
PICTURE = (800, 600)


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    from trocar.formats.format import formats

    written = [name for name, one in formats().items() if one.write is not None]
    options(parser, f"""
        subject ARM|RIG           built-in arm or rig (see trocar list) or TOML file
        --format FORMAT required  output format: {either(written)}
        -o,--out DIR required     output folder, new or empty
        --tool [ARM=]TOOL ...     mount another tool: built-in, TOML file, or "none"; ARM= selects
                                  an arm of a rig (repeatable)
    """)  # fmt: skip
    add_calibrations(parser)
    _add_format_options(parser)
    add_overwrite(parser, "existing files in DIR")
    add_json(parser)


def _add_format_options(parser: ArgumentParser) -> None:
    from trocar.formats.format import formats

    for one in formats().values():
        if one.options:
            options(parser, one.options)


def either(names: list[str]) -> str:
    """Return names as an enumeration: "urdf, sdf or mjcf"."""
    return " or ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def run(args: Namespace) -> int:
    """Export, and print the files."""
    from trocar.formats.export import export, find_rig

    rig = find_rig(args.subject, args.tool, args.calibration or ())
    parser = ArgumentParser(add_help=False)
    _add_format_options(parser)
    unset = vars(parser.parse_args([]))
    chosen = {n: getattr(args, n) for n, value in unset.items() if getattr(args, n) != value}
    with progress_steps() as watch:
        watch(f"exporting {args.subject} as {args.format}")
        done = export(rig, args.format, args.out, chosen, draw=_draw, overwrite=args.overwrite)
    for text in done.warnings:
        warn(text)
    print_result(args, done, lambda: _report(done))
    return 0


def _draw(rig: RigDescription, path: Path) -> None:
    from trocar.rendering.stills import write_pictures

    (drawn,) = write_pictures(rig, path.parent, ("three_quarter",), PICTURE)
    drawn.rename(path)


def _report(done: Export) -> str:
    meshes = [name for name in done.files if name.endswith(MESH_FILES)]
    beside = {name.rpartition("/")[0] for name in meshes}
    files = [f"  {n}" for n in done.files if n.rpartition("/")[0] not in beside or "/" not in n]
    more = f"  and {len(meshes)} meshes, {done.triangles} visual triangles"
    head = f"{done.folder}: {done.format}, {done.links} links, {done.joints} joints"
    return "\n".join([head, *files, *([more] if meshes else [])])
