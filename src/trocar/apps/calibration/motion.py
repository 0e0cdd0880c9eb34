"""Where a robot's markers are, by trocar's own kinematics with the loops closed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from trocar.apps.calibration.geometry import rebuilt
from trocar.apps.calibration.start import Robot
from trocar.descriptions.pins import pin_frame, pinned
from trocar.kinematics.loops import closed_coordinates, loops_are_parallelograms
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.tree import frame_poses

Array = NDArray[np.float64]

# Source: our own choice; central differences of smooth functions of order 1 leave 1e-10. [rad]
STEP = 1e-5
#: Loops that are no parallelograms are closed at so many positions of a joint and interpolated.
#: Source: our own choice; over 2 rad splines of smooth functions of order 1 leave 1e-10.
NODES = 401


def mechanism_of(robot: Robot) -> Mechanism:
    """Return the linkage of a robot as a mechanism; with tilted axes its closing pins slide."""
    found = rebuilt(robot.linkage, robot.linkage.mechanism, robot.moved, robot.tilts)
    if not robot.tilts:
        return found
    known = {frame.name: frame for frame in found.frames}
    return replace(
        found,
        frames=(*found.frames, *(pin_frame(closure, known) for closure in found.closures)),
        closures=tuple(pinned(closure) for closure in found.closures),
    )


def marker_poses(robot: Robot, mechanism: Mechanism, q: Array) -> Array:
    """Return the pose of each tracked body's markers in the ground's first frame.

    Args:
        robot: whose markers
        mechanism: `mechanism_of(robot)`
        q: positions of the joints that move the loops, (n, n_moving) [rad]

    Returns:
        (n, n_bodies, 4, 4), in the order of `robot.markers`
    """
    linkage = robot.linkage
    at = frame_poses(mechanism, _coordinates(robot, mechanism, q))
    index = mechanism.frame_index
    ground = np.linalg.inv(at[index[linkage.bodies[linkage.ground]]])
    return np.stack(
        [ground @ at[index[linkage.bodies[b]]] @ X for b, X in robot.markers.items()], axis=1
    )


def _coordinates(robot: Robot, mechanism: Mechanism, q: Array) -> Array:
    """Return every frame's coordinate with the loops closed, (n, n_frames)."""

    def closed(some: Array) -> Array:
        every = np.tile(robot.linkage.rest, (len(some), 1))
        every[:, list(robot.linkage.joints)] += some
        return closed_coordinates(mechanism, every)

    if q.shape[1] != 1 or len(q) < 2 * NODES or loops_are_parallelograms(mechanism):
        return closed(q)
    nodes = np.linspace(q.min() - STEP, q.max() + STEP, NODES)
    return CubicSpline(nodes, closed(nodes[:, None]))(q[:, 0])


def marker_rates(robot: Robot, mechanism: Mechanism, q: Array, at: Array) -> Array:
    """Return how the markers move with the joints, (n, n_bodies, 6, n_moving).

    The rows are the velocity of the markers' origin and the angular velocity, in the ground's axes.
    """
    rates = np.zeros((*at.shape[:2], 6, q.shape[1]))
    for column in range(q.shape[1]):
        away = STEP * np.eye(q.shape[1])[column]
        plus, minus = (marker_poses(robot, mechanism, q + s * away) for s in (1.0, -1.0))
        rates[..., :3, column] = (plus - minus)[..., :3, 3] / (2.0 * STEP)
        spin = (plus - minus)[..., :3, :3] @ np.swapaxes(at[..., :3, :3], -1, -2) / (2.0 * STEP)
        rates[..., 3:, column] = unskew(spin)
    return rates


def unskew(spin: Array) -> Array:
    """Return the vector of the skew part of a matrix, (..., 3)."""
    half = 0.5 * (spin - np.swapaxes(spin, -1, -2))
    return np.stack([half[..., 2, 1], half[..., 0, 2], half[..., 1, 0]], axis=-1)


def pose_residuals(measured: Array, expected: Array) -> Array:
    """Return what turns expected poses into measured ones, (..., 6) [m, rad] in outer axes."""
    turn = measured[..., :3, :3] @ np.swapaxes(expected[..., :3, :3], -1, -2)
    sine = unskew(turn)
    size = np.linalg.norm(sine, axis=-1)
    cosine = 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(size, cosine)
    factor = np.where(size > 1e-12, angle / np.maximum(size, 1e-300), 1.0)
    away = (measured - expected)[..., :3, 3]
    return np.concatenate([away, sine * factor[..., None]], axis=-1)
