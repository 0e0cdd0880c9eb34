"""Overlays: a calibrated robot's own geometry, read, written, and laid over its description."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.overlay_records import (
    ClosureKind,
    ClosurePatch,
    FramePatch,
    Overlay,
)
from trocar.descriptions.pins import PIN_ROTOR_KG, pin_body, pin_frame, pin_name, pinned
from trocar.descriptions.records import ArmDescription
from trocar.descriptions.table import Table, parse_table, read_table
from trocar.descriptions.toml_text import key_text, value_text, write_whole
from trocar.errors import DescriptionError, InputError, LoopError, UnknownNameError
from trocar.geometry.rotations import matrix_from_rpy, rpy_from_matrix
from trocar.geometry.se3 import transform
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import (
    PARALLELOGRAM_TOLERANCE_M,
    coupled_coordinates,
    gaps,
    loops_are_parallelograms,
)
from trocar.kinematics.mechanism import Closure, Frame, Mechanism

__all__ = [
    "ClosurePatch",
    "FramePatch",
    "Overlay",
    "apply_overlay",
    "closure_patch",
    "frame_patch",
    "overlay_text",
    "parse_overlay",
    "patched_frame",
    "read_overlay",
    "write_overlay",
]

Array = NDArray[np.float64]

SCHEMA = 1
CLOSURES = ("parallelogram", "general")
#: Joint positions at which the loops must close, spread over the range of each joint.
SAMPLES = 33
HEADER = """\
# A calibrated robot's own geometry, laid over the description of its kind:
#   trocar sim --calibration THIS_FILE
# Lengths in metres, angles in radians; *_sigma_* are standard deviations. xyz and rpy place a
# frame (of a hinge: its axis) in its parent at coordinate 0; rpy turns about the parent's fixed
# axes x, y, z, rpy_sigma is of small turns about its own. point_a and point_b are a closing hinge
# on its two frames.
"""


# ------------------------------------------------------------------ files


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


# ------------------------------------------------------------------ laying it over


def frame_patch(frame: Frame) -> FramePatch:
    """Return the patch that leaves a frame where it is, to rounding."""
    return FramePatch(frame.before[:3, 3].copy(), rpy_from_matrix(frame.before[:3, :3]))


def closure_patch(closure: Closure, slides: bool = False) -> ClosurePatch:
    """Return the patch that leaves a closing hinge where it is."""
    return ClosurePatch(closure.point_a.copy(), closure.point_b.copy(), slides=slides)


def patched_frame(frame: Frame, patch: FramePatch) -> Frame:
    """Return a frame that stands where a patch has it."""
    return replace(frame, before=transform(matrix_from_rpy(*patch.rpy), patch.xyz))


def apply_overlay(arm: ArmDescription, overlay: Overlay) -> ArmDescription:
    """Return the calibrated robot; the description that it is laid over stays as it is.

    Raises:
        InputError: the overlay is for another arm, names what the arm does not have, or holds
            numbers that are not finite
        DescriptionError: its loops do not close over the joints' range
    """
    where = overlay.file or "overlay"
    if overlay.arm != arm.name:
        raise InputError(
            f"{where}: is a calibration of {overlay.arm!r}; it cannot be laid over {arm.name!r}"
        )
    if arm.overlay is not None:
        raise InputError(f"{where}: {arm.name} carries the calibration {arm.overlay.file} already")
    _check_numbers(overlay, where)
    mechanism = arm.mechanism
    _check_known("frame", overlay.frames, mechanism.frame_index, where)
    _check_known("closure", overlay.closures, [c.name for c in mechanism.closures], where)
    if not overlay.frames and not overlay.closures:
        return replace(arm, overlay=overlay)
    frames = [
        patched_frame(f, overlay.frames[f.name]) if f.name in overlay.frames else f
        for f in mechanism.frames
    ]
    closures: list[Closure] = []
    pins: list[str] = []
    for closure in mechanism.closures:
        patch = overlay.closures.get(closure.name)
        if patch is None:
            closures.append(closure)
            continue
        moved = replace(closure, point_a=patch.point_a, point_b=patch.point_b)
        if patch.slides:
            pins.append(closure.name)
            frames.append(pin_frame(moved))
        closures.append(pinned(moved) if patch.slides else moved)
    changed = replace(mechanism, frames=tuple(frames), closures=tuple(closures))
    _check_closed(changed, overlay, where)
    return replace(
        arm,
        mechanism=changed,
        bodies=(*arm.bodies, *(pin_body(name, arm.name) for name in pins)),
        rotor={**arm.rotor, **{pin_name(name): PIN_ROTOR_KG for name in pins}},
        overlay=overlay,
    )


def _check_known(kind: str, got: Iterable[str], known: Iterable[str], where: str) -> None:
    names = tuple(known)
    for name in got:
        if name not in names:
            raise UnknownNameError(kind, name, names, where)


def _check_numbers(overlay: Overlay, where: str) -> None:
    """Refuse what did not come from a file, where it would have been looked at."""
    for name, patch in (*overlay.frames.items(), *overlay.closures.items()):
        for key, value in vars(patch).items():
            if value is None or isinstance(value, bool):
                continue
            if np.shape(value) != (3,) or not np.isfinite(value).all():
                raise InputError(
                    f"{where}: {name}.{key}: got {np.asarray(value).tolist()}; allowed: 3 finite"
                    " numbers"
                )


def _check_closed(mechanism: Mechanism, overlay: Overlay, where: str) -> None:
    """Refuse loops that do not close as the overlay says they do, over the joints' range."""
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    q = mechanism.lower + share * (mechanism.upper - mechanism.lower)
    if overlay.closure == "parallelogram" and not loops_are_parallelograms(mechanism):
        gape = gaps(mechanism, coupled_coordinates(mechanism, q)).max(axis=0)
        worst = int(np.argmax(gape))
        raise DescriptionError(
            where,
            f"closures.{mechanism.closures[worst].name}",
            f"the loop is no parallelogram: it gapes by {gape[worst]:.3g} m over the joints' range;"
            f' allowed: {PARALLELOGRAM_TOLERANCE_M:.0e} m, or closure = "general"',
        )
    try:
        coordinates(mechanism, q)
    except LoopError as problem:
        raise DescriptionError(where, "closures", str(problem)) from problem
