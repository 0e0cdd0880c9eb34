"""Inverse kinematics of arms whose shaft passes through a remote centre, in closed form.

The arm of an instrument has six joints: yaw, pitch, insertion, roll, wrist pitch, wrist yaw. The
wrist yaw axis and the tip are known from the pose. The x axis of the wrist (frame 5) is at right
angles to that axis and lies in the plane that it spans with the remote centre, so two directions
are left; each gives the point where roll and wrist pitch axes meet, which the shaft must run
through, on either side of the remote centre. The angles follow without a further choice.

A scope has four: yaw, pitch, insertion, roll. The tip's position gives the first three, the turn
about the scope the last; the pose's z axis has no freedom left and must point along the scope.

Frame 0 is the remote centre; frame 3 moves with the insertion, its z axis along the shaft. Its axes
in frame 0 follow from the modified DH rows (alpha, theta) = (pi/2, q1 + pi/2), (-pi/2, q2 - pi/2)
and (pi/2, 0).

Source: the dVRK's kinematics of PSM and ECM (sawIntuitiveResearchKit, PSM.json and ECM.json).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import atan2, copysign, cos, hypot, inf, isinf, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import SingularError, UnreachableError
from trocar.geometry.se3 import check_transform
from trocar.kinematics.solutions import (
    LIMIT_TOLERANCE,
    NEAR,
    JointRange,
    Limits,
    distance_from,
    inside,
    joint_range,
    nearer,
    nearest_first,
    nearest_turn,
    nearest_turns,
    out_of_limits,
    some_inside,
)

Array = NDArray[np.float64]

JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
SLIDES = (False, False, True, False, False, False)
SCOPE_JOINTS = 4

# Source: our own choice: nearer than this to the remote
# centre the wrist no longer says where the shaft points.
WRIST_AT_CENTRE = 1e-3

# Source: our choice. With the tip this near [m] to the line through the remote centre along the
# wrist yaw axis, a rounding of 1e-17 m in the pose would turn the arm by more than 1e-10 rad.
TIP_ON_AXIS = 1e-7

# Source: our choice, likewise for the cosine of the pitch when the shaft lies along the yaw axis.
SHAFT_ON_YAW_AXIS = 1e-7

# Source: our own choice, more than rounding: an angle whose limits end 1e-6 rad before a quarter
# turn has a positive cosine. [rad]
ACUTE_MOST = 0.5 * pi - 1e-6

# Source: our own choice: how far [rad] the pose's z axis may point
# away from the line through the remote centre and the tip.
DIRECTION_TOLERANCE = 1e-6

# Source: our own choice: nearer than this [m] to the remote centre the tip's position says too
# little about where the scope points; the pose's z axis does instead.
TIP_AT_CENTRE = 1e-3


def shaft_axes(q1: Array, q2: Array) -> tuple[Array, Array, Array]:
    """Compute the axes of frame 3 in frame 0.

    Args:
        q1: yaw, (...) [rad]
        q2: pitch, (...) [rad]

    Returns:
        x, y and z of frame 3, (..., 3) each; z is along the shaft, towards the tip
    """
    s1, c1, s2, c2 = np.sin(q1), np.cos(q1), np.sin(q2), np.cos(q2)
    x = np.stack([-s1 * s2, -c2, c1 * s2], axis=-1)
    y = np.stack([-c1, np.zeros_like(c1), -s1], axis=-1)
    z = np.stack([s1 * c2, -s2, -c1 * c2], axis=-1)
    return x, y, z


def shaft_angles(direction: Array) -> tuple[Array, Array, Array]:
    """Compute both pairs of yaw and pitch that point the shaft along a direction.

    Args:
        direction: unit vectors in frame 0, (..., 3)

    Returns:
        yaw (..., 2) [rad]; pitch (..., 2) [rad], the first with |pitch| <= pi/2, the second over
        the top; and the cosine of the pitch (...), where 0 means that any yaw would do
    """
    level = np.hypot(direction[..., 0], direction[..., 2])
    yaw = np.arctan2(direction[..., 0], -direction[..., 2])
    pitch = np.arctan2(-direction[..., 1], level)
    yaws = np.stack([yaw, yaw + np.pi], axis=-1)
    return yaws, np.stack([pitch, np.pi - pitch], axis=-1), level


@dataclass(frozen=True, eq=False)
class RcmArmGeometry:
    """Parameters of the arm that its modified DH rows leave open.

    Rows (a, alpha, d, theta), frame 0 at the remote centre:
    (0, pi/2, 0, q1 + pi/2), (0, -pi/2, 0, q2 - pi/2), (0, pi/2, q3 - insertion_offset, 0),
    (0, 0, tool_length, q4), (0, -pi/2, 0, q5 - pi/2), (wrist_length, -pi/2, 0, q6 - pi/2),
    then the rotation `tip_rotation`.

    Attributes:
        insertion_offset: remote centre to the end of the insertion at q3 = 0, towards the arm [m]
        tool_length: from there to the wrist pitch axis [m]
        wrist_length: wrist pitch axis to wrist yaw axis [m], not 0
        tip_rotation: axes of the tip in frame 6, (3, 3)
    """

    insertion_offset: float
    tool_length: float
    wrist_length: float
    tip_rotation: Array


@dataclass(frozen=True, eq=False)
class _Branches:
    """Joint positions (m, 6), and which branches (m,) are not determined, for which reason."""

    q: Array
    wrist_at_centre: NDArray[np.bool_]
    shaft_on_yaw_axis: NDArray[np.bool_]
    tip_on_axis: bool


def inverse_rcm_arm(
    geometry: RcmArmGeometry,
    T: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    seed: ArrayLike | None = None,
) -> Array:
    """Find all joint positions inside the limits that bring the tip to a pose.

    Args:
        geometry: lengths of the arm and its tool
        T: pose of the tip in frame 0, the remote centre, (4, 4)
        lower, upper: joint limits, (6,) [rad, insertion m]
        seed: solutions are sorted by their distance from it, (6,); default: the middle of the
            limits. Distance as in `solutions.nearest_first`: each joint relative to its range

    Returns:
        (k, 6) [rad, insertion m], k >= 1; every whole turn that the limits leave room for is there

    Raises:
        UnreachableError: no solution inside the limits; says which limit is passed, by how much
        SingularError: every solution inside the limits has joints that are not determined: the
            wrist pitch axis within 1 mm of the remote centre, the tip on the wrist yaw axis's
            parallel through the remote centre, or the shaft along the yaw axis
        InputError: an invalid pose, limit or seed
    """
    pose = check_transform(T)
    joints = joint_range(JOINTS, SLIDES, lower, upper)
    branches = _branches(geometry, pose)
    singular = branches.wrist_at_centre | branches.shaft_on_yaw_axis | branches.tip_on_axis
    solutions = inside(branches.q[~singular], joints)
    if len(solutions) == 0:
        _reject_singular(branches, joints)
        raise out_of_limits(branches.q, joints)
    return nearest_first(solutions, joints, seed)


def nearest_rcm_arm(
    geometry: RcmArmGeometry, T: Array, limits: Limits, seed: Sequence[float]
) -> tuple[float, ...] | None:
    """Find the solution of `inverse_rcm_arm` that is nearest to a seed, in plain numbers.

    Branches that pass a limit are left early and each angle takes the whole turn nearest to the
    seed, so that this costs a fortieth of all solutions (measured).

    Args:
        geometry: as for `inverse_rcm_arm`, with the tip's axes those of frame 6
        T: pose of the tip in frame 0, (4, 4)
        limits: lower and upper of each joint, six pairs
        seed: six numbers [rad, insertion m]

    Returns:
        six numbers; () where there is no solution, for reasons that `inverse_rcm_arm` has; None
        where joints of a branch are not determined, which is left to it
    """
    (a00, _, a02, px), (a10, _, a12, py), (a20, _, a22, pz), _ = T.tolist()
    along = px * a02 + py * a12 + pz * a22
    cx, cy, cz = px - along * a02, py - along * a12, pz - along * a22
    distance = sqrt(cx * cx + cy * cy + cz * cz)
    if distance < TIP_ON_AXIS:
        return None
    cx, cy, cz = cx / distance, cy / distance, cz / distance
    wrist_length, shift = geometry.wrist_length, geometry.insertion_offset - geometry.tool_length
    low3, high3 = limits[2]
    (low4, high4), (low5, high5), (low6, high6) = limits[3:]
    near1, near2, _, near4, near5, near6 = seed
    (low1, high1), (low2, high2) = limits[:2]
    upright = low2 > -ACUTE_MOST and high2 < ACUTE_MOST  # as `_acute`: two calls less
    narrow = low6 > -ACUTE_MOST and high6 < ACUTE_MOST
    found: tuple[float, ...] = ()
    for sign in (1.0, -1.0):
        bx, by, bz = sign * cx, sign * cy, sign * cz  # x5
        wx, wy, wz = px - wrist_length * bx, py - wrist_length * by, pz - wrist_length * bz
        norm = sqrt(wx * wx + wy * wy + wz * wz)
        if norm < WRIST_AT_CENTRE:
            return None
        ex, ey, ez = by * a22 - bz * a12, bz * a02 - bx * a22, bx * a12 - by * a02  # x5 x z6
        cosine = ex * a00 + ey * a10 + ez * a20
        if narrow and cosine <= 0.0:
            continue
        turn = atan2(bx * a00 + by * a10 + bz * a20, cosine)
        q6 = turn + 0.0  # where `nearest_turn` has it, too: a call less for most angles
        if not (abs(turn - near6) < NEAR and low6 <= turn <= high6):
            q6 = nearest_turn(turn, near6, limits[5])
            if q6 is None:
                continue
        for depth in (norm, -norm):
            q3 = depth + shift
            if not low3 - LIMIT_TOLERANCE <= q3 <= high3 + LIMIT_TOLERANCE:
                continue
            ux, uy, uz = wx / depth, wy / depth, wz / depth
            turn = atan2(-(ux * a02 + uy * a12 + uz * a22), ux * bx + uy * by + uz * bz)
            q5 = turn + 0.0
            if not (abs(turn - near5) < NEAR and low5 <= turn <= high5):
                q5 = nearest_turn(turn, near5, limits[4])
                if q5 is None:
                    continue
            level = hypot(ux, uz)
            if level < SHAFT_ON_YAW_AXIS:
                return None
            yaw, pitch = atan2(ux, -uz), atan2(-uy, level)
            for over in (False,) if upright else (False, True):
                turn = yaw + pi if over else yaw
                q1 = turn + 0.0
                if not (abs(turn - near1) < NEAR and low1 <= turn <= high1):
                    q1 = nearest_turn(turn, near1, limits[0])
                    if q1 is None:
                        continue
                turn = pi - pitch if over else pitch
                q2 = turn + 0.0
                if not (abs(turn - near2) < NEAR and low2 <= turn <= high2):
                    q2 = nearest_turn(turn, near2, limits[1])
                    if q2 is None:
                        continue
                s1, c1, s2, c2 = sin(q1), cos(q1), sin(q2), cos(q2)
                turn = atan2(ex * s1 * s2 + ey * c2 - ez * c1 * s2, -ex * c1 - ez * s1)
                q4 = turn + 0.0
                if not (abs(turn - near4) < NEAR and low4 <= turn <= high4):
                    q4 = nearest_turn(turn, near4, limits[3])
                    if q4 is None:
                        continue
                q = (q1, q2, min(max(q3, low3), high3), q4, q5, q6)
                if not found:
                    found = q
                    continue
                far = distance_from(seed, q, limits)
                if nearer(far, q, distance_from(seed, found, limits), found):
                    found = q
    return found


def nearest_rcm_arms(
    geometry: RcmArmGeometry, T: Array, limits: Limits, seeds: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Find the solutions of `nearest_rcm_arm` for many poses, to the same last bit.

    Args:
        geometry: as for `nearest_rcm_arm`
        T: poses of the tip in frame 0, (n, 4, 4)
        limits: lower and upper of each joint, six pairs
        seeds: of each pose, (n, 6) [rad, insertion m]

    Returns:
        (n, 6), NaN where there is no solution; and where joints are not determined, (n,), which is
        left to `inverse_rcm_arm`
    """
    (a00, _, a02, px), (a10, _, a12, py), (a20, _, a22, pz) = T[:, :3].transpose(1, 2, 0)
    along = px * a02 + py * a12 + pz * a22
    cx, cy, cz = px - along * a02, py - along * a12, pz - along * a22
    distance = np.sqrt(cx * cx + cy * cy + cz * cz)
    undetermined = distance < TIP_ON_AXIS
    distance[undetermined] = 1.0
    wrist_length, shift = geometry.wrist_length, geometry.insertion_offset - geometry.tool_length

    def near(turn: Array, joint: int, worlds: NDArray[np.intp]) -> Array:
        return nearest_turns(turn, seeds[worlds, joint], limits[joint])

    count = len(T)
    at, sign = np.tile(np.arange(count), 2), np.repeat([1.0, -1.0], count)
    bx, by, bz = sign * (cx / distance)[at], sign * (cy / distance)[at], sign * (cz / distance)[at]
    wx, wy, wz = (p[at] - wrist_length * b for p, b in ((px, bx), (py, by), (pz, bz)))
    norm = np.sqrt(wx * wx + wy * wy + wz * wz)
    undetermined |= (norm < WRIST_AT_CENTRE).reshape(2, count).any(axis=0)
    x6, y6, z6 = a00[at], a10[at], a20[at]
    x, y, z = a02[at], a12[at], a22[at]
    ex, ey, ez = by * z - bz * y, bz * x - bx * z, bx * y - by * x  # x5 x z6
    sine, cosine = bx * x6 + by * y6 + bz * z6, ex * x6 + ey * y6 + ez * z6
    sides = np.flatnonzero(cosine > 0.0) if _acute(limits[5]) else np.arange(2 * count)
    q6 = np.full(2 * count, np.nan)
    q6[sides] = near(_each(atan2, sine[sides], cosine[sides]), 5, at[sides])
    # Candidates that pass a limit are left out from here on.
    sides = np.repeat(np.flatnonzero(~np.isnan(q6)), 2)
    depth = norm[sides] * np.where(np.arange(len(sides)) % 2, -1.0, 1.0)
    low3, high3 = limits[2]
    q3 = depth + shift
    fits = (low3 - LIMIT_TOLERANCE <= q3) & (q3 <= high3 + LIMIT_TOLERANCE)
    sides, depth, q3 = sides[fits], depth[fits], q3[fits]
    with np.errstate(divide="ignore", invalid="ignore"):  # undetermined
        ux, uy, uz = wx[sides] / depth, wy[sides] / depth, wz[sides] / depth
    sine = -(ux * x[sides] + uy * y[sides] + uz * z[sides])
    cosine = ux * bx[sides] + uy * by[sides] + uz * bz[sides]
    q5 = near(_each(atan2, sine, cosine), 4, at[sides])
    fits = ~np.isnan(q5)
    sides, q3, q5, ux, uy, uz = sides[fits], q3[fits], q5[fits], ux[fits], uy[fits], uz[fits]
    level = _each(hypot, ux, uz)
    undetermined[at[sides[level < SHAFT_ON_YAW_AXIS]]] = True
    yaw, pitch = _each(atan2, ux, -uz), _each(atan2, -uy, level)
    if not _acute(limits[1]):  # over the top, too
        yaw = np.stack([yaw, yaw + pi], axis=1).ravel()
        pitch = np.stack([pitch, pi - pitch], axis=1).ravel()
        sides, q3, q5 = np.repeat(sides, 2), np.repeat(q3, 2), np.repeat(q5, 2)
    q1, q2 = near(yaw, 0, at[sides]), near(pitch, 1, at[sides])
    fits = ~(np.isnan(q1) | np.isnan(q2))
    sides, q1, q2, q3, q5 = sides[fits], q1[fits], q2[fits], q3[fits], q5[fits]
    s1, c1, s2, c2 = _each(sin, q1), _each(cos, q1), _each(sin, q2), _each(cos, q2)
    ex, ey, ez, worlds = ex[sides], ey[sides], ez[sides], at[sides]
    turn = _each(atan2, ex * s1 * s2 + ey * c2 - ez * c1 * s2, -ex * c1 - ez * s1)
    q4 = near(turn, 3, worlds)
    q3 = np.minimum(np.maximum(q3, low3), high3)
    q = np.stack([q1, q2, q3, q4, q5, q6[sides]], axis=1)
    fits = ~np.isnan(q4)
    found = np.full((count, len(limits)), np.nan)
    found[worlds[fits]] = q[fits]
    for world in np.flatnonzero(np.bincount(worlds[fits], minlength=count) > 1).tolist():
        found[world] = _nearest(q[fits & (worlds == world)], seeds[world].tolist(), limits)
    found[undetermined] = np.nan
    return found, undetermined


