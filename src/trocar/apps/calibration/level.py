"""Where along its axes a linkage's plane lies.

Tracks do not tell: a linkage that is shifted along its axes, and its markers back, moves alike.
With tilted axes it is told by other numbers, though, so that a fit drifts along them. Here it is
shifted to where the plane passes the datum.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.geometry import Slot, leading, slots
from trocar.apps.calibration.start import Robot

Array = NDArray[np.float64]


def levelled(robot: Robot, body: str, datum: Array) -> Robot:
    """Return the same robot, told by where its axes pierce the plane through the datum.

    Args:
        robot: with tilted axes
        body: of the ground, which has the datum
        datum: in the body's markers, (3,) [m]
    """
    linkage, up = robot.linkage, robot.linkage.plane[:, 2]
    marker = robot.markers[body]
    off = float(up @ (marker[:3, :3] @ datum + marker[:3, 3])) - linkage.level
    moved = robot.moved.copy()
    for i, slot in enumerate(slots(linkage)):
        moved[i] += off * _drift(_tilt(robot, slot))
    markers = {name: pose.copy() for name, pose in robot.markers.items()}
    for name, pose in markers.items():
        pose[:3, 3] -= off * (linkage.frames[linkage.bodies[name]][:3, :3].T @ up)
    return replace(robot, moved=moved, markers=markers)


def _tilt(robot: Robot, slot: Slot) -> Array:
    """Return the tilt of an axis against the body that has it, (2,) [rad]."""
    hinge = robot.linkage.hinge(slot.hinge)
    if not hinge.closure:
        return robot.tilts.get(hinge.name, np.zeros(2))
    if slot.body == hinge.body_a:
        return np.zeros(2)  # a closing pin slides along the axis of its side a
    return _leaning(robot, hinge.body_a) - _leaning(robot, hinge.body_b)


def _leaning(robot: Robot, body: str) -> Array:
    """Return how a body leans in the ground, by the tilts of the hinges that lead to it."""
    names = [slot.hinge for slot in leading(robot.linkage, body)]
    return sum((robot.tilts.get(name, np.zeros(2)) for name in names), np.zeros(2))


def _drift(tilt: Array) -> Array:
    """Return where an axis of this tilt goes across, by metre along it, (2,)."""
    return np.array([tilt[1], -tilt[0]])
