"""Overlays as TOML files: read, and written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.overlay_records import ClosureKind, ClosurePatch, FramePatch, Overlay
from trocar.descriptions.table import Table, parse_table, read_table, toml_text
from trocar.errors import InputError

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
    """Write an overlay; until the file is whole, what was there before stays.

    Raises:
        InputError: numbers that are not finite, or a file that cannot be written
    """
    text, path = overlay_text(overlay), Path(path).expanduser()
    beside = ""
    try:
        handle, beside = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(beside, 0o666 & ~umask)
        os.replace(beside, path)
    except OSError as problem:
        if beside:
            Path(beside).unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written: {problem.strerror or problem}") from problem


def overlay_text(overlay: Overlay) -> str:
    """Return an overlay as the text of its file; numbers come back to the last bit.

    Raises:
        InputError: numbers that are not finite
    """
    frames = {
        name: {
            "xyz_m": patch.xyz,
            "xyz_sigma_m": patch.xyz_sigma,
            "rpy_rad": patch.rpy,
            "rpy_sigma_rad": patch.rpy_sigma,
        }
        for name, patch in overlay.frames.items()
    }
    closures = {
        name: {
            "point_a_m": hinge.point_a,
            "point_a_sigma_m": hinge.point_a_sigma,
            "point_b_m": hinge.point_b,
            "point_b_sigma_m": hinge.point_b_sigma,
            "slides": hinge.slides,
        }
        for name, hinge in overlay.closures.items()
    }
    document = {
        "schema": SCHEMA,
        "arm": overlay.arm,
        "closure": overlay.closure,
        "warnings": overlay.warnings or None,
        "source": overlay.source or None,
        "frames": frames or None,
        "closures": closures or None,
        "measured": overlay.measured or None,
    }
    return f"{HEADER}\n{toml_text(document)}"


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