def _nearest(branches: Array, seed: Sequence[float], limits: Limits) -> Sequence[float]:
    """Return the branch nearest to a seed, of several (m, 6)."""
    best, found = inf, branches[0].tolist()
    for q in branches.tolist():
        far = 0.0
        for a, b, (low, high) in zip(q, seed, limits, strict=True):
            far += ((a - b) / (high - low)) ** 2
        far = sqrt(far)
        if isinf(best) or nearer(far, q, best, found):
            best, found = far, q
    return found


def _acute(limits: tuple[float, float]) -> bool:
    """Return whether angles inside limits have positive cosines, so that one branch is enough."""
    low, high = limits
    return low > -ACUTE_MOST and high < ACUTE_MOST


def _each(function: Callable[..., float], *values: Array) -> Array:
    """Apply a function of plain numbers, since numpy's own round otherwise on some processors."""
    return np.array([*map(function, *(row.tolist() for row in values))], np.float64)


def _branches(geometry: RcmArmGeometry, T: Array) -> _Branches:
    """Solve without limits: wrist direction (2) by side of the remote centre (2) by pitch (2)."""
    tip, R06 = T[:3, 3], T[:3, :3] @ geometry.tip_rotation.T
    x6, z6 = R06[:, 0], R06[:, 2]
    across = tip - (tip @ z6) * z6
    distance = float(np.linalg.norm(across))
    tip_on_axis = distance < TIP_ON_AXIS
    # On the axis any direction at right angles to it will do: all have the same q3 and q5.
    towards = x6 if tip_on_axis else across / distance
    x5 = np.stack([towards, -towards])[:, None, None, :]
    wrist = tip - geometry.wrist_length * x5
    depth = np.linalg.norm(wrist, axis=-1) * np.array([1.0, -1.0])[:, None]
    at_centre = np.abs(depth) < WRIST_AT_CENTRE
    u = np.where(depth[..., None] == 0.0, x5, wrist / np.where(depth == 0.0, 1.0, depth)[..., None])
    yaw, pitch, level = shaft_angles(u[..., 0, :])
    q = np.empty((2, 2, 2, 6))
    q[..., 0], q[..., 1] = yaw, pitch
    q[..., 2] = depth + geometry.insertion_offset - geometry.tool_length
    x3, y3, _ = shaft_axes(yaw, pitch)
    a, b, c = x5[..., 0], x5[..., 1], x5[..., 2]
    x, y, z = z6.tolist()
    z5 = np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)  # x5 x z6
    q[..., 3] = np.arctan2(-np.sum(z5 * x3, axis=-1), np.sum(z5 * y3, axis=-1))
    q[..., 4] = np.arctan2(-u @ z6, np.sum(u * x5, axis=-1))
    q[..., 5] = np.arctan2(x5 @ x6, z5 @ x6)
    shape = (2, 2, 2)
    return _Branches(
        q.reshape(8, 6),
        np.broadcast_to(at_centre, shape).ravel(),
        np.broadcast_to(level[..., None] < SHAFT_ON_YAW_AXIS, shape).ravel(),
        tip_on_axis,
    )


