"""The joint refinement: all sweeps at once, through the kinematics with the loops closed.

Unknown are the free displacements of the axes, their tilts where loops may be general, and where
the markers sit; camera pose and joint positions of each sample are eliminated. The covariance is
that of the least squares, scaled by what the linkage leaves unexplained.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]
from scipy.optimize import least_squares  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from trocar.geometry import inverse, matrix_from_rotation_vector, pose_residuals, skew
from trocar.robot.calibration.axes import Axes, Home
from trocar.robot.calibration.linkage import LoopedPart, freedoms
from trocar.robot.calibration.robot import (
    Level,
    Robot,
    displaced,
    height,
    height_slope,
    marker_poses,
    marker_rates,
    mechanism_of,
)
from trocar.robot.calibration.tracks import Tracks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEPS = 8
#: Joint positions are gathered in this many steps over their range, of one joint and of more.
#: Source: our own choice; 60 steps of a sweep of 1.2 rad are 20 mrad, over which the slopes that
#: are taken for equal change by 2 %.
BINS, BINS_OF_MORE = 60, 16
# Source: our own choice; a body is left out of a sample where its residual's chi-squared with six
# degrees of freedom passes what one in a million does.
FAR_SQUARED, MEDIAN_SQUARED = 38.0, 5.35
#: ... or what its neighbours in time have, so many of them. Source: our own choice; cameras lose a
#: body for a dozen samples, and take it wrongly for one or two.
NEIGHBOURS = 9
RIDGE = 1e-13
#: A sample with fewer bodies tells nothing that a fit needs.
LEAST_BODIES = 3
#: Noise is taken to be at least this, so that exact tracks can be weighted: rounding. [m], [rad]
LEAST_NOISE = (1e-10, 1e-9)


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of the bodies in the tracks.

    Attributes:
        poses: T_camera_markers, (n, n_bodies, 4, 4); anything where `seen` is false
        seen: (n, n_bodies)
        home: samples that stand at joint positions 0, (n,)
        sigmas: noise of a pose, position [m] and rotation [rad] per axis
        widened: factor by which noise correlated in time widens standard deviations
    """

    poses: Array
    seen: Mask
    home: Mask
    sigmas: tuple[float, float]
    widened: float = 1.0

    @property
    def weights(self) -> Array:
        """One over the noise of each of six residuals, (6,)."""
        return np.repeat(1.0 / np.array(self.sigmas), 3)


def seen_samples(tracks: Tracks, axes: Axes, home: Home, robot: Robot) -> tuple[Samples, Array]:
    """Gather the poses of the linkage's bodies, without what the hinges found far off.

    Returns:
        the samples, and a first guess of their joint positions, (n, n_moving) [rad]
    """
    bodies = list(robot.markers)
    poses = np.stack([tracks.poses[body] for body in bodies], axis=1)
    seen = np.asarray(np.isfinite(poses).all(axis=(2, 3)))
    for i, body in enumerate(bodies):
        fits = [axes.fits[name] for name in axes.linkage.carried[body] if name in axes.fits]
        seen[:, i] &= np.stack([fit.used for fit in fits]).any(axis=0)
    poses = np.where(seen[..., None, None], poses, np.eye(4))
    enough = seen.sum(axis=1) >= min(LEAST_BODIES, len(bodies))
    position, rotation = axes.noise
    sigmas = (max(position, LEAST_NOISE[0]), max(rotation, LEAST_NOISE[1]))
    some = Samples(poses[enough], seen[enough], home.samples[enough], sigmas, axes.widened)
    return some, _first_positions(axes, home)[enough]


