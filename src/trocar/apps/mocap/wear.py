"""An arm whose sides are unequal and whose axes are skew: its remote centre wanders."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.calibration_plan import default_plan
from trocar.descriptions.overlay import apply_overlay
from trocar.descriptions.overlay_records import ClosurePatch, FramePatch, Overlay
from trocar.descriptions.records import ArmDescription
from trocar.geometry.rotations import matrix_from_rotation_vector, rpy_from_matrix

Array = NDArray[np.float64]

#: How far each axis is displaced across itself and tilted. Source: our own choice; it makes the
#: remote centre wander by tenths of a millimetre, as the paper's real PSM does (Table 7).
DISPLACED_M, TILTED_RAD = 0.0003, 0.001


def worn(
    arm: ArmDescription,
    rng: np.random.Generator,
    displaced_m: float = DISPLACED_M,
    tilted_rad: float = TILTED_RAD,
) -> ArmDescription:
    """Return an arm each axis of whose loops is a little off, as bearings wear.

    Opposite sides are no longer equal and axes no longer parallel; pins shift in their hinges, so
    the loops still close and move.

    Args:
        arm: with closed loops whose frames have z along their axes, as a PSM and an ECM
        rng: where the numbers come from
        displaced_m: each axis is off by up to this along x and y of its frame [m]
        tilted_rad: and tilted by up to this about them [rad]

    Raises:
        InputError: the arm carries a calibration already
        DescriptionError: its loops do not close any more
    """
    mechanism = arm.mechanism
    names = {closure.name for closure in mechanism.closures}
    frames = {
        name: _moved(mechanism.frame(name).before, rng, displaced_m, tilted_rad)
        for name in default_plan(mechanism).axes.values()
        if name not in names
    }
    closures = {
        c.name: ClosurePatch(
            c.point_a + _across(rng, displaced_m),
            c.point_b + _across(rng, displaced_m),
            slides=True,
        )
        for c in mechanism.closures
    }
    return apply_overlay(arm, Overlay(arm.name, "general", frames, closures))


def _across(rng: np.random.Generator, most: float) -> Array:
    """Return what lies across z, (3,)."""
    return np.append(rng.uniform(-most, most, 2), 0.0)


def _moved(before: Array, rng: np.random.Generator, shift: float, tilt: float) -> FramePatch:
    """Return where a hinge stands when it is shifted across and tilted against its axis."""
    at = before[:3, 3] + before[:3, :3] @ _across(rng, shift)
    turned = before[:3, :3] @ matrix_from_rotation_vector(_across(rng, tilt))
    return FramePatch(at, rpy_from_matrix(turned))
