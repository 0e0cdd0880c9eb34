"""Denavit-Hartenberg rows, standard and modified; the name says which.

Arguments broadcast against each other, so a whole table is one call.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trocar.geometry.rotations import Array


def modified_dh(a: ArrayLike, alpha: ArrayLike, d: ArrayLike, theta: ArrayLike) -> Array:
    """Give the pose of frame i in frame i-1: Rx(alpha) Tx(a) Rz(theta) Tz(d).

    Args:
        a: along x of frame i-1, (...) [m]
        alpha: about x of frame i-1, (...) [rad]
        d: along z of frame i, (...) [m]
        theta: about z of frame i, (...) [rad]

    Returns:
        (..., 4, 4)

    Source: J. J. Craig, Introduction to Robotics, section on link frames.
    """
    a, alpha, d, theta = _broadcast(a, alpha, d, theta)
    ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    zero = np.zeros_like(a)
    return _stack(
        [ct, -st, zero, a],
        [st * ca, ct * ca, -sa, -d * sa],
        [st * sa, ct * sa, ca, d * ca],
    )


def standard_dh(a: ArrayLike, alpha: ArrayLike, d: ArrayLike, theta: ArrayLike) -> Array:
    """Give the pose of frame i in frame i-1: Rz(theta) Tz(d) Tx(a) Rx(alpha).

    Args:
        a: along x of frame i, (...) [m]
        alpha: about x of frame i, (...) [rad]
        d: along z of frame i-1, (...) [m]
        theta: about z of frame i-1, (...) [rad]

    Returns:
        (..., 4, 4)

    Source: J. Denavit and R. S. Hartenberg, J. Applied Mechanics 22 (1955).
    """
    a, alpha, d, theta = _broadcast(a, alpha, d, theta)
    ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    zero = np.zeros_like(a)
    return _stack(
        [ct, -st * ca, st * sa, a * ct],
        [st, ct * ca, -ct * sa, a * st],
        [zero, sa, ca, d],
    )


def _broadcast(*values: ArrayLike) -> tuple[Array, ...]:
    return tuple(np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in values)))


def _stack(*rows: list[Array]) -> Array:
    matrix = np.zeros((*rows[0][0].shape, 4, 4))
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            matrix[..., i, j] = value
    matrix[..., 3, 3] = 1.0
    return matrix