def _first_positions(axes: Axes, home: Home) -> Array:
    """Guess the joint positions from the hinges' angles, (n, n_moving) [rad]."""
    loops = axes.linkage
    columns = list(loops.joints)
    normal = np.zeros((len(home.samples), len(columns), len(columns)))
    right = np.zeros((len(home.samples), len(columns)))
    for name, zero in home.angles.items():
        hinge = loops.hinge[name]
        row = (loops.turns[hinge.body_b] - loops.turns[hinge.body_a])[columns]
        away = np.angle(np.exp(1j * (axes.angles(name) - zero.value)))
        known = np.isfinite(away)
        normal += known[:, None, None] * np.outer(row, row)
        right += np.where(known, away, 0.0)[:, None] * row
    normal += 1e-9 * np.eye(len(columns))
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class RegisteredSamples:
    """Every sample at its own best camera pose and joint positions.

    Attributes:
        camera: T_camera_ground, (n, 4, 4)
        q: joint positions, (n, n_moving) [rad]
        residuals: (n, n_bodies, 6) [m, rad], measured less expected, in the ground's axes
        seen: (n, n_bodies), without what is far off
    """

    camera: Array
    q: Array
    residuals: Array
    seen: Mask


@dataclass(frozen=True, eq=False)
class Groups:
    """Samples at nearly the same joint positions and with the same bodies, taken together.

    Attributes:
        counts: samples in each, (g,)
        q: joint positions of each bin, (n_bins, n_moving)
        bins: which bin each group lies in, (g,)
        measured: T_ground_markers at the bin's joint positions, (g, n_bodies, 4, 4)
        seen: (g, n_bodies)
        home: groups of the still start, (g,)
    """

    counts: Array
    q: Array
    bins: NDArray[np.intp]
    measured: Array
    seen: Mask
    home: Mask


def register(
    robot: Robot, samples: Samples, q: Array, camera: Array | None = None
) -> RegisteredSamples:
    """Fit camera pose and joint positions of each sample by weighted least squares.

    Args:
        robot: the geometry, which stays
        samples: what was seen
        q: joint positions to begin with, (n, n_moving) [rad]
        camera: T_camera_ground to begin with, (n, 4, 4); by default as the first body that each
            sample has shows it at `q`
    """
    mechanism, moving = mechanism_of(robot), q.shape[1]
    weight = samples.seen[..., None] * samples.weights
    if camera is None:
        each = np.arange(len(q)), np.argmax(samples.seen, axis=1)
        camera = samples.poses[each] @ inverse(marker_poses(robot, mechanism, q)[each])
    residuals = np.zeros(0)
    for _ in range(STEPS):
        expected = marker_poses(robot, mechanism, q)
        residuals = pose_residuals(inverse(camera)[:, None] @ samples.poses, expected)
        slope = nuisance_slopes(expected, marker_rates(robot, mechanism, q, expected))
        left = (slope * weight[..., None]).reshape(len(q), -1, 6 + moving)
        right = (residuals * weight).reshape(len(q), -1)
        normal = np.swapaxes(left, -1, -2) @ left
        # What too few bodies leave open stays.
        most = np.maximum(np.max(normal, axis=(-1, -2), keepdims=True), 1.0)
        normal += RIDGE * np.eye(6 + moving) * most
        gradient = np.swapaxes(left, -1, -2) @ right[..., None]
        step = cast(Array, np.linalg.solve(normal, gradient)[..., 0])
        camera = camera @ _small_pose(step[:, :6])
        q = q + step[:, 6:]
        if np.abs(step).max(initial=0.0) < 1e-12:
            break
    squared = np.sum((residuals * samples.weights) ** 2, axis=-1)
    # A linkage that does not close leaves more than noise, and its neighbours in time as much: that
    # is no reason to drop a sample, though others, in which the loops rest, leave nothing.
    usual = np.nanmedian(np.where(samples.seen, squared, np.nan), axis=0)
    shown = np.where(samples.seen, squared, usual)
    near = cast(Array, median_filter(shown, (NEIGHBOURS, 1), mode="nearest"))
    most = FAR_SQUARED * np.maximum(np.maximum(near, usual) / MEDIAN_SQUARED, 1.0)
    return RegisteredSamples(camera, q, residuals, samples.seen & (squared <= most))


def nuisance_slopes(expected: Array, rates: Array) -> Array:
    """Return the derivative of residuals by ground and joints, (.., nb, 6, 6 + m).

    The residual that they explain is slope @ (shift, turn, joints).
    """
    slope = np.zeros((*expected.shape[:-2], 6, 6 + rates.shape[-1]))
    slope[..., :3, :3] = slope[..., 3:, 3:6] = np.eye(3)
    slope[..., :3, 3:6] = -skew(expected[..., :3, 3])
    slope[..., 6:] = rates
    return slope


