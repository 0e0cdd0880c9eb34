"""The sets of solids: which are drawn together, of which arms, how finely, and their files."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.cad.links import DrawnLink, Fineness, Link, Piece, drawn
from trocar.descriptions import names
from trocar.descriptions.calibrated import as_overlay
from trocar.descriptions.catalogue import load_mechanism
from trocar.descriptions.overlay_records import Overlay
from trocar.descriptions.table import toml_text
from trocar.errors import InputError, UnknownNameError


@dataclass(frozen=True)
class SolidSet:
    """Solids whose files lie in one folder.

    Attributes:
        name: of the folder, and of the module that draws them
        fineness: of what is looked at
        arms: (arm, tool) that are drawn, each of which may have links that another has too; empty
            where the solids stand in the world
    """

    name: str
    fineness: Fineness
    arms: tuple[tuple[str, str], ...] = ()

    def links(self, overlay: Overlay | None = None) -> tuple[Link, ...]:
        """Return every link, drawn once, on the axes of the nominal or of a calibrated arm.

        Raises:
            InputError: the overlay is for none of the arms
        """
        draw = import_module(f"tools.cad.{self.name}").links
        if not self.arms:
            return tuple(draw())
        found: dict[str, Link] = {}
        for arm, tool in self.arms:
            if overlay is None or overlay.arm == arm:
                for link in draw(load_mechanism(arm, tool, overlay)):
                    found.setdefault(link.name, link)
        return tuple(found.values())


def solid_sets() -> dict[str, SolidSet]:
    """Return the sets by name.

    The fineness is our own choice: the full cart stays under 120,000 triangles.
    """
    each = (
        SolidSet("psm", Fineness(0.3, 1.0), (("psm", "none"),)),
        SolidSet("ecm", Fineness(0.3, 1.0), (("ecm", "none"),)),
        SolidSet(
            "suj",
            Fineness(0.5, 2.0),
            tuple((f"suj_{arm}", "none") for arm in ("psm1", "psm2", "psm3", "ecm")),
        ),
        SolidSet("si", Fineness(0.3, 1.0), (("psm_si", "none"), ("ecm_si", "none"))),
        SolidSet(
            "suj_si",
            Fineness(0.5, 2.0),
            tuple((f"suj_si_{arm}", "none") for arm in ("psm1", "psm2", "psm3", "ecm")),
        ),
        SolidSet("mtm", Fineness(0.3, 1.0), (("mtmr", "none"), ("mtml", "none"))),
        SolidSet("tools", Fineness(0.03, 0.1), tuple(("psm", t) for t in names("tools"))),
        SolidSet("cart", Fineness(1.0, 4.0)),
        SolidSet("cart_si", Fineness(1.0, 4.0)),
        SolidSet("table", Fineness(1.0, 4.0)),
    )
    return {one.name: one for one in each}


def sets_of(overlay: Overlay) -> tuple[str, ...]:
    """Return the sets that a calibrated arm has its own of.

    Raises:
        InputError: of this arm nothing is drawn
    """
    sets = solid_sets()
    found = [name for name, one in sets.items() if (overlay.arm, "none") in one.arms]
    if not found:
        known = ", ".join(arm for one in sets.values() for arm, _ in one.arms)
        raise InputError(f"{overlay.file}: a calibration of {overlay.arm!r}; allowed: {known}")
    return tuple(found)


Array = NDArray[np.float64]

#: Digits that a mass property keeps.
SIGNIFICANT = 6
HEAD = """\
# Written by `make cad` from the arm's description; data/solids/README.md says how.
# Each link in the frame of the description that it moves with; gyration_mm2 is the inertia of 1 kg
# about the centre of mass: xx, yy, zz, xy, xz, yz.
"""


def write_set(folder: Path, links: Sequence[DrawnLink]) -> None:
    """Write a set of links into a folder, in place of what it held.

    Raises:
        InputError: the folder cannot be written
    """
    files = {piece.file: obj_text(piece) for link in links for piece in link.visual + link.convex}
    files["solids.toml"] = solids_text(links)
    try:
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as problem:
        raise InputError(f"{folder}: cannot be written: {problem.strerror}") from problem


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


def make_solids(
    folder: str | Path, only: Sequence[str] = (), calibration: str | Path | None = None
) -> Iterator[tuple[str, DrawnLink]]:
    """Draw sets of solids, write each into a folder of its name, and yield (set, link) of each.

    Args:
        folder: contains the sets' folders
        only: these sets; all when empty
        calibration: an overlay: draw the calibrated robot's own links in place of the nominal

    Raises:
        UnknownNameError: no such set
        InputError: the folder cannot be written, or the overlay is broken or for no arm of the set
    """
    sets = solid_sets()
    overlay = None if calibration is None else as_overlay(calibration)
    possible = tuple(sets) if overlay is None else sets_of(overlay)
    for name in only:
        if name not in possible:
            raise UnknownNameError("set of solids", name, possible)
    for one in [sets[name] for name in only or possible]:
        links: list[DrawnLink] = []
        for link in one.links(overlay):
            links.append(drawn(link, one.fineness))
            yield one.name, links[-1]
        write_set(Path(folder) / one.name, links)
