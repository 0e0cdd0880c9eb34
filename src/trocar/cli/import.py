"""Import a robot or an object as an arm or a prop that can be placed in a rig.

FILE is URDF (expand xacro first), SDF with one model, MJCF, or a mesh (OBJ, STL, PLY, glTF, DAE);
meshes are decomposed into convex pieces. The output is a folder with one TOML file and its meshes.
See docs/import.md for the supported elements.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from trocar.cli.arguments import add_json, add_overwrite, allow, options
from trocar.cli.export import either
from trocar.cli.output import print_json, progress_steps, warn

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
    robot = parser.add_argument_group("robot files")
    options(robot, """
        --package-path DIR ...  search DIR for package:// files (repeatable)
    """)  # fmt: skip
    robot.add_argument(
        "--passive",
        default="",
        metavar="JOINT,...",
        help="passive joints, determined by the closed loops",
    )
    mesh = parser.add_argument_group("mesh files")
    options(mesh, """
        --unit m|mm|cm|in = m  length unit of the mesh
        --mass KG:number       mass of the body
        --hull                 use the convex hull, without decomposition
    """)  # fmt: skip


def _read() -> list[str]:
    from trocar.formats.format import formats

    return [name.upper() for name, one in formats().items() if one.read is not None]


def run(args: Namespace) -> int:
    """Read, write, print."""
    from trocar.formats.importing import ImportOptions, import_file
    from trocar.formats.meshes import SUFFIXES

    if Path(args.file).suffix.lower() in SUFFIXES:
        allow(args, f"with {either(_read())}", "package_path", "passive")
    else:
        allow(args, "with a mesh", "unit", "mass", "hull")
    options = ImportOptions(
        args.name,
        args.kind,
        args.unit,
        args.mass,
        args.hull,
        tuple(Path(folder) for folder in args.package_path),
        tuple(name.strip() for name in args.passive.split(",") if name.strip()),
        args.overwrite,
    )
    with progress_steps() as watch:
        watch(f"importing {args.file}")
        found = import_file(args.file, args.output, options)
    for text in found.warnings:
        warn(text)
    if args.json:
        print_json(found)
        return 0
    joints = f", joints {', '.join(found.joints)}" if found.joints else ""
    print(
        f"{found.kind} {found.name}: {found.links} links{joints}; {found.mass:.4g} kg,"
        f" {found.triangles} triangles, {found.pieces} collision geoms\nwritten to {found.file}"
    )
    return 0
