"""The closed-loop paper's plain least squares, to compare with: no weights, nothing left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.kinematics.estimation.axes import Axis
from trocar.kinematics.estimation.hinge import check_poses
from trocar.kinematics.estimation.robust import weighted_point

Array = NDArray[np.float64]


def fit_hinge_least_squares(T_ab: ArrayLike) -> tuple[Axis, Axis]:
    """Find a hinge's axis as the paper does: least squares, every sample alike.

    The direction is what the rotations change least, `R_k h_b = h_a`; the point is what the poses
    move least, `R_k g_b + p_k = g_a`, no way along the axis. With noise in R the point is drawn to
    b's origin, the more so the smaller the sweep.

    Source: section 2.4 of the closed-loop paper; Gamage and Lasenby, New least squares solutions
    for estimating the average centre of rotation and the axis of rotation, 2002.

    Args:
        T_ab: poses of b in a, (n, 4, 4); NaN where either was not tracked

    Returns:
        the axis in a and in b, without influences

    Raises:
        InputError: wrong shape, or too few poses
    """
    T, tracked = check_poses(T_ab)
    R, p = T[tracked, :3, :3], T[tracked, :3, 3]
    left, _, right = np.linalg.svd(R.mean(axis=0))
    g_a, g_b = weighted_point(R, p, np.ones(len(R)))
    nothing = np.zeros((len(T), 6))
    return Axis(g_a, left[:, 0], nothing), Axis(g_b, right[0], nothing)
