"""Poses and hinge axes of a tree of frames, for given coordinates of every frame."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from trocar.kinematics.mechanism import Frame, Mechanism

Array = NDArray[np.float64]


def frame_poses(
    mechanism: Mechanism, coordinates: Array, only: Iterable[int] | None = None
) -> dict[int, Array]:
    """Return the pose of frames in the root.

    Args:
        mechanism: the tree
        coordinates: one per frame, (..., n_frames) [rad or m]
        only: indices of frames that include every ancestor; all when omitted

    Returns:
        {frame index: T_root_frame (..., 4, 4)}
    """
    found: dict[int, Array] = {}
    lead = coordinates.shape[:-1]
    for index in range(len(mechanism.frames)) if only is None else only:
        frame = mechanism.frames[index]
        local = local_pose(frame, coordinates[..., index])
        if frame.parent is None:
            found[index] = np.broadcast_to(local, (*lead, 4, 4))
        else:
            found[index] = found[mechanism.frame_index[frame.parent]] @ local
    return found


def local_pose(frame: Frame, coordinate: Array) -> Array:
    """Return T_parent_frame = before @ motion_z(coordinate) @ after, (..., 4, 4)."""
    if frame.motion == "fixed":
        return frame.before @ frame.after
    return frame.before @ motion_z(frame, coordinate) @ frame.after


def motion_z(frame: Frame, coordinate: Array) -> Array:
    """Return the turn about z, or the slide along z, of a frame's own hinge, (..., 4, 4)."""
    moved = np.zeros((*np.shape(coordinate), 4, 4))
    moved[..., 2, 2] = moved[..., 3, 3] = 1.0
    if frame.motion == "prismatic":
        moved[..., 0, 0] = moved[..., 1, 1] = 1.0
        moved[..., 2, 3] = coordinate
        return moved
    cosine, sine = np.cos(coordinate), np.sin(coordinate)
    moved[..., 0, 0] = moved[..., 1, 1] = cosine
    moved[..., 0, 1] = -sine
    moved[..., 1, 0] = sine
    return moved


def hinge_axis(mechanism: Mechanism, index: int, poses: dict[int, Array]) -> tuple[Array, Array]:
    """Return (point, unit direction) of a moving frame's axis in the root, (..., 3) each."""
    frame = mechanism.frames[index]
    axis = (
        poses[mechanism.frame_index[frame.parent]] @ frame.before if frame.parent else frame.before
    )
    return axis[..., :3, 3], axis[..., :3, 2]


def point_velocity(
    mechanism: Mechanism, index: int, poses: dict[int, Array], point: Array
) -> Array:
    """Return d point / d coordinate of frame `index` for a point that it carries, (..., 3)."""
    at, along = hinge_axis(mechanism, index, poses)
    if mechanism.frames[index].motion == "prismatic":
        return along
    return np.cross(along, point - at)
