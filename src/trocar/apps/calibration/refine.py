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
from scipy.optimize import OptimizeResult, least_squares

from trocar.apps.calibration.geometry import freedoms
from trocar.apps.calibration.linkage import Linkage
from trocar.apps.calibration.motion import marker_poses, mechanism_of, pose_residuals
from trocar.apps.calibration.problem import Problem, eliminate, rows, slopes
from trocar.apps.calibration.register import Registered, Samples, compress, register
from trocar.apps.calibration.start import Robot
from trocar.geometry import inverse

Array = NDArray[np.float64]

ROUNDS = 8
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


def refine(
    robot: Robot,
    samples: Samples,
    q: Array,
    parallelogram: bool,
    watch: Callable[[str], None] = lambda _: None,
) -> Refined:
    """Fit geometry and markers to every sample.

    Args:
        robot: a first guess
        samples: the tracks
        q: a first guess of the joint positions, (n, n_moving) [rad]
        parallelogram: whether the loops close by the couplings alone; else they are four-bars
            with any sides, whose axes may tilt
        watch: is told what is being done
    """
    basis = freedoms(robot.linkage, parallelogram)
    tilted = () if parallelogram else may_tilt(robot.linkage)
    robot = replace(robot, tilts={name: np.zeros(2) for name in tilted})
    camera, q = _start(robot, samples, q), q
    number = 0
    while True:
        number += 1
        watch(f"refinement {number}")
        found = register(robot, samples, camera, q)
        camera, q, samples = found.camera, found.q, replace(samples, seen=found.seen)
        problem = Problem(robot, compress(robot, samples, found), samples.sigmas, basis, tilted)
        solved = _solve(problem)
        robot = problem.moved(solved.x)
        if number == ROUNDS or _settled(solved, samples.sigmas[0]):
            return _result(problem, robot, samples, register(robot, samples, camera, q), solved)


def _settled(solved: OptimizeResult, sigma: float) -> bool:
    """Tell whether a round has moved nothing by more than a small share of its uncertainty."""
    step = np.asarray(solved.x, dtype=np.float64)
    if np.abs(step).max() < max(SETTLED, NOISE_SHARE * sigma):
        return True
    # What the tracks hardly show drifts on and on, and changes nothing that they show.
    shown = np.asarray(solved.jac, dtype=np.float64)[: -len(step)] @ step
    return float(np.linalg.norm(shown)) < SIGMA_SHARE


def may_tilt(linkage: Linkage) -> tuple[str, ...]:
    """Return the frames whose hinges may tilt: all but the first."""
    return tuple(hinge.name for hinge in linkage.hinges if not hinge.closure)[1:]


def _solve(problem: Problem) -> OptimizeResult:
    taken = eliminate(problem)

    def weighted(step: Array) -> Array:
        return rows(problem, taken, step)

    def derivative(step: Array) -> Array:
        return slopes(problem, taken, step)

    return least_squares(
        weighted,
        np.zeros(problem.free + 6 * len(problem.robot.markers)),
        jac=cast(Any, derivative),  # scipy takes a function; its stubs do not say so
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-14,
        max_nfev=6,
    )


def _start(robot: Robot, samples: Samples, q: Array) -> Array:
    """Guess the camera's pose from the first body that each sample has, (n, 4, 4)."""
    expected = marker_poses(robot, mechanism_of(robot), q)
    body = np.argmax(samples.seen, axis=1)
    each = np.arange(len(q))
    return samples.poses[each, body] @ inverse(expected[each, body])


def _result(
    problem: Problem, robot: Robot, samples: Samples, found: Registered, solved: OptimizeResult
) -> Refined:
    jacobian = np.asarray(solved.jac, dtype=np.float64)
    left_over = np.asarray(solved.fun, dtype=np.float64)
    bodies, moving = found.seen.shape[1], found.q.shape[1]
    data = len(left_over) - 6 * bodies - problem.free - moving
    seen = problem.groups.seen.sum(axis=1)
    free = float(np.sum(6 * seen - 6 - moving)) - problem.free - 6 * bodies
    misfit = float(np.sum(left_over[:data] ** 2) / max(free, 1.0))
    covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    k = problem.free
    left = found.residuals[found.seen]
    # Each sample's camera pose and joints take their share of the residuals.
    rest = 1.0 - (6.0 + moving) / (6.0 * float(found.seen.sum(axis=1).mean()))
    position, rotation = (
        float(np.sqrt(np.mean(left[:, part] ** 2) / rest)) for part in (slice(0, 3), slice(3, 6))
    )
    final = replace(problem, robot=robot, groups=compress(robot, samples, found))
    expected = final.expected(np.zeros(len(np.asarray(solved.x))))
    means = pose_residuals(final.groups.measured, expected)[..., :3]
    share = final.groups.counts[:, None] * final.groups.seen
    off = float(np.sqrt(np.sum(share * np.sum(means**2, axis=-1)) / share.sum()))
    return Refined(
        robot=robot,
        basis=problem.basis,
        tilted=problem.tilted,
        covariance=np.asarray(covariance[:k, :k] * max(misfit, 1.0), dtype=np.float64),
        position_rms=position,
        rotation_rms=rotation,
        misfit=misfit,
        misfit_m=off,
        samples=int((found.seen.sum(axis=1) >= 2).sum()),
    )


__all__ = ["Refined", "refine"]
