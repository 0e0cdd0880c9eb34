"""Overlays as TOML files: read, and written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.overlay_records import ClosureKind, ClosurePatch, FramePatch, Overlay
from trocar.descriptions.table import Table, parse_table, read_table
from trocar.descriptions.toml_text import key_text, value_text, write_whole

Array = NDArray[np.float64]

SCHEMA = 1
CLOSURES = ("parallelogram", "general")
HEADER = """\
# A calibrated robot's own geometry, laid over the description of its kind:
#   trocar sim --calibration THIS_FILE
# Lengths in metres, angles in radians; *_sigma_* are standard deviations. xyz and rpy place a
# frame (of a hinge: its axis) in its parent at coordinate 0; rpy turns about the parent's fixed
# axes x, y, z, rpy_sigma is of small turns about its own. point_a and point_b are a closing hinge
# on its two frames.
"""


def read_overlay(path: str | Path) -> Overlay:
    """Read an overlay.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    return _read(read_table(Path(path).expanduser()))


def parse_overlay(text: str, file: str) -> Overlay:
    """Read an overlay from its text; `file` is what messages call it.

    Raises:
        DescriptionError: as for `read_overlay`
    """
    return _read(parse_table(text, file))


def write_overlay(path: str | Path, overlay: Overlay) -> None:
    """Write an overlay; the file is there whole or not at all.

    Raises:
        InputError: numbers that are not finite, or a file that cannot be written
    """
    write_whole(Path(path).expanduser(), overlay_text(overlay))


def overlay_text(overlay: Overlay) -> str:
    """Return an overlay as the text of its file; numbers come back to the last bit.

    Raises:
        InputError: numbers that are not finite
    """
    lines = [HEADER]
    head = {"schema": SCHEMA, "arm": overlay.arm, "closure": overlay.closure}
    lines += _lines("", head)
    if overlay.warnings:
        lines += ["warnings = ["]
        lines += [f"    {value_text(text, 'warnings')}," for text in overlay.warnings]
        lines += ["]"]
    lines += _block("source", overlay.source) if overlay.source else []
    for name, patch in overlay.frames.items():
        entries = {"xyz_m": patch.xyz, "xyz_sigma_m": patch.xyz_sigma}
        entries |= {"rpy_rad": patch.rpy, "rpy_sigma_rad": patch.rpy_sigma}
        lines += _block(f"frames.{key_text(name)}", entries)
    for name, hinge in overlay.closures.items():
        entries = {"point_a_m": hinge.point_a, "point_a_sigma_m": hinge.point_a_sigma}
        entries |= {"point_b_m": hinge.point_b, "point_b_sigma_m": hinge.point_b_sigma}
        lines += _block(f"closures.{key_text(name)}", {**entries, "slides": hinge.slides})
    lines += _block("measured", overlay.measured) if overlay.measured else []
    return "\n".join(lines) + "\n"


def _block(name: str, entries: Any) -> list[str]:
    return ["", f"[{name}]", *_lines(name, entries)]


def _lines(where: str, entries: Any) -> list[str]:
    """Return `key = value` of every entry that is there."""
    return [
        f"{key_text(key)} = {value_text(value, f'{where}.{key}'.strip('.'))}"
        for key, value in entries.items()
        if value is not None
    ]


def _read(table: Table) -> Overlay:
    if table.raw("schema") != SCHEMA:
        raise table.fail(
            "schema", f"got {table.raw('schema')!r}; allowed: {SCHEMA}, of a calibration's overlay"
        )
    arm = table.text("arm")
    closure = table.text("closure", "parallelogram", allowed=CLOSURES)
    warnings = table.texts("warnings")
    source = table.optional_table("source")
    about = {key: source.text(key) for key in source.entries()}
    rows, hinges = table.optional_table("frames"), table.optional_table("closures")
    frames = {name: _read_frame(rows.table(name)) for name in rows.entries()}
    closures = {name: _read_closure(hinges.table(name)) for name in hinges.entries()}
    measured = table.raw("measured", {})
    if not isinstance(measured, dict):
        raise table.fail("measured", f"got {measured!r}; allowed: a table")
    table.done()
    return Overlay(
        arm,
        cast(ClosureKind, closure),
        frames,
        closures,
        cast(dict[str, Any], measured),
        about,
        warnings,
        table.file,
    )


def _read_frame(row: Table) -> FramePatch:
    patch = FramePatch(
        row.vector("xyz", 3, "length"),
        row.vector("rpy", 3, "angle"),
        _read_sigma(row, "xyz_sigma", "length"),
        _read_sigma(row, "rpy_sigma", "angle"),
    )
    row.done()
    return patch


def _read_closure(row: Table) -> ClosurePatch:
    patch = ClosurePatch(
        row.vector("point_a", 3, "length"),
        row.vector("point_b", 3, "length"),
        _read_sigma(row, "point_a_sigma", "length"),
        _read_sigma(row, "point_b_sigma", "length"),
        row.flag("slides", False),
    )
    row.done()
    return patch


def _read_sigma(row: Table, name: str, dimension: str) -> Array | None:
    if not row.has(name, dimension):
        return None
    sigma = row.vector(name, 3, dimension)
    if (sigma < 0.0).any():
        raise row.fail(name, f"got {sigma.tolist()}; allowed: 0 or more")
    return sigma
