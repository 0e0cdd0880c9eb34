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
from scipy.optimize import least_squares

from trocar.apps.calibration.geometry import freedoms
from trocar.apps.calibration.level import Level, height
from trocar.apps.calibration.linkage import Linkage
from trocar.apps.calibration.motion import marker_poses, mechanism_of, pose_residuals
from trocar.apps.calibration.problem import (
    HEIGHT_M,
    Problem,
    eliminate,
    height_row,
    rows,
    slopes,
)
from trocar.apps.calibration.register import Registered, Samples, compress, register
from trocar.apps.calibration.start import Robot
from trocar.geometry import inverse

Array = NDArray[np.float64]

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
    found = register(robot, samples, _start(robot, samples, q), q)
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
    return replace(_result(problem, found), history=tuple(history), settled=settled)


def _lower(
    problem: Problem,
    samples: Samples,
    found: Registered,
    step: Array,
    before: float,
    tries: int,
) -> tuple[Robot, Registered] | None:
    """Return the robot at so much of a step that chi-squared falls, None where it never does."""
    for halved in range(tries):
        robot = problem.moved(0.5**halved * step)
        there = register(robot, samples, found.camera, found.q)
        if _left(robot, samples, there, problem.level) < before:
            return robot, there
    return None


def _left(robot: Robot, samples: Samples, found: Registered, level: Level) -> float:
    """Return what is left of all samples, chi-squared, and of the datum's height."""
    share = found.residuals * samples.weights * samples.seen[..., None]
    return float(np.sum(share**2)) + (height(robot, level) / HEIGHT_M) ** 2


def may_tilt(linkage: Linkage) -> tuple[str, ...]:
    """Return the frames whose hinges may tilt: all but the first."""
    return tuple(hinge.name for hinge in linkage.hinges if not hinge.closure)[1:]


def _solve(problem: Problem, sigma: float) -> tuple[Array, bool]:
    """Return a round's step, and whether it is too small to matter."""
    taken = eliminate(problem)

    def weighted(step: Array) -> Array:
        return rows(problem, taken, step)

    def derivative(step: Array) -> Array:
        return slopes(problem, taken, step)

    solved = least_squares(
        weighted,
        np.zeros(problem.free + 6 * len(problem.robot.markers)),
        jac=cast(Any, derivative),  # scipy takes a function; its stubs do not say so
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-14,
        max_nfev=6,
    )
    step = np.asarray(solved.x, dtype=np.float64)
    if np.abs(step).max() < max(SETTLED, NOISE_SHARE * sigma):
        return step, True
    # What the tracks hardly show moves on, and changes nothing that they show.
    shown = np.asarray(solved.jac, dtype=np.float64)[: -len(step)] @ step
    return step, float(np.linalg.norm(shown)) < SIGMA_SHARE


def _start(robot: Robot, samples: Samples, q: Array) -> Array:
    """Guess the camera's pose from the first body that each sample has, (n, 4, 4)."""
    expected = marker_poses(robot, mechanism_of(robot), q)
    body = np.argmax(samples.seen, axis=1)
    each = np.arange(len(q))
    return samples.poses[each, body] @ inverse(expected[each, body])


def _result(problem: Problem, found: Registered) -> Refined:
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
        covariance=_covariance(jacobian, height_row(problem))[:k, :k] * max(misfit, 1.0),
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


__all__ = ["Refined", "refine"]
