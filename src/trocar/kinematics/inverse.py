"""Inverse kinematics of any mechanism that is built like an arm with a closed form.

The closed form answers for a mechanism that is exactly its structure's chain. For one that is
nearly so, such as a calibrated arm whose shaft misses the remote centre, its solutions are where
Newton's method starts, on the mechanism's own forward kinematics. `newton` is that method, for
every forward kinematics.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import check_transform, inverse, log_transform, pose_difference
from trocar.kinematics.closed_form import Fit, Nearest, fit_chain
from trocar.kinematics.forward import pose
from trocar.kinematics.inverse_gimbal_arm import PLATFORM
from trocar.kinematics.inverse_rcm import DIRECTION_TOLERANCE, TIP_AT_CENTRE
from trocar.kinematics.jacobian import jacobian_body
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.solutions import (
    JointRange,
    inside,
    joint_range,
    nearest_first,
    out_of_limits,
    seed_or_middle,
)

Array = NDArray[np.float64]

# Source: our choice. A mechanism this near [m or rad] to its chain is the chain: rounding in a
# description's numbers is smaller, and the pose comes back to 1e-9.
EXACT = 1e-10

# Source: our choice. How far beyond its limits Newton's method may start: the deviation by the
# first figure (a start is off by the deviation over the distance from the remote centre, of which
# 1 cm is near), up to the others [rad, m].
SLACK_FACTOR, SLACK_RAD, SLACK_M = 100.0, 1.0, 0.1

# Source: our choice. A pose comes back to this [m or rad].
POSE_TOLERANCE = 1e-9
# Step at which Newton's method has settled, longest step, which keeps it in the neighbourhood
# [rad or m], and most steps. Source: our choice.
SETTLED, LONGEST_STEP = 1e-12, 0.2
NEWTON_STEPS = 30


def newton(q: Array, step: Callable[[float], Array | None], most: int) -> None:
    """Improve joint positions by Newton's method, in place.

    Args:
        q: (n,), or several at once (k, n) [rad or m]
        step: computes the next step from q, of its shape; None ends the search. It gets the
            longest that a joint moved in the step before [rad or m], infinity at first
        most: number of calls of `step`
    """
    longest: float = np.inf
    for _ in range(most):
        change: Array | None = step(longest)
        if change is None:
            return
        if q.ndim == 1:  # in plain numbers, for it is called at every set-point
            moved: list[float] = change.tolist()
            longest = max(map(abs, moved))
            q += change if longest <= LONGEST_STEP else change * (LONGEST_STEP / longest)
        else:
            each: Array = np.abs(change).max(axis=-1, keepdims=True)
            longest = float(each.max())
            q += change * np.minimum(1.0, LONGEST_STEP / np.maximum(each, 1e-300))


def inverse_kinematics(
    mechanism: Mechanism,
    structure: str,
    T: ArrayLike,
    seed: ArrayLike | None = None,
    *,
    platform_angle: float | None = None,
) -> Array:
    """Find all joint positions inside the limits that bring the tip to a pose.

    Args:
        mechanism: the arm; joints after those of the structure (a jaw) stay at 0
        structure: its type: "rcm_arm", "rcm_scope" or "gimbal_arm"
        T: pose of the tip in the mechanism's reference frame, (4, 4)
        seed: solutions are sorted by their distance from it, (n,) [rad or m]; default: the middle
            of the limits. Distance as in `solutions.nearest_first`: each joint relative to its
            range
        platform_angle: of a gimbal arm's wrist platform [rad]; None makes trocar's own choice

    Returns:
        (k, n) [rad or m], k >= 1, n the joints of the structure (6, 4 or 7); every whole turn that
        the limits leave room for is there

    Raises:
        UnreachableError: no solution inside the limits; says what is in the way, by how much
        SingularError: joints are not determined at this pose
        InputError: an invalid pose, seed or angle, or a mechanism of another structure
    """
    fit = fit_chain(mechanism, structure)
    pose = check_transform(T)
    if pose.shape != (4, 4):
        raise InputError(f"pose: expected shape (4, 4), got {pose.shape}")
    in_chain = inverse(fit.chain.base) @ pose @ inverse(fit.tip)
    joints = _range(mechanism, fit.count)
    solve = fit.chain.solve
    if platform_angle is not None:
        if structure != "gimbal_arm":
            raise InputError("platform_angle: only an arm with a wrist platform takes one")
        solve = partial(solve, platform_angle=platform_angle)
    if fit.deviation <= EXACT:
        return solve(in_chain, joints.lower, joints.upper, seed)
    start = seed_or_middle(joints, seed)
    moving = np.ones(fit.count, dtype=bool)
    tolerance = POSE_TOLERANCE
    if structure == "gimbal_arm":
        moving[PLATFORM] = False
    elif structure == "rcm_scope":
        in_chain, tolerance = _pointed_at_centre(in_chain), DIRECTION_TOLERANCE
    # In closed form, with some room beyond the limits of what moves afterwards.
    slack = np.where(moving, _slack(fit, joints), 0.0)
    try:
        starts = solve(in_chain, joints.lower - slack, joints.upper + slack, start)
    except UnreachableError:  # not even then: say so with the limits as they are
        starts = solve(in_chain, joints.lower, joints.upper, start)
    solved = polished(mechanism, pose, starts, moving, tolerance)
    solutions = inside(solved, joints)
    if len(solutions) == 0:
        raise out_of_limits(solved, joints)
    return nearest_first(solutions, joints, start)


def nearest_solution(
    mechanism: Mechanism,
    structure: str,
    T: Array,
    seed: Array,
) -> Array:
    """Find the joint positions nearest to a seed that bring the tip to a pose, (n,).

    The first row of `inverse_kinematics`, quickly where the structure has a quick way; a gimbal
    arm's wrist platform stays at the seed. The caller checks the pose (4, 4) and the seed (n,).

    Raises:
        UnreachableError, SingularError, InputError: as `inverse_kinematics`
    """
    ends = chain_ends(mechanism, structure)
    if ends.nearest is not None:
        found = ends.nearest(ends.before.dot(T).dot(ends.after), ends.limits, seed.tolist())
        if found:
            return np.array(found)
    platform = float(seed[PLATFORM]) if structure == "gimbal_arm" else None
    return inverse_kinematics(mechanism, structure, T, seed, platform_angle=platform)[0]


def is_chain(mechanism: Mechanism, structure: str) -> bool:
    """Return whether a mechanism is the chain of a structure: `nearest_solution` needs no start.

    Raises:
        InputError: it has another structure
    """
    return fit_chain(mechanism, structure).deviation <= EXACT


def nearest_solutions(mechanism: Mechanism, structure: str, T: Array, seeds: Array) -> Array:
    """Find `nearest_solution` of many poses at once, (n, k); NaN where a pose has none.

    Args:
        mechanism, structure: as for `inverse_kinematics`
        T: poses of the tip in the mechanism's reference frame, (n, 4, 4), not checked
        seeds: of each pose, (n, k) [rad or m]

    Raises:
        InputError: a mechanism of another structure
    """
    fit, todo = fit_chain(mechanism, structure), np.arange(len(T))
    found = np.full(seeds.shape, np.nan)
    if fit.chain.nearest_many is not None and fit.deviation <= EXACT:
        ends = chain_ends(mechanism, structure)
        in_chain = ends.before @ T @ ends.after
        found, undetermined = fit.chain.nearest_many(in_chain, ends.limits, seeds)
        todo = np.flatnonzero(undetermined)
    for k in todo.tolist():
        with suppress(UnreachableError, SingularError):
            found[k] = nearest_solution(mechanism, structure, T[k], seeds[k])
    return found


def nearest_start(mechanism: Mechanism, structure: str, T: Array, seed: Array) -> Array | None:
    """Find where Newton's method may start in search of `nearest_solution`, (n,).

    Returns:
        the solution of the chain that the mechanism nearly is, with room beyond the limits; None
        where it has none, or where the structure has no quick way
    """
    fit = fit_chain(mechanism, structure)
    if fit.chain.nearest is None:
        return None
    ends = chain_ends(mechanism, structure)
    in_chain = ends.before @ T @ ends.after
    if structure == "rcm_scope":
        in_chain = _pointed_at_centre(in_chain)
    found = fit.chain.nearest(in_chain, ends.wider, seed.tolist())
    return np.array(found) if found else None


@dataclass(frozen=True, eq=False)
class ChainEnds:
    """Inverses of the poses before and behind a chain, and the limits of its joints.

    `wider` are the limits within which Newton's method may start. `nearest` finds the solution
    nearest to a seed of a pose between the ends, quickly; None where there is no quick way, or the
    mechanism is not exactly the chain.
    """

    before: Array
    after: Array
    limits: tuple[tuple[float, float], ...]
    wider: tuple[tuple[float, float], ...]
    nearest: Nearest | None


@lru_cache(maxsize=64)
def chain_ends(mechanism: Mechanism, structure: str) -> ChainEnds:
    """Invert the poses before and behind a chain and collect its limits, once for a mechanism."""
    fit = fit_chain(mechanism, structure)
    joints = _range(mechanism, fit.count)
    slack = _slack(fit, joints)
    limits, wider = (
        tuple(zip((joints.lower - beyond).tolist(), (joints.upper + beyond).tolist(), strict=True))
        for beyond in (np.zeros(fit.count), slack)
    )
    nearest = fit.chain.nearest if fit.deviation <= EXACT else None
    return ChainEnds(inverse(fit.chain.base), inverse(fit.tip), limits, wider, nearest)


def _range(mechanism: Mechanism, count: int) -> JointRange:
    joints = mechanism.joints[:count]
    names = tuple(joint.name for joint in joints)
    slides = tuple(joint.kind == "prismatic" for joint in joints)
    return joint_range(names, slides, mechanism.lower[:count], mechanism.upper[:count])


def _slack(fit: Fit, joints: JointRange) -> Array:
    """Return the slack beyond the limits in which Newton's method may start, (n,) [rad or m]."""
    most = np.where(joints.slides, SLACK_M, SLACK_RAD)
    return np.minimum(SLACK_FACTOR * fit.deviation, most)


