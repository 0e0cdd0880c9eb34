"""Closed loops: loop error, assembly branch, and singular configurations.

A point that two links share gives a residual r = p_b - p_a. Its derivative by the coordinates of
the two frames that the hinge determines spans the plane of the loop; the sine of the angle
between the two columns is the branch determinant. It vanishes where the loop is singular (flat),
and its sign distinguishes the parallelogram from the anti-parallelogram.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import acos

import numpy as np
from numpy.typing import NDArray

from trocar.errors import LoopError
from trocar.kinematics.mechanism import Closure, Mechanism
from trocar.kinematics.tree import frame_poses, hinge_axis, point_velocity

Array = NDArray[np.float64]

#: Terms of the series. Source: a four-bar's angles are smooth where it is not flat; 0.2 rad from
#: there 48 terms leave 1e-13 rad (measured on a calibrated PSM).
TERMS = 48
ORDERS = np.arange(TERMS)
#: Margin of the table beyond a joint's limits, relative to its range: a simulated joint passes them
#: by a little. Source: our own choice.
MARGIN = 0.02


@dataclass(frozen=True, eq=False)
class LoopTable:
    """A series in one joint for each passive frame.

    Attributes:
        column: the joint that folds the loops
        middle, half: of the range that the series hold in [rad or m]
        series: coefficients, (TERMS, n_passive)
    """

    column: int
    middle: float
    half: float
    series: Array

    def beyond_start(self, q: Array) -> Array:
        """Return the deviation from the couplings, (..., n_passive); 0 outside the table."""
        share = (q[..., self.column] - self.middle) / self.half
        turn = np.arccos(np.clip(share, -1.0, 1.0))
        found = np.cos(turn[..., None] * ORDERS) @ self.series
        return np.where((np.abs(share) <= 1.0)[..., None], found, 0.0)

    def at(self, position: float) -> tuple[Array, Array] | None:
        """Return the deviation from the couplings at one position of the joint, and its slope.

        Returns:
            (n_passive,) each [rad or m, per rad or m]; None outside the table's range
        """
        share = (position - self.middle) / self.half
        if not -1.0 <= share <= 1.0:
            return None
        found = np.cos(acos(share) * ORDERS).dot(self._with_slopes)
        half = len(found) // 2
        return found[:half], found[half:]

    @cached_property
    def _with_slopes(self) -> Array:
        """Coefficients of the series and of their derivatives, (TERMS, 2 n_passive)."""
        slopes = np.zeros_like(self.series)
        slopes[:-1] = np.polynomial.chebyshev.chebder(self.series, scl=1.0 / self.half)
        return np.concatenate([self.series, slopes], axis=1)


def nodes(lower: float, upper: float) -> Array:
    """Return the positions of a joint at which a table is measured, (TERMS,)."""
    middle, half = _range(lower, upper)
    return middle + half * np.cos(_turns())


def loop_table(column: int, lower: float, upper: float, values: Array) -> LoopTable:
    """Return the table that has these values, (TERMS, n_passive), at `nodes`.

    Source: the discrete cosine transform of a function at Chebyshev's nodes has its coefficients;
    Trefethen 2013, Approximation Theory and Approximation Practice, chapter 3.
    """
    middle, half = _range(lower, upper)
    series = 2.0 / TERMS * np.cos(np.outer(np.arange(TERMS), _turns())) @ values
    series[0] *= 0.5
    return LoopTable(column, middle, half, series)


def _range(lower: float, upper: float) -> tuple[float, float]:
    return 0.5 * (lower + upper), (0.5 + MARGIN) * (upper - lower)


def _turns() -> Array:
    return np.pi * (np.arange(TERMS) + 0.5) / TERMS


#: Couplings close a loop when its error is less than this. Source: our own choice. [m]
PARALLELOGRAM_TOLERANCE_M = 1e-9
#: Newton stops here; a tenth of a picometre is rounding at these sizes. [m]
CLOSED_M = 1e-13
NEWTON_STEPS = 40
#: Newton gives up where so many steps did not halve the gap: these loops cannot close. Source: our
#: own choice; from where it starts it closes a loop in four.
PATIENCE = 6
#: Nearer than this to a flat loop, a joint range is worth a warning. Source: our own choice. [rad]
NEAR_FLAT_RAD = 0.2


def coupled_coordinates(mechanism: Mechanism, q: Array) -> Array:
    """Return each frame's coordinate by its couplings alone, (..., n_frames)."""
    return q @ mechanism.ratios.T


