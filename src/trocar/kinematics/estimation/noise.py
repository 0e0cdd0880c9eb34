"""White noise of a body's measured poses, told from the motion by its roughness."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.geometry.rotations import rotation_vector_from_matrix

Array = NDArray[np.float64]

# Source: median of |x| of a normal variable with unit deviation.
_MEDIAN_OF_ABSOLUTE = 0.6744897501960817
# Source: root of the sum of squares of 1, -3, 3, -1.
_THIRD = np.sqrt(20.0)
_LEAST_SAMPLES = 20


def white_noise(T_ca: ArrayLike) -> tuple[float, float]:
    """Estimate the white noise of a body's pose from neighbouring samples.

    Third differences of a motion that is smooth on the scale of a few samples hold noise alone:
    their median size tells it, gross outliers or not. A camera that smooths its poses has less
    noise by this measure than in truth.

    Args:
        T_ca: poses at equal steps of time, (n, 4, 4), NaN where not tracked

    Returns:
        standard deviations per axis of position [m] and rotation [rad]

    Raises:
        InputError: fewer than 20 stretches of four neighbouring poses
    """
    T = np.asarray(T_ca, dtype=np.float64)
    R = T[:, :3, :3]
    position = np.diff(T[:, :3, 3], n=3, axis=0)
    step = np.swapaxes(R[:-1], 1, 2) @ R[1:]
    tracked = np.isfinite(step).all(axis=(1, 2))
    turn = np.full((len(step), 3), np.nan)
    turn[tracked] = rotation_vector_from_matrix(step[tracked])
    rotation = np.diff(turn, n=2, axis=0)
    if np.isfinite(position[:, 0]).sum() < _LEAST_SAMPLES:
        raise InputError(
            f"poses of a body: {int(np.isfinite(position[:, 0]).sum())} stretches of four "
            f"neighbouring samples; at least {_LEAST_SAMPLES} wanted"
        )
    return _deviation(position) / _THIRD, _deviation(rotation) / _THIRD


def _deviation(values: Array) -> float:
    return float(np.nanmedian(np.abs(values))) / _MEDIAN_OF_ABSOLUTE
