"""Draw the links as solids: triangles to look at, convex pieces that touch, and mass properties.

DIR gets a folder for each set (psm, ecm, suj, mtm, tools, cart, table) with OBJ files in
millimetres and solids.toml. Needs the extra `cad`: pip install 'trocar[cad]'.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_calibration

if TYPE_CHECKING:
    from trocar.apps.cad.draw import DrawnLink


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument("-o", "--out", metavar="DIR", required=True, help="where the sets go")
    parser.add_argument(
        "--only", metavar="SET", action="append", default=[], help="this set; may be repeated"
    )
    add_calibration(parser)


def run(args: Namespace) -> int:
    """Draw, and print a line a link."""
    from trocar.apps.cad.library import need_library

    need_library()
    from trocar.apps.cad.make import make_solids

    make_solids(Path(args.out), args.only, args.calibration, _tell)
    return 0


def _tell(name: str, link: DrawnLink) -> None:
    seen = sum(len(piece.faces) for piece in link.visual)
    touches = sum(len(piece.faces) for piece in link.convex)
    print(
        f"{name}/{link.name}: {seen} triangles to see, {touches} to touch,"
        f" {link.weight.volume * 1e-3:.4g} cm3"
    )