def residuals(mechanism: Mechanism, coordinates: Array) -> Array:
    """Return p_b - p_a of every closure in the root, (..., n_closures, 3) [m]."""
    poses = frame_poses(mechanism, coordinates, _loop_frames(mechanism))
    gaps = [
        _point(mechanism, c, poses, "b") - _point(mechanism, c, poses, "a")
        for c in mechanism.closures
    ]
    if not gaps:
        return np.zeros((*coordinates.shape[:-1], 0, 3))
    return np.stack(gaps, axis=-2)


def gaps(mechanism: Mechanism, coordinates: Array) -> Array:
    """Return each loop's error, the distance of its two points, (..., n_closures) [m]."""
    return np.linalg.norm(residuals(mechanism, coordinates), axis=-1)


@lru_cache(maxsize=256)
def loops_are_parallelograms(mechanism: Mechanism) -> bool:
    """Return whether the couplings alone close every loop over the joints' range, to 1e-9 m."""
    if not mechanism.closures:
        return True
    share = np.linspace(0.0, 1.0, 33)[:, None]
    q = mechanism.lower + share * (mechanism.upper - mechanism.lower)
    worst = gaps(mechanism, coupled_coordinates(mechanism, q)).max()
    return bool(worst <= PARALLELOGRAM_TOLERANCE_M)


def closed_coordinates(mechanism: Mechanism, q: Array) -> Array:
    """Return every frame's coordinate with the loops closed, (..., n_frames) [rad or m].

    Parallelograms close by their couplings; any other loop is closed by Newton's method from
    there, which keeps the branch.

    Raises:
        LoopError: the loops cannot be closed at these joint positions
    """
    start = coupled_coordinates(mechanism, q)
    if loops_are_parallelograms(mechanism):
        return start
    found, gap = _newton(mechanism, _near(mechanism, q, start))
    worst = float(gap.max(initial=0.0))
    if not worst <= PARALLELOGRAM_TOLERANCE_M:
        raise LoopError(
            f"{mechanism.name}: the loop error is {worst:.3e} m at these joint positions;"
            f" allowed {PARALLELOGRAM_TOLERANCE_M:.0e} m"
        )
    return found


def _newton(mechanism: Mechanism, start: Array) -> tuple[Array, Array]:
    """Close loops as nearly as they get; returns (..., n_frames) and gaps (..., n_closures) [m]."""
    flat = start.reshape(-1, start.shape[-1]).copy()
    passive = passive_frames(mechanism)
    miss = residuals(mechanism, flat)
    before, hopeful = np.full(len(flat), np.inf), np.ones(len(flat), dtype=bool)
    for number in range(NEWTON_STEPS):
        worst = np.abs(miss).max(axis=(1, 2), initial=0.0)
        if number % PATIENCE == 0:
            hopeful &= worst < 0.5 * before
            before = worst
        left = np.flatnonzero(hopeful & (worst >= CLOSED_M))
        if not len(left):
            break
        at = flat[left]
        slope = residual_jacobian(mechanism, at)[..., passive]
        step = np.linalg.pinv(slope, rcond=1e-9) @ miss[left].reshape(len(left), -1, 1)
        at[:, passive] -= np.clip(step[..., 0], -0.2, 0.2)
        flat[left], miss[left] = at, residuals(mechanism, at)
    gap = np.linalg.norm(miss, axis=-1).reshape(*start.shape[:-1], -1)
    return flat.reshape(start.shape), gap


def _near(mechanism: Mechanism, q: Array, start: Array) -> Array:
    """Return coordinates from a table of the closed loops, those given where it does not reach."""
    table = folding_table(mechanism)
    if table is None:
        return start
    passive = passive_frames(mechanism)
    near = start.copy()
    near[..., passive] += table.beyond_start(q)
    return near


