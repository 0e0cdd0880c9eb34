"""The positions that a tip reaches within the limits of its joints, as a closed surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree  # pyright: ignore[reportMissingTypeStubs]

from trocar.errors import InputError
from trocar.kinematics.chain_pose import ChainPose, chain_pose
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

DIVISIONS = 3
"""Times that the faces of an icosahedron are divided into four: 642 directions, 8 deg apart.
Source: our own choice."""

SAMPLES, FIRST = 40_000, 6_000
"""Joint positions from which targets are tried, and those among which the search of each direction
begins. Source: our own choice."""

ASIDE = 6.0
"""Length along a ray that outweighs a unit of distance from it, where the search of a direction
begins. Source: our own choice."""

STRIDE_M, CLOSE_M = 0.02, 2.5e-4
"""First step along a ray, and the step at which the search ends [m]. Source: our own choice."""

NEIGHBOURS = 6
"""Samples near a target from which it is tried, too, in turn. Source: our own choice."""

MOST_ROUNDS, ITERATIONS, STALLS = 80, 25, 4
"""Bounds of steps along a ray and of iterations to a target, and iterations that must halve the
distance to it. Source: our own choice."""

REACHED_M = 2e-5
"""Distance from a target at which it is reached [m]. Source: a tenth of `CLOSE_M`."""

DAMPING = 1e-6
"""Added to the squares of the joints' motion, in units of their ranges [m2]. Source: our own
choice: a tip that moves 1 mm over a joint's range is followed."""

SLOPE = 1e-6
"""Part of a joint's range over which a derivative is taken. Source: our own choice."""

