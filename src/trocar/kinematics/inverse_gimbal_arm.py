"""Inverse kinematics of a seven-joint arm with a four-axis gimbal, in closed form.

Joints: outer yaw, shoulder pitch, elbow pitch, wrist platform, wrist pitch, wrist yaw, wrist roll.
The last four axes meet in one point. Its position gives the first three joints; the orientation
leaves one freedom, which the angle of the wrist platform takes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry.se3 import check_transform
from trocar.kinematics.solutions import (
    LIMIT_TOLERANCE,
    JointRange,
    inside,
    joint_range,
    nearest_first,
    out_of_limits,
    seed_or_middle,
)

Array = NDArray[np.float64]

JOINTS = (
    "outer_yaw",
    "shoulder_pitch",
    "elbow_pitch",
    "wrist_platform",
    "wrist_pitch",
    "wrist_yaw",
    "wrist_roll",
)
SLIDES = (False,) * 7
PLATFORM = 3

# Source: our choice. Below this sine (or, for the yaw, distance in m) a rounding step of 1e-16 in
# the pose would turn a joint by 1e-9 rad.
SINGULAR = 1e-7


@dataclass(frozen=True)
class GimbalArmGeometry:
    """Parameters of the arm that its standard DH rows leave open.

    Rows (a, alpha, d, theta), frame 0 at the outer yaw:
    (0, pi/2, 0, q1 - pi/2), (upper_arm, 0, 0, q2 - pi/2), (forearm, -pi/2, 0, q3 + pi/2),
    (0, pi/2, wrist_height, q4), (0, -pi/2, 0, q5), (0, pi/2, 0, q6 - pi/2), (0, 0, 0, q7 + pi/2).

    Attributes:
        upper_arm: shoulder to elbow [m]
        forearm: elbow to wrist platform [m]
        wrist_height: from there to the point where the gimbal's axes meet [m]
    """

    upper_arm: float
    forearm: float
    wrist_height: float


def inverse_gimbal_arm(
    geometry: GimbalArmGeometry,
    T: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    seed: ArrayLike | None = None,
    *,
    platform_angle: float | None = None,
) -> Array:
    """Find all joint positions inside the limits that bring the handle to a pose.

    Without a platform angle trocar makes its own choice (no rule of the dVRK): the platform is put
    where the wrist yaw is 0, the middle of its range and farthest from the gimbal's singularity.
    Where the platform's limits do not allow that, it goes to either limit. With the dVRK's limits
    one of these always serves, so a pose whose position can be reached can be reached.

    Args:
        geometry: lengths of the arm
        T: pose of the handle in frame 0, (4, 4)
        lower, upper: joint limits, (7,) [rad]
        seed: solutions are sorted by their distance from it, (7,); default: the middle of the
            limits. Distance as in `solutions.nearest_first`: each joint relative to its range
        platform_angle: wrist platform [rad]; default: trocar's own choice

    Returns:
        (k, 7) [rad], k >= 1; every whole turn that the limits leave room for is there

    Raises:
        UnreachableError: too far or too near (by how much), or no solution inside the limits (which
            limit is passed, by how much)
        SingularError: the gimbal's outer and inner axes are parallel, or its centre is on the axis
            of the outer yaw
        InputError: an invalid pose, limit, seed or angle
    """
    pose = check_transform(T)
    joints = joint_range(JOINTS, SLIDES, lower, upper)
    start = seed_or_middle(joints, seed)
    arm = _arm_branches(geometry, pose[:3, 3])
    if platform_angle is None:
        choices = _own_choices(pose[:3, :3], arm, joints, float(start[PLATFORM]))
    else:
        joints = _with_platform_at(joints, platform_angle)
        choices = [np.full((len(arm), 1), platform_angle)]
    tried = np.empty((0, len(JOINTS)))
    for angles in choices:
        q, sine = gimbal_branches(pose[:3, :3], arm, angles)
        solutions = inside(q, joints)
        if len(solutions):
            _reject_singular(pose[:3, 3], inside(q[sine < SINGULAR], joints))
            return nearest_first(solutions, joints, start)
        tried = np.concatenate([tried, q])
    raise out_of_limits(tried, joints)


def _arm_branches(geometry: GimbalArmGeometry, wrist: Array) -> Array:
    """Solve the first three joints: either side of the yaw axis by either bend of the elbow.

    From elbow to wrist is one straight link, `reach` long and turned by `lean` from the forearm.

    Args:
        geometry: lengths
        wrist: where the gimbal's axes meet, (3,) [m]

    Returns:
        outer yaw, shoulder pitch, elbow pitch, (4, 3) [rad]
    """
    reach = np.hypot(geometry.forearm, geometry.wrist_height)
    lean = np.arctan2(geometry.wrist_height, geometry.forearm)
    upper_arm, distance = geometry.upper_arm, float(np.linalg.norm(wrist))
    longest, shortest = upper_arm + reach, abs(upper_arm - reach)
    if distance > longest + LIMIT_TOLERANCE or distance < shortest - LIMIT_TOLERANCE:
        raise _out_of_reach(distance, float(shortest), float(longest))
    cosine = (distance**2 - upper_arm**2 - reach**2) / (2.0 * upper_arm * reach)
    bend = np.arccos(np.clip(cosine, -1.0, 1.0)) * np.array([1.0, -1.0])
    outward = np.hypot(wrist[0], wrist[1]) * np.array([[1.0], [-1.0]])
    rise = np.arctan2(reach * np.sin(bend), upper_arm + reach * np.cos(bend))
    q = np.empty((2, 2, 3))
    q[..., 0] = np.arctan2(wrist[1], wrist[0]) + 0.5 * np.pi * np.array([[1.0], [3.0]])
    q[..., 1] = np.arctan2(wrist[2], outward) - rise + 0.5 * np.pi
    q[..., 2] = bend - lean - 0.5 * np.pi
    return q.reshape(4, 3)


def _out_of_reach(distance: float, shortest: float, longest: float) -> UnreachableError:
    if distance > longest:
        by, word, limit = distance - longest, "at most", longest
    else:
        by, word, limit = shortest - distance, "at least", shortest
    return UnreachableError(
        f"pose out of reach: the wrist is {distance:.6g} m from the shoulder, the arm reaches "
        f"{word} {limit:.6g} m; it misses by {by:.3g} m",
        {"distance": by},
    )


def _platform_axes(arm: Array) -> tuple[Array, Array, Array]:
    """Compute the axes of frame 3 (z: the axis of the wrist platform) in frame 0, (m, 3) each."""
    turn, tilt = arm[:, 0] - 0.5 * np.pi, arm[:, 1] + arm[:, 2]
    cos_turn, sin_turn, cos_tilt, sin_tilt = np.cos(turn), np.sin(turn), np.cos(tilt), np.sin(tilt)
    x = np.stack([cos_tilt * cos_turn, cos_tilt * sin_turn, sin_tilt], axis=-1)
    y = np.stack([-sin_turn, cos_turn, np.zeros_like(turn)], axis=-1)
    z = np.stack([-sin_tilt * cos_turn, -sin_tilt * sin_turn, cos_tilt], axis=-1)
    return x, y, z


def _own_choices(R: Array, arm: Array, joints: JointRange, otherwise: float) -> list[Array]:
    """Choose platform angles, (m, 2) each [rad]: first with wrist yaw 0, then at the limits.

    With wrist yaw 0 the roll axis has no part along the wrist pitch axis, which points along
    x sin(q4) - y cos(q4) in frame 3; a roll axis along the platform's lets any angle do.

    Source: our choice, see `inverse_gimbal_arm`.
    """
    x, y, _ = _platform_axes(arm)
    along_x, along_y = x @ R[:, 2], y @ R[:, 2]
    level = np.where(np.hypot(along_x, along_y) < SINGULAR, otherwise, np.arctan2(along_y, along_x))
    ends = np.array([joints.lower[PLATFORM], joints.upper[PLATFORM]])
    return [np.stack([level, level + np.pi], axis=-1), np.tile(ends, (len(arm), 1))]


def _with_platform_at(joints: JointRange, angle: float) -> JointRange:
    """Narrow the platform's limits to one angle, so that whole turns do not move it."""
    low, high = joints.lower.copy(), joints.upper.copy()
    if not np.isfinite(angle):
        raise InputError(f"platform_angle: expected a finite number, got {angle}")
    by = max(float(low[PLATFORM]) - angle, angle - float(high[PLATFORM]))
    if by > LIMIT_TOLERANCE:
        raise UnreachableError(
            f"pose out of reach: platform angle {angle:.6g} rad is beyond its limits "
            f"{low[PLATFORM]:.6g} to {high[PLATFORM]:.6g} by {by:.3g}",
            {JOINTS[PLATFORM]: by},
        )
    low[PLATFORM] = high[PLATFORM] = np.clip(angle, low[PLATFORM], high[PLATFORM])
    return replace(joints, lower=low, upper=high)


