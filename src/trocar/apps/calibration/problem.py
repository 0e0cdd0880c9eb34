"""One round of the joint refinement: weighted least squares at groups of samples.

Camera pose and joint positions of each group are eliminated: residuals are projected on what no
camera pose and no joint position explains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.level import Level, height, height_slope
from trocar.apps.calibration.motion import (
    marker_poses,
    marker_rates,
    mechanism_of,
    pose_residuals,
)
from trocar.apps.calibration.register import Groups, nuisance_slopes
from trocar.apps.calibration.start import Robot
from trocar.geometry import matrix_from_rotation_vector

Array = NDArray[np.float64]

# What the tracks leave open stays where it was; weak enough to pull nothing else. [m, rad]
LEASH = 1.0
#: Where along the axes the linkage's plane lies is told by the datum, and else by second-order
#: effects of the pins alone (see `level`), which tracks without noise show. Source: our own choice;
#: how far from that plane a pin may sit. [m]
HEIGHT_M = 0.1
# Source: our own choice; displacements of 1 um give slopes to 1e-9 and rounding of 1e-10.
STEP = 1e-6
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
        """How many unknowns the geometry has; six of each body's markers follow."""
        return self.basis.shape[1] + 2 * len(self.tilted)

    def moved(self, step: Array) -> Robot:
        """Return the robot at a step of the unknowns."""
        robot, n = self.robot, self.basis.shape[1]
        tilts = {
            name: robot.tilts.get(name, np.zeros(2)) + step[n + 2 * i : n + 2 * i + 2]
            for i, name in enumerate(self.tilted)
        }
        markers: dict[str, Array] = {}
        for i, (body, pose) in enumerate(robot.markers.items()):
            twist = step[self.free + 6 * i : self.free + 6 * i + 6]
            here = pose.copy()
            here[:3, 3] += pose[:3, :3] @ twist[:3]
            here[:3, :3] = pose[:3, :3] @ matrix_from_rotation_vector(twist[3:])
            markers[body] = here
        displaced = robot.moved + (self.basis @ step[:n]).reshape(-1, 2)
        return replace(robot, moved=displaced, tilts=tilts, markers=markers)

    @property
    def datum_columns(self) -> slice:
        """The unknowns that shift and turn the markers which have the datum."""
        at = self.free + 6 * list(self.robot.markers).index(self.level.body)
        return slice(at, at + 6)

    def expected(self, step: Array) -> Array:
        """Return where the markers are at a step, (g, n_bodies, 4, 4)."""
        return self.in_bins(step)[self.groups.bins]

    def in_bins(self, step: Array) -> Array:
        """Return the same for each bin, (n_bins, n_bodies, 4, 4)."""
        robot = self.moved(step)
        return marker_poses(robot, mechanism_of(robot), self.groups.q)


@dataclass(frozen=True, eq=False)
class Eliminated:
    """What takes camera pose and joint positions out of a problem.

    Attributes:
        project: of each group, (g, 6 n_bodies, 6 n_bodies); weights and the square root of the
            number of samples are in it
        home: what the residuals do to the mean joint positions of home, (n_moving, g, 6 n_bodies)
        at_home: these mean positions before, (n_moving,) [rad]
        home_sigma: their noise, (n_moving,) [rad]
    """

    project: Array
    home: Array
    at_home: Array
    home_sigma: Array


def eliminate(problem: Problem) -> Eliminated:
    """Return what takes camera pose and joint positions out of a problem."""
    robot, groups = problem.robot, problem.groups
    expected = marker_poses(robot, mechanism_of(robot), groups.q)
    rates = marker_rates(robot, mechanism_of(robot), groups.q, expected)
    every = nuisance_slopes(expected, rates)[groups.bins]
    weight = groups.seen[..., None] * np.repeat(1.0 / np.array(problem.sigmas), 3)
    slope = (every * weight[..., None]).reshape(len(weight), -1, every.shape[-1])
    scale = np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-300)
    solve = np.linalg.pinv(slope / scale, rcond=1e-9)
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
    """Return how the height of the datum follows the unknowns, (1, unknowns)."""
    row = np.zeros((1, problem.free + 6 * len(problem.robot.markers)))
    row[0, problem.datum_columns] = height_slope(problem.robot, problem.level)
    return row


def expected_slopes(problem: Problem, step: Array) -> Array:
    """Return d expected / d unknowns, (g, n_bodies, 6, unknowns)."""
    expected = problem.in_bins(step)
    slope = np.zeros((*expected.shape[:2], 6, len(step)))
    for column in range(problem.free):
        away = STEP * np.eye(len(step))[column]
        plus, minus = problem.in_bins(step + away), problem.in_bins(step - away)
        slope[..., column] = pose_residuals(plus, minus) / (2.0 * STEP)
    for body in range(expected.shape[1]):
        at = problem.free + 6 * body
        # Markers move in the axes that they had before this round.
        turn = expected[:, body, :3, :3]
        slope[:, body, :3, at : at + 3] = turn
        slope[:, body, 3:, at + 3 : at + 6] = turn
    return slope[problem.groups.bins]