@lru_cache(maxsize=64)
def folding_table(mechanism: Mechanism) -> LoopTable | None:
    """Tabulate how far `passive_frames` are from their couplings, None unless one joint folds all.

    Newton's method that starts there has nothing left to do, which is five times faster.
    """
    folding = {
        joint
        for closure in mechanism.closures
        for index in _apart(mechanism, closure)
        if mechanism.frames[index].name not in closure.passive
        for joint, ratio in mechanism.frames[index].couplings
        if ratio
    }
    if len(folding) != 1:
        return None
    column = mechanism.joint_index[folding.pop()]
    positions = nodes(mechanism.lower[column], mechanism.upper[column])
    q = np.tile(np.clip(0.0, mechanism.lower, mechanism.upper), (len(positions), 1))
    q[:, column] = positions
    start = coupled_coordinates(mechanism, q)
    found, gap = _newton(mechanism, start)
    if not gap.max() <= PARALLELOGRAM_TOLERANCE_M:
        return None
    passive = passive_frames(mechanism)
    lower, upper = mechanism.lower[column], mechanism.upper[column]
    return loop_table(column, lower, upper, (found - start)[:, passive])


def _apart(mechanism: Mechanism, closure: Closure) -> set[int]:
    """Return the frames that move one side of a closure only."""
    return set(mechanism.chain(closure.frame_a)) ^ set(mechanism.chain(closure.frame_b))


def coordinate_rates(mechanism: Mechanism, coordinates: Array) -> Array:
    """Return d coordinate / d q with the loops closed, (..., n_frames, n_joints)."""
    lead = coordinates.shape[:-1]
    rates = np.broadcast_to(mechanism.ratios, (*lead, *mechanism.ratios.shape))
    if loops_are_parallelograms(mechanism):
        return rates
    rates = rates.copy()
    passive = passive_frames(mechanism)
    rates[..., passive, :] = 0.0
    slope = residual_jacobian(mechanism, coordinates)
    rates[..., passive, :] = -np.linalg.pinv(slope[..., passive], rcond=1e-9) @ (slope @ rates)
    return rates


def residual_jacobian(mechanism: Mechanism, coordinates: Array) -> Array:
    """Return d residuals / d coordinates, (..., 3 * n_closures, n_frames)."""
    poses = frame_poses(mechanism, coordinates, _loop_frames(mechanism))
    slope = np.zeros((*coordinates.shape[:-1], 3 * len(mechanism.closures), len(mechanism.frames)))
    for row, closure in enumerate(mechanism.closures):
        for side, sign in (("a", -1.0), ("b", 1.0)):
            point = _point(mechanism, closure, poses, side)
            frame = closure.frame_a if side == "a" else closure.frame_b
            for index in mechanism.chain(frame):
                if mechanism.frames[index].motion != "fixed":
                    velocity = point_velocity(mechanism, index, poses, point)
                    slope[..., 3 * row : 3 * row + 3, index] += sign * velocity
    return slope


def branch_determinants(mechanism: Mechanism, coordinates: Array) -> Array:
    """Return the sine of the angle at which each loop stands, (..., n_closures).

    Zero where the loop is flat; its sign is the branch.
    """
    if not mechanism.closures:
        return np.zeros((*coordinates.shape[:-1], 0))
    poses = frame_poses(mechanism, coordinates)
    slope = residual_jacobian(mechanism, coordinates)
    found: list[Array] = []
    for row, closure in enumerate(mechanism.closures):
        first, second = (mechanism.frame_index[name] for name in closure.passive[:2])
        one = slope[..., 3 * row : 3 * row + 3, first]
        two = slope[..., 3 * row : 3 * row + 3, second]
        _, normal = hinge_axis(mechanism, first, poses)
        size = np.linalg.norm(one, axis=-1) * np.linalg.norm(two, axis=-1)
        found.append(np.sum(np.cross(one, two) * normal, axis=-1) / size)
    return np.stack(found, axis=-1)


@lru_cache(maxsize=256)
def _loop_frames(mechanism: Mechanism) -> tuple[int, ...]:
    """Return the indices of the frames that carry closing hinges, from the root."""
    frames = [name for c in mechanism.closures for name in (c.frame_a, c.frame_b)]
    return tuple(sorted({index for name in frames for index in mechanism.chain(name)}))


