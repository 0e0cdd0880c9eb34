"""Geometric Jacobians of any frame, loops included. Twists are (linear; angular)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.geometry.se3 import adjoint, inverse
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import coordinate_rates
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.tree import frame_poses, hinge_axis

Array = NDArray[np.float64]


def jacobian_spatial(mechanism: Mechanism, q: ArrayLike, frame: str | None = None) -> Array:
    """Return J_s with twist = J_s @ qd: the frame's motion in reference axes.

    The linear part is the velocity of the point of the moving body that passes the reference
    frame's origin. Source: Murray, Li, Sastry 1994, section 3.4 (spatial manipulator Jacobian).

    Args:
        mechanism: the tree with its loops
        q: joint positions, (..., n_joints) [rad or m]
        frame: name of the frame; the tip when omitted

    Returns:
        (..., 6, n_joints) [m/s, rad/s per rad/s or m/s]
    """
    where = coordinates(mechanism, q)
    at = frame_poses(mechanism, where)
    rates = coordinate_rates(mechanism, where)
    screws = np.zeros((*where.shape[:-1], 6, len(mechanism.frames)))
    for index in mechanism.chain(frame or mechanism.tip):
        screws[..., index] = _screw(mechanism, index, at)
    base = at[mechanism.frame_index[mechanism.reference]]
    return adjoint(inverse(base)) @ screws @ rates


def jacobian_body(mechanism: Mechanism, q: ArrayLike, frame: str | None = None) -> Array:
    """Return J_b with twist = J_b @ qd: the frame's motion at its own origin in its own axes.

    Args and shape as for `jacobian_spatial`.
    """
    name = frame or mechanism.tip
    at = frame_poses(mechanism, coordinates(mechanism, q))
    base = at[mechanism.frame_index[mechanism.reference]]
    end = at[mechanism.frame_index[name]]
    return adjoint(inverse(end) @ base) @ jacobian_spatial(mechanism, q, name)


def _screw(mechanism: Mechanism, index: int, at: dict[int, Array]) -> Array:
    motion = mechanism.frames[index].motion
    if motion == "fixed":
        return np.zeros(6)
    point, direction = hinge_axis(mechanism, index, at)
    if motion == "prismatic":
        return np.concatenate([direction, np.zeros_like(direction)], axis=-1)
    return np.concatenate([np.cross(point, direction), direction], axis=-1)
