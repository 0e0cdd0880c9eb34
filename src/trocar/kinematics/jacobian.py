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
    chain = mechanism.chain(frame or mechanism.tip)
    moving = [index for index in chain if mechanism.frames[index].motion != "fixed"]
    if not moving:
        return np.zeros((*where.shape[:-1], 6, len(mechanism.joints)))
    base = at[mechanism.frame_index[mechanism.reference]]
    return adjoint(inverse(base)) @ _screws(mechanism, moving, at) @ rates[..., moving, :]


def jacobian_body(mechanism: Mechanism, q: ArrayLike, frame: str | None = None) -> Array:
    """Return J_b with twist = J_b @ qd: the frame's motion at its own origin in its own axes.

    Args and shape as for `jacobian_spatial`.
    """
    name = frame or mechanism.tip
    at = frame_poses(mechanism, coordinates(mechanism, q))
    base = at[mechanism.frame_index[mechanism.reference]]
    end = at[mechanism.frame_index[name]]
    return adjoint(inverse(end) @ base) @ jacobian_spatial(mechanism, q, name)


def _screws(mechanism: Mechanism, moving: list[int], at: dict[int, Array]) -> Array:
    """Return the unit twist of each moving frame's own coordinate, (..., 6, k)."""
    axes = [hinge_axis(mechanism, index, at) for index in moving]
    point = np.stack([axis[0] for axis in axes], axis=-2)
    along = np.stack([axis[1] for axis in axes], axis=-2)
    slides = np.array([mechanism.frames[index].motion == "prismatic" for index in moving])[:, None]
    linear = np.where(slides, along, np.cross(point, along))
    angular = np.where(slides, 0.0, along)
    return np.swapaxes(np.concatenate([linear, angular], axis=-1), -1, -2)