def _small_pose(step: Array) -> Array:
    moved = np.zeros((len(step), 4, 4))
    moved[:, :3, :3] = matrix_from_rotation_vector(step[:, 3:6])
    moved[:, :3, 3] = step[:, :3]
    moved[:, 3, 3] = 1.0
    return moved


def compress(robot: Robot, samples: Samples, found: RegisteredSamples) -> Groups:
    """Gather samples by joint positions and by which bodies they have."""
    enough = found.seen.sum(axis=1) >= min(LEAST_BODIES, found.seen.shape[1])
    q, seen, home = found.q[enough], found.seen[enough], samples.home[enough]
    steps = BINS if q.shape[1] == 1 else BINS_OF_MORE
    span = np.maximum(q.max(axis=0) - q.min(axis=0), 1e-9)
    cell = np.minimum(((q - q.min(axis=0)) / span * steps).astype(int), steps - 1)
    cells, cell_of = np.unique(np.column_stack([cell, home]), axis=0, return_inverse=True)
    cell_of = cell_of.ravel()
    middle = _means(q, cell_of, len(cells))
    groups, group_of = np.unique(np.column_stack([cell_of, seen]), axis=0, return_inverse=True)
    left = _means(found.residuals[enough] * seen[..., None], group_of.ravel(), len(groups))
    bins = groups[:, 0].astype(np.intp)
    measured = marker_poses(robot, mechanism_of(robot), middle)[bins]
    measured[..., :3, 3] += left[..., :3]
    measured[..., :3, :3] = matrix_from_rotation_vector(left[..., 3:]) @ measured[..., :3, :3]
    return Groups(
        counts=np.bincount(group_of.ravel()).astype(np.float64),
        q=middle,
        bins=bins,
        measured=measured,
        seen=groups[:, 1:].astype(bool),
        home=cells[bins, -1].astype(bool),
    )


def _means(values: Array, which: NDArray[np.intp], count: int) -> Array:
    """Return the mean of the rows of each group, (count, ...)."""
    flat = values.reshape(len(which), -1)
    order = np.argsort(which, kind="stable")
    sizes = np.bincount(which, minlength=count)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    total = np.add.reduceat(flat[order], starts, axis=0)
    return (total / sizes[:, None]).reshape(count, *values.shape[1:])


# What the tracks leave open stays where it was; weak enough to pull nothing else. [m, rad]
LEASH = 1.0
#: Largest distance of a pin from the linkage's plane. The plane's place along the axes follows from
#: the datum, and else from second-order effects of the pins alone (see `level`), which tracks
#: without noise show. Source: our own choice. [m]
HEIGHT_M = 0.1
# Source: our own choice; displacements of 1 um give slopes to 1e-9 and rounding of 1e-10.
DISPLACED = 1e-6
#: Home is known no better than this, so that exact tracks can be weighted: rounding. [rad]
HOME_RAD = 1e-12