FLAT_M, PROBES = 1e-3, 200
"""Way of the tip across all others below which its positions are no volume [m], and joint positions
at which it is taken. Source: our own choice."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Closed surface around the positions that a tip can reach.

    Attributes:
        centre: the tip in the middle of the joints' ranges, (3,) [m]
        vertices: farthest positions of the tip in each direction from the centre, (n, 3) [m]
        faces: triangles of vertices, counter-clockwise from outside, (k, 3)
        joints: joint positions with the tip at each vertex, (n, n_joints) [rad or m]
    """

    centre: Array
    vertices: Array
    faces: NDArray[np.int64]
    joints: Array

    @property
    def volume(self) -> float:
        """Volume inside the surface [m3]."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(np.sum(np.cross(a, b) * c) / 6.0)


@lru_cache(maxsize=32)
def workspace(mechanism: Mechanism, divisions: int = DIVISIONS) -> Workspace:
    """Return the farthest positions of the tip, in the mechanism's reference frame.

    Each vertex is the last position on its ray from the centre that the tip reaches in some
    orientation; a hole between the centre and that position is not shown. The same mechanism has
    the same surface, computed once: the search draws from a generator of a fixed seed.

    Args:
        mechanism: the tree with its loops
        divisions: of the faces of an icosahedron, whose vertices are the directions

    Raises:
        InputError: the positions of the tip are no volume, as those of an arm with two joints
        LoopError: the loops cannot be closed between the limits
    """
    rng = np.random.default_rng(0)
    pose = chain_pose(mechanism)
    lower, span = mechanism.lower, mechanism.upper - mechanism.lower
    middle = lower + 0.5 * span
    if not mechanism.within(middle):
        middle = _nearest_within(mechanism, middle, rng)
    moves = np.flatnonzero(_moves_tip(pose, middle, span))
    q = np.tile(middle, (SAMPLES, 1))
    # Half of the joints stand at a limit: the farthest positions have most of theirs there.
    share = np.clip(2.0 * rng.random((SAMPLES, len(moves))) - 0.5, 0.0, 1.0)
    q[:, moves] = lower[moves] + share * span[moves]
    q = q[mechanism.within(q)]
    _check_volume(mechanism, pose, q[:PROBES])
    tips, centre = pose(q)[:, :3, 3], pose(middle)[:3, 3]
    directions, faces = icosphere(divisions)
    reach = _Reach(mechanism, pose, moves)
    best, far = np.tile(middle, (len(directions), 1)), np.zeros(len(directions))
    scores = [_score(tips[:FIRST], centre, way) for way in directions]
    start = q[[int(np.argmax(score)) for score in scores]]
    ahead, stride = np.array([score.max() for score in scores]), np.full(len(best), STRIDE_M)
    near = cast(Any, KDTree)(tips)  # its types are partial
    for number in range(MOST_ROUNDS):
        rows = np.flatnonzero(stride > CLOSE_M)
        if not len(rows):
            break
        goal = np.where(number == 0, np.maximum(ahead, 0.0), far + stride)[rows]
        targets = centre + goal[:, None] * directions[rows]
        found, met = reach(targets, start[rows] if number == 0 else best[rows])
        if not met.all():
            lost = np.flatnonzero(~met)
            order = np.asarray(near.query(targets[lost], NEIGHBOURS)[1])
            other = order[np.arange(len(lost)), (number + rows[lost]) % NEIGHBOURS]
            found[lost], met[lost] = reach(targets[lost], q[other])
        best[rows[met]], far[rows[met]] = found[met], goal[met]
        if number > 0:
            stride[rows] *= np.where(met, 1.3, 0.6)
    return Workspace(centre, pose(best)[:, :3, 3], faces, best)


class _Reach:
    """Find joint positions within the limits whose tips are at targets, in any orientation."""

    def __init__(self, mechanism: Mechanism, pose: ChainPose, moves: NDArray[np.intp]) -> None:
        self._pose, self._moves, self._mechanism = pose, moves, mechanism
        self._lower, self._span = mechanism.lower[moves], (mechanism.upper - mechanism.lower)[moves]
        ends = np.array([(frame.lower, frame.upper) for frame in mechanism.frames])
        bounded = np.isfinite(ends).any(axis=-1)
        self._ends, self._ratios = ends[bounded], mechanism.ratios[bounded]

    def __call__(self, targets: Array, q: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return joint positions, (n, n_joints), and whether they are at the targets, (n,)."""
        q = q.copy()
        met, given_up = np.zeros((2, len(q)), dtype=bool)
        before = np.full(len(q), np.inf)
        count = len(self._moves)
        for number in range(ITERATIONS):
            rows = np.flatnonzero(~(met | given_up))
            if not len(rows):
                break
            at = q[rows]
            bent = np.repeat(at[:, None], count + 1, axis=1)
            joints = np.arange(count)
            bent[:, joints, self._moves] += SLOPE * self._span
            values = self._values(bent, targets[rows, None])
            off = values[:, -1]
            size = np.linalg.norm(off, axis=-1)
            met[rows] = (size < REACHED_M) & self._mechanism.within(at)
            if number % STALLS == 0:
                given_up[rows] = size > 0.5 * before[rows]
                before[rows] = size
            rates = np.swapaxes(values[:, :-1] - off[:, None], 1, 2) / SLOPE
            share = (at[:, self._moves] - self._lower) / self._span
            slope = np.einsum("nij,ni->nj", rates, off)
            stuck = ((share <= 1e-12) & (slope > 0.0)) | ((share >= 1 - 1e-12) & (slope < 0.0))
            J = np.where(stuck[:, None], 0.0, rates)
            square = J @ np.swapaxes(J, 1, 2) + DAMPING * np.eye(J.shape[1])
            step = -np.einsum("nij,ni->nj", J, np.linalg.solve(square, off[..., None])[..., 0])
            step *= np.minimum(1.0, 0.3 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
            moved = self._lower + np.clip(share + step, 0.0, 1.0) * self._span
            going = ~(met | given_up)[rows]
            q[np.ix_(rows[going], self._moves)] = moved[going]
        return q, met

    def _values(self, q: Array, targets: Array) -> Array:
        """Return tips relative to targets, and actuators beyond their ranges, (..., 3 + k)."""
        off = self._pose(q)[..., :3, 3] - targets
        where = q @ self._ratios.T
        beyond = where - np.clip(where, *self._ends.T)
        return np.concatenate([off, beyond], axis=-1)


def _score(tips: Array, centre: Array, directions: Array) -> Array:
    """Rate tips by their length along rays, less `ASIDE` times their distance, (...) [m]."""
    off = tips - centre
    along = np.sum(off * directions, axis=-1)
    aside = np.linalg.norm(off - along[..., None] * directions, axis=-1)
    return along - ASIDE * aside


def _nearest_within(mechanism: Mechanism, q: Array, rng: np.random.Generator) -> Array:
    """Return joint positions in the ranges of joints and actuators, near others."""
    span = mechanism.upper - mechanism.lower
    tried = mechanism.lower + rng.random((SAMPLES, len(q))) * span
    tried = tried[mechanism.within(tried)]
    far = np.linalg.norm((tried - q) / np.maximum(span, 1e-12), axis=-1)
    return tried[int(np.argmin(far))]


def _check_volume(mechanism: Mechanism, pose: ChainPose, q: Array) -> None:
    """Raise InputError where joints move the tip in two directions at most."""
    span = mechanism.upper - mechanism.lower
    bent = q[:, None] + SLOPE * np.diag(span)
    ways = (pose(bent)[..., :3, 3] - pose(q)[:, None, :3, 3]) / SLOPE
    least = np.linalg.svd(ways, compute_uv=False)
    across = float(least[:, 2].max()) if least.shape[1] > 2 else 0.0
    if across < FLAT_M:
        raise InputError(
            f"{mechanism.name}: the positions of its tip are no volume: over the range of a joint"
            f" it moves {1e3 * across:.2g} mm across two directions; allowed: {1e3 * FLAT_M:g} mm"
            " or more"
        )


def _moves_tip(pose: ChainPose, q: Array, span: Array) -> NDArray[np.bool_]:
    """Test each joint for motion of the tip's position, (n_joints,)."""
    crooked = q + 0.2 * span  # in the middle, a shaft that rolls moves no tip on its axis
    tips = pose(crooked + 0.1 * np.diag(span))[:, :3, 3]
    return np.linalg.norm(tips - pose(crooked)[:3, 3], axis=-1) > 1e-9


def icosphere(divisions: int) -> tuple[Array, NDArray[np.int64]]:
    """Make unit vectors spread evenly, (n, 3), and triangles of them, (k, 3)."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    signs = [(a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    points = np.array([np.roll((0.0, a, b), k) for k in range(3) for a, b in signs])
    length = np.linalg.norm(points[:, None] - points[None], axis=-1)
    near = np.isclose(length, 2.0)
    faces = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    triangles = np.array(faces)
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    for _ in range(divisions):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, where = np.unique(edges, axis=0, return_inverse=True)
        middles = points[unique].sum(axis=1)
        middles /= np.linalg.norm(middles, axis=-1, keepdims=True)
        ab, bc, ca = (where.reshape(-1, 3) + len(points)).T
        a, b, c = triangles.T
        points = np.concatenate([points, middles])
        triangles = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inward = np.sum(np.cross(b - a, c - a) * (a + b + c), axis=-1) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return points, triangles