def gimbal_branches(R: Array, arm: Array, angles: Array) -> tuple[Array, Array]:
    """Solve the last three joints for every arm branch and platform angle, limits aside.

    R_47 = Rz(q5) Ry(q6 - pi/2) Rz(q7 + pi/2), so its last row and column have the angles.

    Args:
        R: orientation of the handle in frame 0, (3, 3)
        arm: first three joints, (m, 3) [rad]
        angles: platform angles, (m, g) [rad]

    Returns:
        joints (2 m g, 7) [rad], and the sine between roll axis and wrist pitch axis (2 m g,)
    """
    x3, y3, z3 = (axis[:, None, :] for axis in _platform_axes(arm))
    cos, sin = np.cos(angles)[..., None], np.sin(angles)[..., None]
    x4, y4, z4 = x3 * cos + y3 * sin, z3, x3 * sin - y3 * cos
    m13, m23, m33 = ((axis @ R[:, 2])[..., None] for axis in (x4, y4, z4))
    m31, m32 = ((z4 @ R[:, k])[..., None] for k in (0, 1))
    sine = np.hypot(m13, m23)
    side = np.array([1.0, -1.0])
    q = np.empty((*angles.shape, 2, 7))
    q[..., :3] = arm[:, None, None, :]
    q[..., PLATFORM] = angles[..., None]
    q[..., 4] = np.arctan2(side * m23, side * m13)
    q[..., 5] = np.arctan2(side * sine, m33) + 0.5 * np.pi
    q[..., 6] = np.arctan2(side * m32, -side * m31) - 0.5 * np.pi
    return q.reshape(-1, 7), np.broadcast_to(sine, q.shape[:-1]).ravel()


def _reject_singular(wrist: Array, singular: Array) -> None:
    if len(singular):
        raise SingularError(
            "singular pose: wrist pitch and wrist roll turn about one line, so neither is "
            "determined; another platform angle frees them"
        )
    if np.hypot(wrist[0], wrist[1]) < SINGULAR:
        raise SingularError(
            "singular pose: the wrist is on the axis of the outer yaw, which is not determined"
        )
