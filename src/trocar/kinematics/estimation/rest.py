"""The pose of a body that rests, and a pivot told in such a body."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_vector_from_matrix
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.estimation.noise import white_noise
from trocar.kinematics.estimation.pivot import PivotFit, fit_pivot
from trocar.kinematics.estimation.robust import near

Array = NDArray[np.float64]

# Source: our choice; a body whose spread exceeds its white noise by this factor is moving, with
# more room where few samples tell either.
_MOVING, _FEW = 1.15, 6.0
# Source: our choice; more poses than this away from the rest are no gross outliers.
_MOST_OUTLIERS = 0.1
# Source: our choice; what a file's last digit makes of a body at rest [m], [rad].
_ROUNDED = (2e-6, 4e-6)


@dataclass(frozen=True, eq=False)
class RestPose:
    """Where a body rests.

    Attributes:
        pose: in the camera's frame, (4, 4)
        position_sigma, rotation_sigma: of this mean, per axis [m], [rad]
    """

    pose: Array
    position_sigma: float
    rotation_sigma: float


def rest_pose(T_ca: ArrayLike) -> RestPose | None:
    """Average the pose of a body, outliers left out, if it does not move.

    Args:
        T_ca: poses at equal steps of time, (n, 4, 4), NaN where not tracked

    Returns:
        the mean, or None when the poses spread by more than their noise from sample to sample

    Raises:
        InputError: hardly tracked at all
    """
    every = np.asarray(T_ca, dtype=np.float64)
    position_noise, rotation_noise = white_noise(every)
    T = every[np.isfinite(every).all(axis=(1, 2))]
    R, p = _typical(T[:, :3, :3]), np.median(T[:, :3, 3], axis=0)
    away_R, away_p = rotation_vector_from_matrix(R.T @ T[:, :3, :3]), T[:, :3, 3] - p
    used = near(np.linalg.norm(away_R, axis=1)) & near(np.linalg.norm(away_p, axis=1))
    if used.mean() < 1.0 - _MOST_OUTLIERS:
        return None
    away_R, away_p = away_R[used], away_p[used]
    spread = float(away_p.std(axis=0).max()), float(away_R.std(axis=0).max())
    factor = _MOVING + _FEW / float(np.sqrt(used.sum()))
    for got, noise, least in zip(spread, (position_noise, rotation_noise), _ROUNDED, strict=True):
        if got > max(factor * noise, least):
            return None
    pose = transform(R @ matrix_from_rotation_vector(away_R.mean(axis=0)), p + away_p.mean(axis=0))
    root = float(np.sqrt(used.sum()))
    return RestPose(pose, spread[0] / root, spread[1] / root)


def _typical(R: Array) -> Array:
    """Return the rotation that is nearest to all in the sense of least absolute deviations."""
    weights = np.ones(len(R))
    centre = R[0]
    for _ in range(20):
        left, _, right = np.linalg.svd(np.tensordot(weights, R, 1) / weights.sum())
        centre = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        away = np.linalg.norm(R - centre, axis=(1, 2))
        weights = 1.0 / np.maximum(away, max(float(np.median(away)), 1e-12))
    return centre


def fit_pivot_in_body(T_ca: ArrayLike, T_cb: ArrayLike) -> PivotFit:
    """Find the point of b that stays still in a, from the poses of both in the camera's frame.

    Where a rests, its mean pose is taken: its noise then counts once and not in each sample.

    Args:
        T_ca, T_cb: poses at equal steps of time, (n, 4, 4), NaN where not tracked

    Returns:
        the point, `post` and `points` told in a, `tip` in b

    Raises:
        InputError: a body hardly tracked
        UndeterminedError: all rotations share one axis
    """
    a, b = np.asarray(T_ca, dtype=np.float64), np.asarray(T_cb, dtype=np.float64)
    noise = max(white_noise(b)[1], white_noise(a)[1])
    rest = rest_pose(a)
    if rest is None:
        moved = inverse(a) @ b
        return fit_pivot(moved[:, :3, :3], moved[:, :3, 3], rotation_sigma=noise)
    T_ab = inverse(rest.pose) @ b
    fit = fit_pivot(T_ab[:, :3, :3], T_ab[:, :3, 3], rotation_sigma=noise, relative=False)
    across = fit.post @ fit.post - fit.post**2
    more = rest.position_sigma**2 + rest.rotation_sigma**2 * across
    return replace(fit, sigma_post=np.sqrt(fit.sigma_post**2 + more))