@dataclass(frozen=True, eq=False)
class Problem:
    """One round of least squares about a robot, at groups of samples."""

    robot: Robot
    groups: Groups
    sigmas: tuple[float, float]
    basis: Array
    tilted: tuple[str, ...]
    level: Level

    @property
    def free(self) -> int:
        """Return the number of unknowns of the geometry; six of each body's markers follow."""
        return self.basis.shape[1] + 2 * len(self.tilted)

    def moved(self, step: Array) -> Robot:
        """Return the robot at a step of the unknowns."""
        robot = displaced(self.robot, self.basis, self.tilted, step)
        markers: dict[str, Array] = {}
        for i, (body, pose) in enumerate(robot.markers.items()):
            twist = step[self.free + 6 * i : self.free + 6 * i + 6]
            here = pose.copy()
            here[:3, 3] += pose[:3, :3] @ twist[:3]
            here[:3, :3] = pose[:3, :3] @ matrix_from_rotation_vector(twist[3:])
            markers[body] = here
        return replace(robot, markers=markers)

    @property
    def datum_columns(self) -> slice:
        """The unknowns that shift and turn the markers which have the datum."""
        at = self.free + 6 * list(self.robot.markers).index(self.level.body)
        return slice(at, at + 6)

    def expected(self, step: Array) -> Array:
        """Return the markers' poses at a step, (g, n_bodies, 4, 4)."""
        return self.in_bins(step)[self.groups.bins]

    def in_bins(self, step: Array) -> Array:
        """Return the same for each bin, (n_bins, n_bodies, 4, 4)."""
        robot = self.moved(step)
        return marker_poses(robot, mechanism_of(robot), self.groups.q)


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Projections that take camera pose and joint positions out of a problem.

    Attributes:
        project: of each group, (g, 6 n_bodies, 6 n_bodies); weights and the square root of the
            number of samples are in it
        home: derivatives of home's mean joint positions by the residuals, (n_moving, g, 6 n_bodies)
        at_home: these mean positions before, (n_moving,) [rad]
        home_sigma: their noise, (n_moving,) [rad]
    """

    project: Array
    home: Array
    at_home: Array
    home_sigma: Array


def eliminate(problem: Problem) -> Eliminated:
    """Return the projections that take camera pose and joint positions out of a problem."""
    robot, groups = problem.robot, problem.groups
    expected = marker_poses(robot, mechanism_of(robot), groups.q)
    rates = marker_rates(robot, mechanism_of(robot), groups.q, expected)
    every = nuisance_slopes(expected, rates)[groups.bins]
    weight = groups.seen[..., None] * np.repeat(1.0 / np.array(problem.sigmas), 3)
    slope = (every * weight[..., None]).reshape(len(weight), -1, every.shape[-1])
    scale = np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-300)
    solve = cast(Array, np.linalg.pinv(slope / scale, rcond=1e-9))
    flat = weight.reshape(len(weight), -1)
    keep = np.eye(slope.shape[1]) - (slope / scale) @ solve
    joints = (solve / np.swapaxes(scale, 1, 2))[:, 6:]
    still = groups.counts * groups.home
    share = still / max(float(still.sum()), 1.0)
    variance = share @ np.sum(joints**2, axis=2) / max(float(still.sum()), 1.0)
    return Eliminated(
        project=keep * flat[:, None, :] * np.sqrt(groups.counts)[:, None, None],
        home=np.swapaxes(joints * flat[:, None, :] * share[:, None, None], 0, 1),
        at_home=share @ groups.q[groups.bins],
        home_sigma=np.maximum(np.sqrt(variance), HOME_RAD),
    )


def rows(problem: Problem, taken: Eliminated, step: Array) -> Array:
    """Return every weighted residual at a step of the unknowns, (rows,)."""
    left = pose_residuals(problem.groups.measured, problem.expected(step))
    left = left.reshape(len(left), -1)
    at_home = taken.at_home + np.einsum("jgr,gr->j", taken.home, left)
    return np.concatenate(
        [
            np.einsum("grs,gs->gr", taken.project, left).ravel(),
            at_home / taken.home_sigma,
            [height(problem.moved(step), problem.level) / HEIGHT_M],
            step / LEASH,
        ]
    )


def slopes(problem: Problem, taken: Eliminated, step: Array) -> Array:
    """Return the derivative of `rows`, (rows, unknowns)."""
    slope = -expected_slopes(problem, step)
    slope = slope.reshape(len(slope), -1, slope.shape[-1])
    return np.vstack(
        [
            np.einsum("grs,gsk->grk", taken.project, slope).reshape(-1, slope.shape[-1]),
            np.einsum("jgr,grk->jk", taken.home, slope) / taken.home_sigma[:, None],
            height_row(problem) / HEIGHT_M,
            np.eye(slope.shape[-1]) / LEASH,
        ]
    )


def height_row(problem: Problem) -> Array:
    """Return the derivative of the datum's height by the unknowns, (1, unknowns)."""
    row = np.zeros((1, problem.free + 6 * len(problem.robot.markers)))
    row[0, problem.datum_columns] = height_slope(problem.robot, problem.level)
    return row


