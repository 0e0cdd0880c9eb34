"""The remote centre of motion, computed from where the shaft has been."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.geometry.screws import nearest_point_to_lines, point_line_distance

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RemoteCentre:
    """The point that a shaft keeps to, and how well it does.

    Attributes:
        point: nearest to all shaft lines in the least-squares sense, (3,) [m]
        rms: root of the mean squared distance of the lines from it [m]
        distances: of each line from it, (n,) [m]
    """

    point: Array
    rms: float
    distances: Array


def remote_centre(shaft_points: ArrayLike, shaft_directions: ArrayLike) -> RemoteCentre:
    """Find the point about which a shaft turns.

    Args:
        shaft_points: a point on the shaft in each configuration, (..., 3) [m], any frame that
            rests; leading axes are taken together
        shaft_directions: along the shaft, (..., 3), any length but zero, same frame

    Returns:
        the point and the distances, n = product of the leading axes, in their order

    Raises:
        InputError: wrong shapes, fewer than two lines, numbers that are not finite, or lines that
            are all parallel
    """
    points = np.asarray(shaft_points, dtype=np.float64)
    directions = np.asarray(shaft_directions, dtype=np.float64)
    if points.ndim < 1 or points.shape[-1] != 3 or directions.shape != points.shape:
        raise InputError(
            f"shaft lines: expected two arrays of shape (..., 3), got {points.shape} and "
            f"{directions.shape}"
        )
    if not np.isfinite(points).all():
        raise InputError("shaft lines: expected finite points, some are not")
    points, directions = points.reshape(-1, 3), directions.reshape(-1, 3)
    point, rms = nearest_point_to_lines(points, directions)
    return RemoteCentre(point, rms, point_line_distance(point, points, directions))
