"""Where along its axes a linkage's plane lies.

Bearings tell how bodies stand to one another along the axes, and a pin that slides tells next to
nothing: to first order in the tilts it moves its two links alike wherever on its own line it is.
So a linkage that is shifted along its axes, and its markers back, fits as well, with other numbers
for tilted axes. Here it is held to the plane through the datum, and shifted to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.geometry import Slot, slots
from trocar.apps.calibration.motion import mechanism_of
from trocar.apps.calibration.placement import swept
from trocar.apps.calibration.start import Robot
from trocar.geometry import skew
from trocar.kinematics.loops import closed_coordinates
from trocar.kinematics.tree import frame_poses

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Level:
    """The datum as the markers of one body have it.

    Attributes:
        body: the ground, or the first that is tracked
        point: in its markers, at home (3,) [m]
    """

    body: str
    point: Array


def level_of(robot: Robot, points: Mapping[str, Array]) -> Level:
    """Return the datum in the markers of the ground where it is tracked, else of another body.

    Args:
        robot: whose bodies
        points: {body: the datum in its markers (3,) [m]}
    """
    ground = robot.linkage.ground
    body = ground if ground in points else next(name for name in robot.markers if name in points)
    return Level(body, points[body])


def height(robot: Robot, level: Level) -> float:
    """Return how far along the axes the datum is from the linkage's plane [m]."""
    linkage, marker = robot.linkage, robot.markers[level.body]
    frame = linkage.frames[linkage.bodies[level.body]]
    at = frame[:3, :3] @ (marker[:3, :3] @ level.point + marker[:3, 3]) + frame[:3, 3]
    return float(linkage.plane[:, 2] @ at) - linkage.level


def height_slope(robot: Robot, level: Level) -> Array:
    """Return how the height follows a shift and a turn of the body's markers, (6,)."""
    linkage, turn = robot.linkage, robot.markers[level.body][:3, :3]
    up = linkage.plane[:, 2] @ linkage.frames[linkage.bodies[level.body]][:3, :3] @ turn
    return np.concatenate([up, -up @ skew(level.point)])


def levelled(robot: Robot, level: Level) -> Robot:
    """Return the same robot, told by where its axes pierce the plane through the datum.

    Args:
        robot: with tilted axes
        level: the datum
    """
    linkage, up = robot.linkage, robot.linkage.plane[:, 2]
    off = height(robot, level)
    drift = _drifts(robot)
    moved = robot.moved + off * np.stack([drift[slot] for slot in slots(linkage)])
    markers = {name: pose.copy() for name, pose in robot.markers.items()}
    for name, pose in markers.items():
        pose[:3, 3] -= off * (linkage.frames[linkage.bodies[name]][:3, :3].T @ up)
    return replace(robot, moved=moved, markers=markers)


def _drifts(robot: Robot) -> dict[Slot, Array]:
    """Return where each axis goes across, in the body that has it, by metre along it, (2,)."""
    linkage = robot.linkage
    found: dict[Slot, Array] = {}
    for slot in slots(linkage):
        tilt = robot.tilts.get(slot.hinge, np.zeros(2))
        found[slot] = np.array([tilt[1], -tilt[0]])
    turns = _turns(robot)
    for hinge in linkage.hinges:
        if hinge.closure:
            line = _pin_line(turns[hinge.body_a], turns[hinge.body_b])
            found[Slot(hinge.name, hinge.body_a)] = line[:2]
            found[Slot(hinge.name, hinge.body_b)] = line[2:]
    return found


def _turns(robot: Robot) -> dict[str, Array]:
    """Return how bodies turn over a sweep, from their drawn home, in the plane's axes (n, 3, 3)."""
    linkage, mechanism = robot.linkage, mechanism_of(robot)
    at = frame_poses(mechanism, closed_coordinates(mechanism, swept(linkage, mechanism)))
    ground = at[mechanism.frame_index[linkage.bodies[linkage.ground]]][..., :3, :3]
    found: dict[str, Array] = {}
    for body, frame in linkage.bodies.items():
        pose = np.swapaxes(ground, -1, -2) @ at[mechanism.frame_index[frame]][..., :3, :3]
        home = linkage.frames[frame][:3, :3].T
        found[body] = linkage.plane.T @ pose @ home @ linkage.plane
    return found


def _pin_line(a: Array, b: Array) -> Array:
    """Return the line on which a pin may sit with the same motion: across a, across b, (4,).

    A pin goes up by 1 along the axis of its side b, and slides along that of its side a. Its places
    on both move across, by v_a and v_b, so that both see it at one place again at every turn. Of
    parallelograms that are tilted a little, there are such; of others, those that come nearest.
    """
    left = np.concatenate([a[:, :2, :2], -b[:, :2, :2]], axis=2).reshape(-1, 4)
    right = (b[:, :2, 2] - a[:, :2, 2]).ravel()
    return np.asarray(np.linalg.lstsq(left, right, rcond=1e-6)[0], dtype=np.float64)