def expected_slopes(problem: Problem, step: Array) -> Array:
    """Return d expected / d unknowns, (g, n_bodies, 6, unknowns)."""
    expected = problem.in_bins(step)
    slope = np.zeros((*expected.shape[:2], 6, len(step)))
    for column in range(problem.free):
        away = DISPLACED * np.eye(len(step))[column]
        plus, minus = problem.in_bins(step + away), problem.in_bins(step - away)
        slope[..., column] = pose_residuals(plus, minus) / (2.0 * DISPLACED)
    for body in range(expected.shape[1]):
        at = problem.free + 6 * body
        # Markers move in the axes that they had before this round.
        turn = expected[:, body, :3, :3]
        slope[:, body, :3, at : at + 3] = turn
        slope[:, body, 3:, at + 3 : at + 6] = turn
    return slope[problem.groups.bins]


#: Source: our own choice; four or five do under noise, tracks without it up to eighteen.
ROUNDS = 20
#: A step that does not make chi-squared less is halved so many times. Source: our own choice; what
#: is left of it then is less than a hundredth of a standard deviation.
HALVINGS = 7
#: Refined when nothing moves by more than this between two rounds. [m, rad]
SETTLED = 1e-10
#: Or than this share of the noise of a pose. Source: our own choice.
NOISE_SHARE = 1e-4
#: Or by this many standard deviations of the geometry. Source: our own choice.
SIGMA_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Refined:
    """A robot that fits all sweeps at once.

    Attributes:
        robot: its geometry
        basis: the free displacements, (2 n_slots, n_free)
        tilted: frames whose hinges may tilt
        covariance: of the free displacements, then of the tilts (two each), (k, k) [m, rad]
        position_rms, rotation_rms: what is left of a pose, per axis [m], [rad]
        misfit: what is left of the groups' means, chi-squared per degree of freedom; 1 where noise
            is all there is
        misfit_m: root of the mean squared position that the linkage cannot explain [m]
        samples: how many were used
        history: chi-squared of all samples before each round, and at last
        settled: whether the rounds came to an end
    """

    robot: Robot
    basis: Array
    tilted: tuple[str, ...]
    covariance: Array
    position_rms: float
    rotation_rms: float
    misfit: float
    misfit_m: float
    samples: int
    history: tuple[float, ...] = ()
    settled: bool = False


def refine(
    robot: Robot,
    samples: Samples,
    q: Array,
    parallelogram: bool,
    level: Level,
    watch: Callable[[str], None] = lambda _: None,
) -> Refined:
    """Fit geometry and markers to every sample.

    Each round takes the kinematics for linear about the last one's robot. Its step is taken as far
    as what is left of all samples becomes less: chi-squared never rises.

    Args:
        robot: a first guess
        samples: the tracks
        q: a first guess of the joint positions, (n, n_moving) [rad]
        parallelogram: whether the loops close by the couplings alone; else they are four-bars
            with any sides, whose axes may tilt
        level: where the linkage's plane passes
        watch: is told what is being done
    """
    tilted = () if parallelogram else may_tilt(robot.linkage)
    robot = replace(robot, tilts={name: np.zeros(2) for name in tilted})
    free = freedoms(robot.linkage, parallelogram), tilted
    found = register(robot, samples, q)
    history: list[float] = []
    settled = False
    while not settled and len(history) < ROUNDS:
        watch(f"refinement {len(history) + 1}")
        samples = replace(samples, seen=found.seen)
        problem = Problem(robot, compress(robot, samples, found), samples.sigmas, *free, level)
        step, settled = _solve(problem, samples.sigmas[0])
        history.append(_left(robot, samples, found, level))
        lower = _lower(problem, samples, found, step, history[-1], 1 if settled else HALVINGS)
        settled = settled or lower is None
        robot, found = lower or (robot, found)
    history.append(_left(robot, samples, found, level))
    problem = Problem(robot, compress(robot, samples, found), samples.sigmas, *free, level)
    return replace(
        _result(problem, found, samples.widened), history=tuple(history), settled=settled
    )


