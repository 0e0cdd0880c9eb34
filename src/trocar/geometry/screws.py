"""Screws of joints, and lines in space.

A screw is a twist (linear; angular) per radian, or per metre for a sliding joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trocar.errors import InputError
from trocar.geometry.rotations import Array
from trocar.geometry.se3 import exp_twist

# Source: our choice. The smallest eigenvalue of the mean of (I - d d^T) is about the square of the
# spread of the directions, so this calls lines parallel when they lie within 1e-6 rad.
_PARALLEL = 1e-12


def revolute_screw(point: ArrayLike, direction: ArrayLike) -> Array:
    """Compute the screw of a hinge: (point x axis; axis).

    Args:
        point: a point on the axis, (..., 3) [m]
        direction: along the axis, (..., 3), any length but zero

    Returns:
        (linear; angular), (..., 6) [m/rad; 1]
    """
    axis = _unit(direction)
    linear = np.cross(np.asarray(point, dtype=np.float64), axis)
    return np.concatenate([linear, np.broadcast_to(axis, linear.shape)], axis=-1)


def prismatic_screw(direction: ArrayLike) -> Array:
    """Compute the screw of a slide: (axis; 0).

    Args:
        direction: (..., 3), any length but zero

    Returns:
        (linear; angular), (..., 6)
    """
    axis = _unit(direction)
    return np.concatenate([axis, np.zeros_like(axis)], axis=-1)


def screw_motion(screw: ArrayLike, amount: ArrayLike) -> Array:
    """Move along a screw.

    Args:
        screw: (..., 6)
        amount: (...) [rad, or m for a slide]

    Returns:
        (..., 4, 4)
    """
    screw, amount = np.asarray(screw, dtype=np.float64), np.asarray(amount, dtype=np.float64)
    return exp_twist(screw * amount[..., None])


def point_line_distance(
    point: ArrayLike, line_point: ArrayLike, line_direction: ArrayLike
) -> Array:
    """Measure the distance of a point from a line.

    Args:
        point, line_point: (..., 3) [m]
        line_direction: (..., 3), any length but zero

    Returns:
        (...) [m]
    """
    offset = np.asarray(point, dtype=np.float64) - np.asarray(line_point, dtype=np.float64)
    return np.asarray(np.linalg.norm(np.cross(offset, _unit(line_direction)), axis=-1))


def nearest_point_to_lines(points: ArrayLike, directions: ArrayLike) -> tuple[Array, float]:
    """Find the point whose squared distances from lines have the least sum.

    Solves sum_i (I - d_i d_i^T) (x - p_i) = 0.

    Args:
        points: one point on each line, (n, 3) [m]
        directions: one along each line, (n, 3), any length but zero

    Returns:
        the point (3,) [m], and the RMS of its distances from the lines [m]

    Raises:
        InputError: wrong shapes, fewer than two lines, or lines that are all parallel
    """
    p, d = np.asarray(points, dtype=np.float64), np.asarray(directions, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != 3 or d.shape != p.shape:
        raise InputError(f"lines: expected two arrays of shape (n, 3), got {p.shape} and {d.shape}")
    if len(p) < 2:
        raise InputError(f"lines: expected at least two, got {len(p)}")
    d = _unit(d)
    projectors = np.eye(3) - d[:, :, None] * d[:, None, :]
    normal = projectors.mean(axis=0)
    values, vectors = np.linalg.eigh(normal)
    if values[0] < _PARALLEL:
        raise InputError("lines: all are parallel, so no point is nearest to them")
    right = (projectors @ p[:, :, None])[..., 0].mean(axis=0)
    x = vectors @ ((vectors.T @ right) / values)
    distances = point_line_distance(x, p, d)
    return x, float(np.sqrt(np.mean(distances**2)))


def _unit(direction: ArrayLike) -> Array:
    d = np.asarray(direction, dtype=np.float64)
    length = np.linalg.norm(d, axis=-1, keepdims=True)
    if not (np.isfinite(length).all() and (length > 0.0).all()):
        raise InputError(
            f"direction: expected a finite vector of non-zero length, got {d.tolist()}"
        )
    return d / length


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
