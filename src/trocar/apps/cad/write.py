"""Write drawn links: an OBJ file a piece, and solids.toml, which says what they weigh."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.cad.draw import DrawnLink, Piece
from trocar.descriptions.table import toml_text

Array = NDArray[np.float64]

#: Digits that a mass property keeps.
SIGNIFICANT = 6
HEAD = """\
# Written by `trocar cad` from the arm's description; data/solids/README.md says how.
# Each link in the frame of the description that it moves with; gyration_mm2 is the inertia of 1 kg
# about the centre of mass: xx, yy, zz, xy, xz, yz.
"""


def write_set(folder: Path, links: Sequence[DrawnLink]) -> None:
    """Write a set of links into a folder; what it held before is gone once all is written.

    Raises:
        OSError: the folder cannot be written
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        beside.chmod(0o755)
        for link in links:
            for piece in (*link.visual, *link.convex):
                (beside / piece.file).write_text(obj_text(piece), encoding="ascii")
        (beside / "solids.toml").write_text(solids_text(links), encoding="utf-8")
        if folder.exists():
            shutil.rmtree(folder)
        beside.rename(folder)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def obj_text(piece: Piece) -> str:
    """Return a piece as an OBJ file in millimetres; normal k is that of corner k."""
    lines = [f"v {_numbers(row)}" for row in piece.vertices]
    if piece.normals is None:
        lines += [f"f {a} {b} {c}" for a, b, c in (piece.faces + 1).tolist()]
    else:
        lines += [f"vn {_numbers(row)}" for row in piece.normals]
        lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (piece.faces + 1).tolist()]
    return "\n".join(lines) + "\n"


def solids_text(links: Sequence[DrawnLink]) -> str:
    """Return what solids.toml says of these links."""
    return f"{HEAD}\n{toml_text({link.name: _section(link) for link in links})}"


def _section(link: DrawnLink) -> dict[str, Any]:
    turn, weight = link.weight.gyration, link.weight
    moments = [turn[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    least = 1e-7 * float(np.trace(turn))
    return {
        "frame": link.frame,
        "volume_mm3": _short(weight.volume),
        "com_mm": [_short(v, 1e-3) for v in weight.com],
        "gyration_mm2": [_short(v, least) for v in moments],
        "lower_mm": [_short(v, 1e-3) for v in link.lower],
        "upper_mm": [_short(v, 1e-3) for v in link.upper],
        "visual": [_row(piece) for piece in link.visual],
        "convex": [_row(piece) for piece in link.convex],
    }


def _row(piece: Piece) -> dict[str, Any]:
    material = {"material": piece.material} if piece.material else {}
    return {"file": piece.file, **material, "triangles": len(piece.faces)}


def _short(value: float, least: float = 0.0) -> float:
    """Round to the digits that are kept; what is nothing but rounding becomes 0."""
    return 0.0 if abs(value) < least else float(f"{value:.{SIGNIFICANT}g}")


def _numbers(row: Array) -> str:
    return " ".join(f"{value:.3f}".rstrip("0").rstrip(".") for value in row.tolist())
