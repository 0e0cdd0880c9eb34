"""Which overlays go on which arm of a rig."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path

from trocar.descriptions.overlay import Overlay, apply_overlay, overlay_text, read_overlay
from trocar.descriptions.records import ArmDescription, RigArm, RigDescription
from trocar.errors import InputError, UnknownNameError
from trocar.inputs import is_file

#: An overlay, or the path of its file.
One = Overlay | str | Path
#: Of a rig: one for every arm of its kind; {arm of the rig: its own}; or several, of which a text
#: "ARM=FILE" is for one arm.
Calibration = One | Mapping[str, One] | Sequence[One]

#: Built-in dynamics overlays, and what their names look like.
DYNAMICS = Path(__file__).parent / "data" / "dynamics"
NAME = re.compile(r"[a-z0-9_]+")
#: The name of an arm ahead of a "=", and what follows it.
NAMED = re.compile(r"([A-Za-z][A-Za-z0-9_]*)=(.+)")


def as_overlay(calibration: One) -> Overlay:
    """Return an overlay, read from its file where it is a path.

    The text of a built-in dynamics overlay is its name ("psm").

    Raises:
        DescriptionError: the file is broken
    """
    if isinstance(calibration, Overlay):
        return calibration
    built_in = DYNAMICS / f"{calibration}.toml"
    if isinstance(calibration, str) and NAME.fullmatch(calibration) and is_file(built_in):
        return read_overlay(built_in)
    return read_overlay(calibration)


def combined(one: Overlay, other: Overlay) -> Overlay:
    """Return the geometry of one overlay with the dynamics of the other.

    Raises:
        InputError: they are for different arms, or both have geometry, or both dynamics
    """
    geometry, dynamics = (one, other) if one.dynamics is None else (other, one)
    if one.arm != other.arm:
        raise InputError(
            f"calibration: got overlays for {one.arm!r} and {other.arm!r}; allowed: the same arm"
        )
    both = bool(dynamics.frames or dynamics.closures)
    if geometry.dynamics is not None or dynamics.dynamics is None or both:
        raise InputError(
            f"calibration: got two for {one.arm!r}; allowed: one, or one with geometry and one with"
            " dynamics"
        )
    return replace(geometry, dynamics=dynamics.dynamics)


def calibrated(arm: ArmDescription, calibration: One | Sequence[One] | None) -> ArmDescription:
    """Return an arm with a calibration, its dynamics or both laid over it; itself without one.

    Raises:
        InputError, DescriptionError: the overlay is broken, or for another arm
    """
    if calibration is None:
        return arm
    several = [calibration] if isinstance(calibration, Overlay | str | Path) else calibration
    overlays = [as_overlay(one) for one in several]
    return apply_overlay(arm, reduce(combined, overlays)) if overlays else arm


def calibrated_rig(rig: RigDescription, calibration: Calibration | None) -> RigDescription:
    """Return a rig whose arms carry their calibrations; their roots stay where they are.

    Raises:
        UnknownNameError: an arm that the rig does not have
        InputError: no arm of the rig is of an overlay's kind, or two are for the same arm
        DescriptionError: an overlay is broken
    """
    if calibration is None:
        return rig
    named, general = _sorted(calibration)
    known = [arm.name for arm in rig.arms]
    for name in named:
        if name not in known:
            raise UnknownNameError("arm", name, known, f"rig {rig.name}")
    kinds = {arm.arm.name for arm in rig.arms}
    for kind, overlay in general.items():
        if kind not in kinds:
            raise InputError(
                f"{overlay.file or 'overlay'}: is a calibration of {kind!r}; the arms of rig"
                f" {rig.name} are of {', '.join(sorted(kinds))}"
            )
    done: dict[tuple[ArmDescription, int], ArmDescription] = {}

    def one(arm: RigArm) -> RigArm:
        own, common = named.get(arm.name), general.get(arm.arm.name)
        overlay = own or common
        if own and common and (own.dynamics is None) != (common.dynamics is None):
            overlay = combined(own, common)
        if overlay is None or _carries(arm.arm, overlay):
            return arm
        key = (arm.arm, id(overlay))
        if key not in done:
            done[key] = apply_overlay(arm.arm, overlay)
        return replace(arm, arm=done[key])

    return replace(rig, arms=tuple(one(arm) for arm in rig.arms))


def rig_overlays(rig: RigDescription) -> dict[str, Overlay]:
    """Return the calibrations that a rig's arms carry, {arm: overlay}."""
    return {arm.name: arm.arm.overlay for arm in rig.arms if arm.arm.overlay is not None}


def _carries(arm: ArmDescription, overlay: Overlay) -> bool:
    """Tell whether an arm carries this very calibration already."""
    return arm.overlay is not None and overlay_text(arm.overlay) == overlay_text(overlay)


def _sorted(calibration: Calibration) -> tuple[dict[str, Overlay], dict[str, Overlay]]:
    """Return the overlays of single arms by the arm's name, and the others by their kind."""
    if isinstance(calibration, Mapping):
        return {name: as_overlay(one) for name, one in calibration.items()}, {}
    alone = isinstance(calibration, Overlay | str | Path)
    several: Sequence[One] = [calibration] if alone else calibration
    named: dict[str, Overlay] = {}
    general: dict[str, Overlay] = {}
    for one in several:
        match = NAMED.fullmatch(one) if isinstance(one, str) else None
        overlay = as_overlay(match[2] if match else one)
        place, key = (named, match[1]) if match else (general, overlay.arm)
        place[key] = combined(place[key], overlay) if key in place else overlay
    return named, general