def _lower(
    problem: Problem,
    samples: Samples,
    found: RegisteredSamples,
    step: Array,
    before: float,
    tries: int,
) -> tuple[Robot, RegisteredSamples] | None:
    """Return the robot at so much of a step that chi-squared falls, None where it never does."""
    for halved in range(tries):
        robot = problem.moved(0.5**halved * step)
        there = register(robot, samples, found.q, found.camera)
        if _left(robot, samples, there, problem.level) < before:
            return robot, there
    return None


def _left(robot: Robot, samples: Samples, found: RegisteredSamples, level: Level) -> float:
    """Return chi-squared of all samples and of the datum's height."""
    share = found.residuals * samples.weights * samples.seen[..., None]
    return float(np.sum(share**2)) + (height(robot, level) / HEIGHT_M) ** 2


def may_tilt(linkage: LoopedPart) -> tuple[str, ...]:
    """Return the frames whose hinges may tilt: all but the first."""
    return tuple(hinge.name for hinge in linkage.hinges if not hinge.closure)[1:]


def _solve(problem: Problem, sigma: float) -> tuple[Array, bool]:
    """Return a round's step, and whether it is too small to matter."""
    taken = eliminate(problem)

    def weighted(step: Array) -> Array:
        return rows(problem, taken, step)

    def derivative(step: Array) -> Array:
        return slopes(problem, taken, step)

    solved = cast(
        Any,
        least_squares(
            weighted,
            np.zeros(problem.free + 6 * len(problem.robot.markers)),
            jac=cast(Any, derivative),  # scipy takes a function; its stubs do not say so
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-14,
            max_nfev=6,
        ),
    )
    step = np.asarray(solved.x, dtype=np.float64)
    if np.abs(step).max() < max(SETTLED, NOISE_SHARE * sigma):
        return step, True
    # What the tracks hardly show moves on, and changes nothing that they show.
    shown = np.asarray(solved.jac, dtype=np.float64)[: -len(step)] @ step
    return step, float(np.linalg.norm(shown)) < SIGMA_SHARE


def _result(problem: Problem, found: RegisteredSamples, widened: float) -> Refined:
    taken = eliminate(problem)
    here = np.zeros(problem.free + 6 * len(problem.robot.markers))
    jacobian, left_over = slopes(problem, taken, here), rows(problem, taken, here)
    bodies, moving = found.seen.shape[1], found.q.shape[1]
    data = left_over[: problem.groups.seen.size * 6]
    seen = problem.groups.seen.sum(axis=1)
    free = float(np.sum(6 * seen - 6 - moving)) - problem.free - 6 * bodies
    misfit = float(np.sum(data**2) / max(free, 1.0))
    k = problem.free
    left = found.residuals[found.seen]
    # Each sample's camera pose and joints take their share of the residuals.
    rest = 1.0 - (6.0 + moving) / (6.0 * float(found.seen.sum(axis=1).mean()))
    position, rotation = (
        float(np.sqrt(np.mean(left[:, part] ** 2) / rest)) for part in (slice(0, 3), slice(3, 6))
    )
    means = pose_residuals(problem.groups.measured, problem.expected(here))[..., :3]
    share = problem.groups.counts[:, None] * problem.groups.seen
    off = float(np.sqrt(np.sum(share * np.sum(means**2, axis=-1)) / share.sum()))
    return Refined(
        robot=problem.robot,
        basis=problem.basis,
        tilted=problem.tilted,
        covariance=_covariance(jacobian, height_row(problem))[:k, :k] * max(misfit, widened**2),
        position_rms=position,
        rotation_rms=rotation,
        misfit=misfit,
        misfit_m=off,
        samples=int((found.seen.sum(axis=1) >= 2).sum()),
    )


def _covariance(jacobian: Array, held: Array) -> Array:
    """Return the covariance of the unknowns where some combinations stay, (rows, unknowns)."""
    free = np.linalg.svd(held)[2][len(held) :].T
    inside = jacobian @ free
    within = np.linalg.pinv(inside.T @ inside, hermitian=True)
    return np.asarray(free @ within @ free.T, dtype=np.float64)