def passive_frames(mechanism: Mechanism) -> list[int]:
    """Return the indices of the frames whose coordinates the closures determine."""
    return [mechanism.frame_index[name] for c in mechanism.closures for name in c.passive]


@dataclass(frozen=True)
class Flattening:
    """Singular (flat) configuration of a loop as one joint moves.

    Attributes:
        closure: name of the closing point
        joint: the joint that folds the loop
        below, above: joint positions of the nearest singularity on either side [rad]; -inf, inf
            without one within half a turn
        margin: smallest distance from the joint's range, negative inside it [rad]
    """

    closure: str
    joint: str
    below: float
    above: float
    margin: float


def flattenings(mechanism: Mechanism) -> tuple[Flattening, ...]:
    """Find where each loop is singular, for each revolute joint that folds it."""
    found: list[tuple[int, Flattening]] = []
    for column, joint in enumerate(mechanism.joints):
        folded = [
            row
            for row, closure in enumerate(mechanism.closures)
            if mechanism.ratios[[mechanism.frame_index[n] for n in closure.passive], column].any()
        ]
        if joint.kind != "revolute" or not folded:
            continue
        ends = _nearest_flat(mechanism, folded, column).tolist()
        for row, (below, above) in zip(folded, ends, strict=True):
            margin = min(joint.lower - below, above - joint.upper)
            loop = mechanism.closures[row].name
            found.append((row, Flattening(loop, joint.name, below, above, margin)))
    return tuple(flat for _, flat in sorted(found, key=lambda pair: pair[0]))


def _nearest_flat(mechanism: Mechanism, rows: list[int], column: int) -> Array:
    """Walk a joint both ways until each loop's determinant changes sign, and close in on it.

    Rounds cut the step by 32 each: five leave less than 1e-9 rad of half a turn's 180 steps, three
    1e-6 rad, which is enough where Newton's method closes the loops at every position.
    All loops walk at once, since Newton's method takes as long for many positions as for one.

    Returns:
        (len(rows), 2): below and above the middle, infinite where a loop is never flat [rad]
    """
    joint = mechanism.joints[column]
    middle = 0.0 if joint.lower <= 0.0 <= joint.upper else 0.5 * (joint.lower + joint.upper)
    walks = np.repeat(rows, 2), np.tile([-1.0, 1.0], len(rows))
    inside, reach = np.full(2 * len(rows), middle), np.pi * walks[1]
    never = np.zeros(2 * len(rows), np.bool_)
    for points in (180, *[32] * (5 if loops_are_parallelograms(mechanism) else 3)):
        positions = inside[:, None] + reach[:, None] * np.arange(points + 1) / points
        found = _determinants(mechanism, column, positions)
        signs = np.sign(found[np.arange(len(inside)), :, walks[0]])
        changed = signs != signs[:, :1]
        if points == 180:
            never = ~changed.any(axis=1)
        last = np.where(changed.any(axis=1), changed.argmax(axis=1) - 1, points)
        inside = positions[np.arange(len(inside)), last]
        reach = reach / points
    return np.where(never, np.inf * walks[1], inside).reshape(-1, 2)


def _determinants(mechanism: Mechanism, column: int, positions: Array) -> Array:
    """Return every loop's determinant at positions of a joint, (..., n); 0 where one stays open."""
    q = np.tile(np.clip(0.0, mechanism.lower, mechanism.upper), (*positions.shape, 1))
    q[..., column] = positions
    start = coupled_coordinates(mechanism, q)
    if loops_are_parallelograms(mechanism):
        found, gap = start, gaps(mechanism, start)
    else:
        found, gap = _newton(mechanism, _near(mechanism, q, start))
    closed = gap.max(axis=-1, keepdims=True) <= PARALLELOGRAM_TOLERANCE_M
    return np.where(closed, branch_determinants(mechanism, found), 0.0)


def _point(mechanism: Mechanism, closure: Closure, poses: dict[int, Array], side: str) -> Array:
    frame, point = (
        (closure.frame_a, closure.point_a) if side == "a" else (closure.frame_b, closure.point_b)
    )
    pose = poses[mechanism.frame_index[frame]]
    return pose[..., :3, :3] @ point + pose[..., :3, 3]
