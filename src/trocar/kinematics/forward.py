"""Forward kinematics: where every frame is, loop links and closing points included."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, UnknownNameError
from trocar.geometry.se3 import inverse
from trocar.kinematics.loops import closed_coordinates
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.tree import frame_poses

Array = NDArray[np.float64]


def check_positions(mechanism: Mechanism, q: ArrayLike) -> Array:
    """Return joint positions as float64, (..., n_joints).

    Raises:
        InputError: wrong length, NaN or infinity
    """
    array = np.asarray(q, dtype=np.float64)
    count = len(mechanism.joints)
    if array.ndim == 0 or array.shape[-1] != count:
        raise InputError(
            f"{mechanism.name}: got joint positions of shape {array.shape}; allowed (..., {count}):"
            f" {', '.join(mechanism.joint_names)}"
        )
    if not np.isfinite(array).all():
        raise InputError(f"{mechanism.name}: joint positions must be finite, got {array.tolist()}")
    return array


def coordinates(mechanism: Mechanism, q: ArrayLike) -> Array:
    """Return every frame's own coordinate with the loops closed, (..., n_frames) [rad or m].

    Args:
        mechanism: the tree with its loops
        q: joint positions, (..., n_joints) [rad or m]
    """
    return closed_coordinates(mechanism, check_positions(mechanism, q))


def poses(mechanism: Mechanism, q: ArrayLike, relative_to: str | None = None) -> dict[str, Array]:
    """Return the pose of every frame and closing point.

    Args:
        mechanism: the tree with its loops
        q: joint positions, (..., n_joints) [rad or m]
        relative_to: frame to express them in; the mechanism's reference when omitted

    Returns:
        {name: T_reference_frame (..., 4, 4)}; a closing point has the axes of its frame_a
    """
    at = frame_poses(mechanism, coordinates(mechanism, q))
    base = inverse(at[_index(mechanism, relative_to or mechanism.reference)])
    found = {frame.name: base @ at[i] for i, frame in enumerate(mechanism.frames)}
    for closure in mechanism.closures:
        found[closure.name] = found[closure.frame_a] @ _shift(closure.point_a)
    return found


def pose(
    mechanism: Mechanism, q: ArrayLike, frame: str | None = None, relative_to: str | None = None
) -> Array:
    """Return the pose of one frame, the tip when omitted, (..., 4, 4).

    Raises:
        UnknownNameError: no such frame
    """
    name = frame or mechanism.tip
    point = next((c for c in mechanism.closures if c.name == name), None)
    end = _index(mechanism, point.frame_a if point else name)
    base = _index(mechanism, relative_to or mechanism.reference)
    names = sorted(
        {
            *mechanism.chain(mechanism.frames[end].name),
            *mechanism.chain(mechanism.frames[base].name),
        }
    )
    at = frame_poses(mechanism, coordinates(mechanism, q), names)
    result = inverse(at[base]) @ at[end]
    return result @ _shift(point.point_a) if point else result


def _index(mechanism: Mechanism, name: str) -> int:
    if name not in mechanism.frame_index:
        raise UnknownNameError("frame", name, mechanism.frame_names, mechanism.name)
    return mechanism.frame_index[name]


def _shift(point: Array) -> Array:
    moved = np.eye(4)
    moved[:3, 3] = point
    return moved
