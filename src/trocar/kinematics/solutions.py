"""Closed-form solutions inside an arm's joint limits, nearest first.

Used by every inverse kinematics; about limits and whole turns, not about arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, UnreachableError

Array = NDArray[np.float64]
#: Lower and upper of each joint, in plain numbers [rad or m].
Limits = Sequence[tuple[float, float]]

TURN = 2.0 * np.pi

# Source: our choice. A pose made at a limit comes back beyond it by rounding (1e-15, more near
# singular poses); this much is taken for the limit, and moves a tip at 0.5 m by 5e-10 m at most.
# Solutions whose distances from a seed differ by less are equally near.
LIMIT_TOLERANCE = 1e-9
# The decimals that this leaves.
DECIMALS = 9


@dataclass(frozen=True, eq=False)
class JointRange:
    """The limits that solutions must keep.

    Attributes:
        names: what to call the joints in messages
        slides: which joints slide [m]; the others turn [rad]
        lower: (n,) [rad or m]
        upper: (n,) [rad or m]
    """

    names: tuple[str, ...]
    slides: tuple[bool, ...]
    lower: Array
    upper: Array


def joint_range(
    names: tuple[str, ...], slides: tuple[bool, ...], lower: ArrayLike, upper: ArrayLike
) -> JointRange:
    """Check limits and put them together.

    Raises:
        InputError: a wrong length, not finite, or a lower limit above the upper one
    """
    low, high = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    n = len(names)
    if low.shape != (n,) or high.shape != (n,):
        raise InputError(
            f"limits: expected {n} joints ({', '.join(names)}), got {low.shape} and {high.shape}"
        )
    bad = np.flatnonzero(~((low <= high) & np.isfinite(low) & np.isfinite(high)))
    if bad.size:
        i = int(bad[0])
        raise InputError(
            f"limits: {names[i]}: expected finite lower <= upper, got {low[i]:g} and {high[i]:g}"
        )
    return JointRange(names, slides, low, high)


def inside(candidates: Array, joints: JointRange) -> Array:
    """List every configuration inside the limits that differs from a candidate by whole turns.

    Args:
        candidates: (m, n) [rad or m]
        joints: their limits

    Returns:
        (k, n), k may be 0; within `LIMIT_TOLERANCE` of a limit they are set to it
    """
    first = _unwound(candidates, joints)
    first = first[(_excess(first, joints) == 0.0).all(axis=-1)]
    room = np.floor((joints.upper + LIMIT_TOLERANCE - first) / TURN)
    turns = np.where(joints.slides, 0.0, room).astype(int)
    found: list[Array] = []
    for q, more in zip(first, turns, strict=True):
        for step in np.ndindex(*(more + 1)) if more.any() else ((0,) * len(more),):
            found.append(q + TURN * np.asarray(step))
    if not found:
        return np.empty((0, len(joints.names)))
    return np.clip(np.stack(found), joints.lower, joints.upper)


def some_inside(candidates: Array, joints: JointRange, which: tuple[int, ...]) -> bool:
    """Return whether a candidate keeps the limits of some joints, whatever the others do.

    Args:
        candidates: (m, n) [rad or m]
        joints: their limits
        which: the joints that count, as positions in `joints`
    """
    outside = _excess(_unwound(candidates, joints), joints)[:, list(which)]
    return bool((outside == 0.0).all(axis=-1).any())


def seed_or_middle(joints: JointRange, seed: ArrayLike | None) -> Array:
    """Check a seed; without one, give the middle of the limits.

    Args:
        joints: the limits
        seed: (n,) [rad or m], or None

    Returns:
        (n,) [rad or m]

    Raises:
        InputError: a seed of the wrong length, or not finite
    """
    middle = 0.5 * (joints.lower + joints.upper)
    if seed is None:
        return middle
    start = np.asarray(seed, dtype=np.float64)
    if start.shape != middle.shape or not np.isfinite(start).all():
        raise InputError(f"seed: expected {middle.size} finite numbers, got {start.tolist()}")
    return start


def nearest_first(solutions: Array, joints: JointRange, seed: ArrayLike | None) -> Array:
    """Sort solutions by distance from a seed, and drop those that are there twice.

    The distance is sqrt(sum_i ((q_i - seed_i) / (upper_i - lower_i))^2): each joint's difference is
    measured in shares of its own range, so radians and metres weigh alike. Of solutions that are
    equally near, as half a turn either way is, that comes first which is larger in the first joint
    in which they differ.

    Args:
        solutions: (k, n) [rad or m]
        joints: their limits
        seed: (n,) [rad or m]; None takes the middle of the limits

    Returns:
        (k, n), k possibly smaller

    Raises:
        InputError: a seed of the wrong length, or not finite
    """
    start = seed_or_middle(joints, seed)
    distance = np.linalg.norm((solutions - start) / _scale(joints), axis=-1)
    keys = np.round(np.column_stack([distance, -solutions]), DECIMALS)
    ordered = solutions[np.lexsort(keys.T[::-1])]
    gaps = np.abs(ordered[:, None] - ordered[None, :]).max(axis=-1, initial=0.0)
    repeated = np.tril(gaps < LIMIT_TOLERANCE, k=-1).any(axis=-1)
    return ordered[~repeated]


def nearer(far: float, q: Sequence[float], best: float, found: Sequence[float]) -> bool:
    """Return whether q, so far from a seed, comes before a solution in `nearest_first`.

    Args:
        far, best: distances of both, as of `nearest_first`
        q, found: both, (n,) [rad or m]
    """
    if abs(far - best) > LIMIT_TOLERANCE:
        return far < best
    return [round(a, DECIMALS) for a in q] > [round(b, DECIMALS) for b in found]


def nearest_turn(q: float, seed: float, limits: tuple[float, float]) -> float | None:
    """Return q plus the whole turns that bring it nearest to a seed inside limits, or None.

    Half a turn from the seed, the larger of both.
    """
    low, high = limits
    q += TURN * floor((seed - q + LIMIT_TOLERANCE) / TURN + 0.5)
    if q > high + LIMIT_TOLERANCE:
        q -= TURN
    elif q < low - LIMIT_TOLERANCE:
        q += TURN
    if low - LIMIT_TOLERANCE <= q <= high + LIMIT_TOLERANCE:
        return min(max(q, low), high)
    return None


def nearest_turns(q: Array, seed: Array, limits: tuple[float, float]) -> Array:
    """Return `nearest_turn` of many angles with a seed each, (n,), NaN where it has none."""
    low, high = limits
    near = q + TURN * np.floor((seed - q + LIMIT_TOLERANCE) / TURN + 0.5)
    below, above = near < low - LIMIT_TOLERANCE, near > high + LIMIT_TOLERANCE
    near += TURN * (below.astype(np.float64) - above)
    fits = (low - LIMIT_TOLERANCE <= near) & (near <= high + LIMIT_TOLERANCE)
    return np.where(fits, np.minimum(np.maximum(near, low), high), np.nan)


def out_of_limits(candidates: Array, joints: JointRange) -> UnreachableError:
    """Name the limits that keep an arm from a pose, by the candidate that passes them least.

    Args:
        candidates: (m, n), m >= 1, none of them inside the limits
        joints: their limits

    Returns:
        the error, to be raised; `excess` has the joints beyond a limit and by how much [rad or m]
    """
    near = _unwound(candidates, joints)
    beyond = _excess(near, joints)
    farthest: Array = (beyond / _scale(joints)).max(axis=-1)
    best = int(np.argmin(np.round(farthest, DECIMALS)))
    parts: list[str] = []
    excess: dict[str, float] = {}
    for i in np.flatnonzero(beyond[best]):
        name, unit = joints.names[i], "m" if joints.slides[i] else "rad"
        q, by = float(near[best, i]), float(beyond[best, i])
        above = q > joints.upper[i]
        side, limit = ("upper", joints.upper[i]) if above else ("lower", joints.lower[i])
        parts.append(f"{name} {q:.6g} {unit} is beyond its {side} limit {limit:.6g} by {by:.3g}")
        excess[name] = by
    return UnreachableError(f"pose out of reach: {'; '.join(parts)}", excess)


def _unwound(candidates: Array, joints: JointRange) -> Array:
    """Take each turning joint by whole turns to where it first keeps its limits, or nearly does."""
    below = np.ceil((joints.lower - LIMIT_TOLERANCE - candidates) / TURN)
    first = candidates + TURN * below
    back = (first - joints.upper > LIMIT_TOLERANCE) & (
        joints.lower - (first - TURN) < first - joints.upper - LIMIT_TOLERANCE
    )
    return np.where(joints.slides, candidates, np.where(back, first - TURN, first))


def _excess(q: Array, joints: JointRange) -> Array:
    beyond = np.maximum(q - joints.upper, joints.lower - q)
    return np.where(beyond <= LIMIT_TOLERANCE, 0.0, beyond)


def _scale(joints: JointRange) -> Array:
    width = joints.upper - joints.lower
    return np.where(width > 0.0, width, 1.0)
