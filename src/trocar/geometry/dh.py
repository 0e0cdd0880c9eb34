"""Denavit-Hartenberg rows, standard and modified; the name says which.

Arguments broadcast against each other, so a whole table is one call.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trocar.errors import InputError
from trocar.geometry.rotations import Array

# Source: our choice; an entry of a matrix made of sines and cosines is rounded by 1e-16 or so.
ROW_TOLERANCE = 1e-9


def modified_dh(a: ArrayLike, alpha: ArrayLike, d: ArrayLike, theta: ArrayLike) -> Array:
    """Compute the pose of frame i in frame i-1: Rx(alpha) Tx(a) Rz(theta) Tz(d).

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
    """Compute the pose of frame i in frame i-1: Rz(theta) Tz(d) Tx(a) Rx(alpha).

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


def modified_dh_parameters(T: ArrayLike) -> Array:
    """Compute the modified row that makes a pose; undoes `modified_dh`.

    Args:
        T: (4, 4)

    Returns:
        a [m], alpha [rad], d [m], theta [rad], (4,), angles in (-pi, pi]

    Raises:
        InputError: no modified row makes this pose
    """
    m = np.asarray(T, dtype=np.float64)
    alpha, theta = np.arctan2(-m[1, 2], m[2, 2]), np.arctan2(-m[0, 1], m[0, 0])
    d = m[2, 3] * np.cos(alpha) - m[1, 3] * np.sin(alpha)
    row = np.array([m[0, 3], alpha, d, theta]) + 0.0
    return _check_row(row, modified_dh(*row), m, "modified")


def standard_dh_parameters(T: ArrayLike) -> Array:
    """Compute the standard row that makes a pose; undoes `standard_dh`.

    Args, Returns and Raises as for `modified_dh_parameters`.
    """
    m = np.asarray(T, dtype=np.float64)
    alpha, theta = np.arctan2(m[2, 1], m[2, 2]), np.arctan2(m[1, 0], m[0, 0])
    a = m[0, 3] * np.cos(theta) + m[1, 3] * np.sin(theta)
    row = np.array([a, alpha, m[2, 3], theta]) + 0.0
    return _check_row(row, standard_dh(*row), m, "standard")


def _check_row(row: Array, made: Array, expected: Array, which: str) -> Array:
    worst = float(np.abs(made - expected).max())
    if not worst <= ROW_TOLERANCE:
        raise InputError(f"pose: no {which} DH row makes it, the nearest is off by {worst:.3g}")
    return row


def _broadcast(*values: ArrayLike) -> tuple[Array, ...]:
    return tuple(np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in values)))


def _stack(*rows: list[Array]) -> Array:
    matrix = np.zeros((*rows[0][0].shape, 4, 4))
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            matrix[..., i, j] = value
    matrix[..., 3, 3] = 1.0
    return matrix
