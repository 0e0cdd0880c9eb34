"""Inverse kinematics of a four-joint scope that passes through a remote centre, in closed form.

Joints: yaw, pitch, insertion, roll. The tip's position gives the first three, the turn about the
scope the last; the pose's z axis has no freedom left and must point along the scope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, copysign, cos, hypot, inf, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import SingularError, UnreachableError
from trocar.geometry.se3 import check_transform
from trocar.kinematics.rcm_shaft import shaft_angles, shaft_axes
from trocar.kinematics.solutions import (
    LIMIT_TOLERANCE,
    Limits,
    inside,
    joint_range,
    nearest_first,
    nearest_turn,
    out_of_limits,
    some_inside,
)

Array = NDArray[np.float64]

JOINTS = ("yaw", "pitch", "insertion", "roll")
SLIDES = (False, False, True, False)

# Source: our own choice: how far [rad] the pose's z axis may point
# away from the line through the remote centre and the tip.
DIRECTION_TOLERANCE = 1e-6

# Source: our own choice: nearer than this [m] to the remote centre the tip's position says too
# little about where the scope points; the pose's z axis does instead.
TIP_AT_CENTRE = 1e-3

# Source: our choice, see inverse_rcm_arm.SHAFT_ON_YAW_AXIS.
SHAFT_ON_YAW_AXIS = 1e-7


@dataclass(frozen=True)
class RcmScopeGeometry:
    """What the modified DH rows of the scope's arm leave open.

    Rows (a, alpha, d, theta), frame 0 at the remote centre:
    (0, pi/2, 0, q1 + pi/2), (0, -pi/2, 0, q2 - pi/2), (0, pi/2, q3 - insertion_offset, 0),
    (0, 0, scope_length, q4).

    Attributes:
        insertion_offset: remote centre to the end of the insertion at q3 = 0, towards the arm [m]
        scope_length: from there to the tip [m]
    """

    insertion_offset: float
    scope_length: float


def inverse_rcm_scope(
    geometry: RcmScopeGeometry,
    T: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    seed: ArrayLike | None = None,
) -> Array:
    """Find all joint positions inside the limits that bring the scope's tip to a pose.

    Args:
        geometry: lengths of the arm
        T: pose of the tip in frame 0, the remote centre, (4, 4)
        lower, upper: joint limits, (4,) [rad, insertion m]
        seed: solutions come nearest to it first, (4,); None is the middle of the limits. Distance
            as in `solutions.nearest_first`: each joint in shares of its range

    Returns:
        (k, 4) [rad, insertion m], k >= 1; every whole turn that the limits leave room for is there

    Raises:
        UnreachableError: the direction misses by more than 1e-6 rad (by how much), or no solution
            is inside the limits (which limit is passed, by how much)
        SingularError: the scope lies along the yaw axis
        InputError: a pose, limit or seed that is none
    """
    pose = check_transform(T)
    joints = joint_range(JOINTS, SLIDES, lower, upper)
    direction, depth = _scope_line(pose)
    yaw, pitch, level = shaft_angles(direction)
    x3, y3, _ = shaft_axes(yaw, pitch)
    x4 = pose[:3, 0]
    insertion = np.full_like(yaw, depth + geometry.insertion_offset - geometry.scope_length)
    candidates = np.stack([yaw, pitch, insertion, np.arctan2(y3 @ x4, x3 @ x4)], axis=-1)
    if level < SHAFT_ON_YAW_AXIS and some_inside(candidates, joints, (1, 2)):
        raise SingularError(
            "singular pose: the scope lies along the yaw axis, so yaw and roll are not determined"
        )
    solutions = inside(candidates, joints)
    if len(solutions) == 0:
        raise out_of_limits(candidates, joints)
    return nearest_first(solutions, joints, seed)


def nearest_rcm_scope(
    geometry: RcmScopeGeometry, T: Array, limits: Limits, seed: Sequence[float]
) -> tuple[float, ...] | None:
    """Find the solution of `inverse_rcm_scope` that is nearest to a seed, in plain numbers.

    Args:
        geometry: as for `inverse_rcm_scope`
        T: pose of the tip in frame 0, (4, 4)
        limits: lower and upper of each joint, four pairs
        seed: four numbers [rad, insertion m]

    Returns:
        four numbers; None where there is no solution, joints are not determined, or the tip is
        near the remote centre: `inverse_rcm_scope` then finds or says why
    """
    (a00, _, a02, px), (a10, _, a12, py), (a20, _, a22, pz), _ = T.tolist()
    along = px * a02 + py * a12 + pz * a22
    depth = copysign(sqrt(px * px + py * py + pz * pz), along)
    mx, my, mz = py * a22 - pz * a12, pz * a02 - px * a22, px * a12 - py * a02
    miss = atan2(sqrt(mx * mx + my * my + mz * mz), abs(along))
    low3, high3 = limits[2]
    q3 = depth + geometry.insertion_offset - geometry.scope_length
    if abs(depth) < TIP_AT_CENTRE or miss > DIRECTION_TOLERANCE:
        return None
    if not low3 - LIMIT_TOLERANCE <= q3 <= high3 + LIMIT_TOLERANCE:
        return None
    ux, uy, uz = px / depth, py / depth, pz / depth
    level = hypot(ux, uz)
    if level < SHAFT_ON_YAW_AXIS:
        return None
    yaw, pitch = atan2(ux, -uz), atan2(-uy, level)
    best, found = inf, None
    for q1, q2 in ((yaw, pitch), (yaw + pi, pi - pitch)):
        q1, q2 = nearest_turn(q1, seed[0], limits[0]), nearest_turn(q2, seed[1], limits[1])
        if q1 is None or q2 is None:
            continue
        s1, c1, s2, c2 = sin(q1), cos(q1), sin(q2), cos(q2)
        turn = atan2(-a00 * c1 - a20 * s1, -a00 * s1 * s2 - a10 * c2 + a20 * c1 * s2)
        q4 = nearest_turn(turn, seed[3], limits[3])
        if q4 is None:
            continue
        q = (q1, q2, min(max(q3, low3), high3), q4)
        far = 0.0
        for a, b, (low, high) in zip(q, seed, limits, strict=True):
            far += ((a - b) / (high - low)) ** 2
        if far < best:
            best, found = far, q
    return found


def _scope_line(T: Array) -> tuple[Array, float]:
    """Give the direction of the scope, and how far past the remote centre its tip is [m]."""
    tip, z = T[:3, 3], T[:3, 2] / np.linalg.norm(T[:3, 2])
    depth = float(np.copysign(np.linalg.norm(tip), tip @ z))
    far = abs(depth) >= TIP_AT_CENTRE
    direction = tip / depth if far else z
    miss = float(np.linalg.norm(np.cross(tip, z)))
    angle = float(np.arctan2(miss, abs(tip @ z))) if far else miss / TIP_AT_CENTRE
    if angle > DIRECTION_TOLERANCE:
        raise UnreachableError(
            f"pose out of reach: its z axis misses the line through the remote centre and the tip "
            f"by {angle:.3g} rad ({miss:.3g} m at the remote centre); "
            f"the scope allows {DIRECTION_TOLERANCE:g} rad",
            {"direction": angle},
        )
    return direction, depth if far else float(tip @ z)
