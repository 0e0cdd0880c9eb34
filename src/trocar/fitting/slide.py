"""The slide between two bodies: a direction along which one moves in the other without a turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.fitting.hinge import check_poses
from trocar.fitting.robust import near, shared_line, shared_rotation, widening
from trocar.geometry.rotations import rotation_vector_from_matrix

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SlideFit:
    """A slide: T_ab = (rotation, point + position * direction_a).

    Attributes:
        direction_a, direction_b: unit vectors along it in a and in b, (3,) each
        rotation: of b in a, (3, 3)
        point: origin of b in a at position 0, midway, (3,) [m]
        positions: of each sample, (n,) [m], NaN for those left out
        used: which samples count, (n,)
        span: from the first to the last position [m]
        residual_position: RMS distance of b from the line [m]
        residual_rotation: RMS turn of b [rad]
        influence_a: effect of each sample's residual on direction_a, on b's origin and on its
            rotation (a small turn in a), (n, 9)
        outliers: samples that were tracked and left out
        widened: how much noise that is correlated in time widens standard deviations; the
            influences have it
    """

    direction_a: Array
    direction_b: Array
    rotation: Array
    point: Array
    positions: Array
    used: Mask
    span: float
    residual_position: float
    residual_rotation: float
    influence_a: Array
    outliers: int
    widened: float


def fit_slide(T_ab: ArrayLike) -> SlideFit:
    """Find the direction along which one body slides in another.

    No guess is needed. Samples that were not tracked and gross outliers, in place or rotation, are
    left out; the line is fitted to the rest by total least squares. The noise of a's rotation moves
    b by its lever: half of what the rotations tell of it is taken out, as of a hinge.

    Args:
        T_ab: poses of b in a, (n, 4, 4); NaN where either was not tracked

    Returns:
        the slide; where it stands across its direction has no meaning

    Raises:
        InputError: wrong shape, or too few poses
    """
    T, tracked = check_poses(T_ab)
    R, p = T[tracked, :3, :3], T[tracked, :3, 3]
    rotation, turned = shared_rotation(R)
    used = near(turned)
    eps: Array = rotation_vector_from_matrix(R @ rotation.T)
    places = p + 0.5 * np.cross(p, eps)
    *_, missed = shared_line(places, used.astype(np.float64))
    used &= near(missed)
    count = int(used.sum())
    turn = eps[used].mean(axis=0)
    point = places[used].mean(axis=0)
    away = places - point
    direction = np.asarray(np.linalg.svd(away[used], full_matrices=False)[2][0])
    along = away @ direction
    across: Array = away - along[:, None] * direction
    influence = np.zeros((len(T), 9))
    each = np.zeros((len(p), 9))
    each[:, :3] = across * along[:, None] / np.sum(along[used] ** 2)
    each[:, 3:6] = across / count
    each[:, 6:] = (eps - turn) / count
    influence[tracked] = each * used[:, None]
    residual_position = float(np.linalg.norm(across[used]) / np.sqrt(count))
    residual_rotation = float(np.linalg.norm(eps[used]) / np.sqrt(count))
    widened = widening(influence, (residual_position, residual_rotation))
    positions = np.full(len(T), np.nan)
    positions[tracked] = np.where(used, along, np.nan)
    kept = np.zeros(len(T), dtype=bool)
    kept[tracked] = used
    return SlideFit(
        direction_a=direction,
        direction_b=rotation.T @ direction,
        rotation=rotation,
        point=point,
        positions=positions,
        used=kept,
        span=float(np.ptp(along[used])),
        residual_position=residual_position,
        residual_rotation=residual_rotation,
        influence_a=widened * influence,
        outliers=len(used) - count,
        widened=widened,
    )
