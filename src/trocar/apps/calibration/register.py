"""Fit each sample by itself: where the arm stood before the camera, and at which joint positions.

What is left then is compressed: samples at nearly the same joint positions, with the same bodies
tracked, leave nearly the same, and their mean with their number says all that a fit can use.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.motion import marker_poses, marker_rates, mechanism_of, pose_residuals
from trocar.apps.calibration.start import Robot
from trocar.geometry import inverse, matrix_from_rotation_vector, skew

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
RIDGE = 1e-13
#: A sample with fewer bodies tells nothing that a fit needs.
LEAST_BODIES = 3


@dataclass(frozen=True, eq=False)
class Samples:
    """What the tracks have of the bodies.

    Attributes:
        poses: T_camera_markers, (n, n_bodies, 4, 4); anything where `seen` is false
        seen: (n, n_bodies)
        home: samples that stand at joint positions 0, (n,)
        sigmas: noise of a pose, position [m] and rotation [rad] per axis
    """

    poses: Array
    seen: Mask
    home: Mask
    sigmas: tuple[float, float]

    @property
    def weights(self) -> Array:
        """One over the noise of each of six residuals, (6,)."""
        return np.repeat(1.0 / np.array(self.sigmas), 3)


@dataclass(frozen=True, eq=False)
class Registered:
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


def register(robot: Robot, samples: Samples, camera: Array, q: Array) -> Registered:
    """Fit camera pose and joint positions of each sample by weighted least squares.

    Args:
        robot: the geometry, which stays
        samples: what was seen
        camera, q: where to begin, (n, 4, 4) and (n, n_moving)
    """
    mechanism, moving = mechanism_of(robot), q.shape[1]
    camera, q = camera.copy(), q.copy()
    weight = samples.seen[..., None] * samples.weights
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
        step = np.linalg.solve(normal, np.swapaxes(left, -1, -2) @ right[..., None])[..., 0]
        camera = camera @ _small(step[:, :6])
        q = q + step[:, 6:]
        if np.abs(step).max(initial=0.0) < 1e-12:
            break
    squared = np.sum((residuals * samples.weights) ** 2, axis=-1)
    # A linkage that does not close leaves more than noise, and that is no reason to drop a sample.
    usual = np.nanmedian(np.where(samples.seen, squared, np.nan), axis=0) / MEDIAN_SQUARED
    return Registered(
        camera, q, residuals, samples.seen & (squared <= FAR_SQUARED * np.maximum(usual, 1.0))
    )


def nuisance_slopes(expected: Array, rates: Array) -> Array:
    """Return how residuals follow a small move of the ground and the joints, (.., nb, 6, 6 + m).

    The residual that they explain is slope @ (shift, turn, joints).
    """
    slope = np.zeros((*expected.shape[:-2], 6, 6 + rates.shape[-1]))
    slope[..., :3, :3] = slope[..., 3:, 3:6] = np.eye(3)
    slope[..., :3, 3:6] = -skew(expected[..., :3, 3])
    slope[..., 6:] = rates
    return slope


def _small(step: Array) -> Array:
    moved = np.zeros((len(step), 4, 4))
    moved[:, :3, :3] = matrix_from_rotation_vector(step[:, 3:6])
    moved[:, :3, 3] = step[:, :3]
    moved[:, 3, 3] = 1.0
    return moved


def compress(robot: Robot, samples: Samples, found: Registered) -> Groups:
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