def _pointed_at_centre(T: Array) -> Array:
    """Turn a scope's pose, its tip staying, until it points away from the remote centre.

    A scope that misses the centre has no pose that its closed form would take.
    """
    tip, z = T[:3, 3], T[:3, 2]
    if np.linalg.norm(tip) < TIP_AT_CENTRE:
        return T
    towards = np.copysign(1.0, tip @ z) * tip / np.linalg.norm(tip)
    across = np.cross(z, towards)
    sine = float(np.linalg.norm(across))
    angle = np.arctan2(sine, z @ towards)
    turn = across * (angle / sine if sine > 0.0 else 1.0)
    turned = T.copy()
    turned[:3, :3] = matrix_from_rotation_vector(turn) @ T[:3, :3]
    return turned


def polished(
    mechanism: Mechanism,
    T: Array,
    starts: Array,
    moving: NDArray[np.bool_],
    tolerance: float = POSE_TOLERANCE,
) -> Array:
    """Bring starts to a pose by Newton's method on a mechanism's own forward kinematics.

    Args:
        mechanism: joints beyond those of the starts stay at 0
        T: pose of the tip in the reference frame, (4, 4)
        starts: (k, n) [rad or m]
        moving: which joints may move, (n,)
        tolerance: how near is near enough [m or rad]

    Returns:
        those that come to the pose, whatever the limits, (<= k, n)

    Raises:
        UnreachableError: none comes
    """
    q, full = starts.copy(), np.zeros((len(starts), len(mechanism.joints)))

    def step(longest: float) -> Array | None:
        if longest < SETTLED:
            return None
        full[:, : q.shape[-1]] = q
        miss = log_transform(inverse(pose(mechanism, full)) @ T)
        slope = jacobian_body(mechanism, full)[..., np.flatnonzero(moving)]
        change = np.zeros_like(q)
        change[:, moving] = (np.linalg.pinv(slope) @ miss[..., None])[..., 0]
        return change

    newton(q, step, NEWTON_STEPS)
    full[:, : q.shape[-1]] = q
    metres, radians = pose_difference(pose(mechanism, full), T)
    worst = np.maximum(metres, radians)
    if not (worst <= tolerance).any():
        best = int(np.argmin(worst))
        raise UnreachableError(
            f"pose out of reach: the nearest that {mechanism.name} comes misses it by "
            f"{metres[best]:.3g} m and {radians[best]:.3g} rad",
            {"position": float(metres[best]), "orientation": float(radians[best])},
        )
    return q[worst <= tolerance]
