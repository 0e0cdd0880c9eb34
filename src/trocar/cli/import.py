"""Import a robot or an object as an arm or a prop that can be placed in a rig.

FILE is URDF or xacro, SDF with one model, MJCF, or a mesh (OBJ, STL, PLY, glTF, DAE); meshes are
decomposed into convex pieces. Colours, units and up axes are those of the files. The output is a
folder with one TOML file and its meshes.
See docs/import.md for the supported elements.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from trocar.cli.arguments import add_json, add_overwrite, allow, options
from trocar.cli.export import either
from trocar.cli.output import print_json, progress_steps, warn
from trocar.errors import InputError

SUMMARY = "import an arm or a prop from URDF, SDF, MJCF or a mesh"
ORDER = 170


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, f"""
        file FILE                 {either([*_read(), "mesh file"])}
        -o,--output DIR required  output folder
        --as arm|prop as kind     import as arm or as prop (default: arm if it has movable joints)
    """)  # fmt: skip
    parser.add_argument("--name", default="", help="name (default: the name in FILE)")
    add_overwrite(parser, "existing files in DIR")
    add_json(parser)
    options(parser, """
        --hull      collide as convex hulls, without decomposition
        --up x|y|z  up axis of meshes (default: the files' own, else z)
    """)  # fmt: skip
    robot = parser.add_argument_group("robot files")
    options(robot, """
        --package-path DIR ...  search DIR for package:// and $(find) (repeatable)
        --arg NAME=VALUE ...    argument of a xacro file (repeatable)
    """)  # fmt: skip
    robot.add_argument(
        "--passive",
        default="",
        metavar="JOINT,...",
        help="passive joints, determined by the closed loops",
    )
    mesh = parser.add_argument_group("mesh files")
    options(mesh, """
        --unit m|mm|cm|in  length unit of the mesh (default: the file's own, else m)
        --mass KG:number   mass of the body
        --open repair|draw as open_as
                           import a mesh that is not closed: repair it and decompose it, or draw it
                           without contact
    """)  # fmt: skip


def _read() -> list[str]:
    from trocar.formats.format import formats

    return [name.upper() for name, one in formats().items() if one.read is not None]


def _argument(text: str) -> tuple[str, str]:
    name, mark, value = text.partition("=")
    if not name or not mark:
        raise InputError(f"--arg: got {text!r}; allowed: NAME=VALUE")
    return name, value


def run(args: Namespace) -> int:
    """Read, write, print."""
    from trocar.formats.importing import ImportOptions, import_file
    from trocar.formats.meshes import SUFFIXES

    if Path(args.file).suffix.lower() in SUFFIXES:
        allow(args, f"with {either(_read())}", "package_path", "passive", "arg")
    else:
        allow(args, "with a mesh", "unit", "mass", "open_as")
    options = ImportOptions(
        args.name,
        args.kind,
        args.unit or "",
        args.mass,
        args.hull,
        tuple(Path(folder) for folder in args.package_path),
        tuple(name.strip() for name in args.passive.split(",") if name.strip()),
        args.overwrite,
        args.open_as or "",
        args.up or "",
        tuple(_argument(text) for text in args.arg),
    )
    with progress_steps() as watch:
        watch(f"importing {args.file}")
        found = import_file(args.file, args.output, options)
    for text in found.warnings:
        warn(text)
    if args.json:
        print_json(found)
        return 0
    size = " x ".join(f"{edge:.3g}" for edge in found.size)
    joints = f", joints {', '.join(found.joints)}" if found.joints else ""
    print(
        f"{found.kind} {found.name}: {found.links} links{joints}; {size} m, {found.mass:.4g} kg,"
        f" {found.triangles} triangles, {found.pieces} collision geoms\nwritten to {found.file}"
    )
    return 0
