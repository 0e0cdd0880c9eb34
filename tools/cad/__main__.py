"""Draw the links as solids: triangles to look at, convex pieces that touch, and mass properties.

DIR gets a folder for each set (psm, ecm, suj, mtm, tools, cart, table) with OBJ files in
millimetres and solids.toml. Needs the extra `cad`: pip install 'trocar[cad]'.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence

from trocar.errors import InputError, MissingExtraError, TrocarError


def main(words: Sequence[str] | None = None) -> int:
    """Draw sets of solids, print a line a link, and return the exit status."""
    parser = ArgumentParser(
        "python -m tools.cad", description=__doc__, formatter_class=RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--out", metavar="DIR", required=True, help="where the sets go")
    parser.add_argument(
        "--only", metavar="SET", action="append", default=[], help="this set; may be repeated"
    )
    parser.add_argument(
        "--calibration", metavar="OVERLAY", help="a calibrated robot in place of the nominal one"
    )
    args = parser.parse_args(words)
    try:
        return _draw(args.out, args.only, args.calibration)
    except TrocarError as error:
        print(f"tools.cad: error: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1


def _draw(out: str, only: Sequence[str], calibration: str | None) -> int:
    try:
        from tools.cad.sets import make_solids
    except ImportError as error:
        raise MissingExtraError("build123d", "cad", "drawing solids") from error
    for name, link in make_solids(out, only, calibration):
        seen = sum(len(piece.faces) for piece in link.visual)
        touches = sum(len(piece.faces) for piece in link.convex)
        print(
            f"{name}/{link.name}: {seen} triangles to see, {touches} to touch,"
            f" {link.weight.volume * 1e-3:.4g} cm3"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