def _reject_singular(branches: _Branches, joints: JointRange) -> None:
    """Raise SingularError where a branch keeps the limits of the joints that it does determine."""
    if branches.tip_on_axis and some_inside(branches.q, joints, (2, 4)):
        raise SingularError(
            "singular pose: the tip lies on the line through the remote centre along the wrist yaw "
            "axis, about which the whole arm could turn"
        )
    near = branches.q[branches.wrist_at_centre]
    if some_inside(near, joints, (2,)):
        raise SingularError(
            f"singular pose: the wrist pitch axis is within {1e3 * WRIST_AT_CENTRE:g} mm of the "
            "remote centre, so yaw, pitch and roll are not determined"
        )
    if some_inside(branches.q[branches.shaft_on_yaw_axis], joints, (1, 2, 4, 5)):
        raise SingularError(
            "singular pose: the shaft lies along the yaw axis, so yaw and roll are not determined"
        )


@dataclass(frozen=True)
class RcmScopeGeometry:
    """Parameters of the scope's arm that its modified DH rows leave open.

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
        seed: solutions are sorted by their distance from it, (4,); default: the middle of the
            limits. Distance as in `solutions.nearest_first`: each joint relative to its range

    Returns:
        (k, 4) [rad, insertion m], k >= 1; every whole turn that the limits leave room for is there

    Raises:
        UnreachableError: the direction misses by more than 1e-6 rad (by how much), or no solution
            is inside the limits (which limit is passed, by how much)
        SingularError: the scope lies along the yaw axis
        InputError: an invalid pose, limit or seed
    """
    pose = check_transform(T)
    joints = joint_range(JOINTS[:SCOPE_JOINTS], SLIDES[:SCOPE_JOINTS], lower, upper)
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
    found: tuple[float, ...] | None = None
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
        if found is None:
            found = q
            continue
        if nearer(distance_from(seed, q, limits), q, distance_from(seed, found, limits), found):
            found = q
    return found


def _scope_line(T: Array) -> tuple[Array, float]:
    """Return the direction of the scope, and the depth of its tip past the centre [m]."""
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
