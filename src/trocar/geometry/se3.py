"""Poses: (4, 4) matrices T_ab with p_a = T_ab @ p_b, and their twists (linear; angular).

Every function works over leading axes: (..., 4, 4), (..., 6), (..., 3).
"""

from __future__ import annotations

from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from trocar.errors import InputError
from trocar.geometry.rotations import (
    TOLERANCE,
    Array,
    angle_between,
    check_rotation,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    skew,
    unskew,
)

# Source: below it the series in `_left_jacobian` and `_inverse_left_jacobian` stop short by less
# than 1e-17; above it the closed forms' lost digits vanish in the angle^2 that multiplies them.
_SMALL_ANGLE = 1e-2
_IDENTITY = np.eye(4)


def transform(R: ArrayLike, p: ArrayLike) -> Array:
    """Put a rotation and a position together.

    Args:
        R: (..., 3, 3)
        p: (..., 3) [m]; leading axes broadcast with those of R

    Returns:
        (..., 4, 4)
    """
    turn, shift = np.asarray(R, dtype=np.float64), np.asarray(p, dtype=np.float64)
    if turn.ndim == 2 and shift.ndim == 1:  # one pose, in a third of the time
        matrix = _IDENTITY.copy()
        matrix[:3, :3], matrix[:3, 3] = turn, shift
        return matrix
    matrix = np.zeros((*np.broadcast_shapes(turn.shape[:-2], shift.shape[:-1]), 4, 4))
    matrix[..., :3, :3] = turn
    matrix[..., :3, 3] = shift
    matrix[..., 3, 3] = 1.0
    return matrix


def translation(p: ArrayLike) -> Array:
    """Shift without turning.

    Args:
        p: (..., 3) [m]

    Returns:
        (..., 4, 4)
    """
    return transform(np.eye(3), p)


def inverse(T: ArrayLike) -> Array:
    """Invert poses: T_ba from T_ab.

    Args:
        T: (..., 4, 4)

    Returns:
        (..., 4, 4)
    """
    m = np.asarray(T, dtype=np.float64)
    Rt = np.swapaxes(m[..., :3, :3], -1, -2)
    return transform(Rt, -(Rt @ m[..., :3, 3:])[..., 0])


def relative(T_wa: ArrayLike, T_wb: ArrayLike) -> Array:
    """Return poses seen from others: T_ab = inverse(T_wa) @ T_wb.

    Args:
        T_wa, T_wb: (..., 4, 4)

    Returns:
        (..., 4, 4)
    """
    a, found = np.asarray(T_wa, dtype=np.float64), np.array(T_wb, dtype=np.float64)
    found[..., :3, 3] -= a[..., :3, 3]
    found[..., :3, :] = a[..., :3, :3].swapaxes(-1, -2) @ found[..., :3, :]
    return found


def transform_points(T: ArrayLike, p: ArrayLike) -> Array:
    """Express points in another frame: p_a = T_ab p_b.

    Args:
        T: (..., 4, 4)
        p: (..., 3) [m]; leading axes broadcast with those of T

    Returns:
        (..., 3) [m]
    """
    m, points = np.asarray(T, dtype=np.float64), np.asarray(p, dtype=np.float64)
    return (m[..., :3, :3] @ points[..., None])[..., 0] + m[..., :3, 3]


def adjoint(T: ArrayLike) -> Array:
    """Compute the matrix that expresses twists in another frame: xi_a = Ad(T_ab) xi_b.

    Ad(T) = [[R, [p]x R], [0, R]] for twists (linear; angular).

    Args:
        T: (..., 4, 4)

    Returns:
        (..., 6, 6)
    """
    m = np.asarray(T, dtype=np.float64)
    R = m[..., :3, :3]
    matrix = np.zeros((*m.shape[:-2], 6, 6))
    matrix[..., :3, :3] = R
    matrix[..., 3:, 3:] = R
    matrix[..., :3, 3:] = skew(m[..., :3, 3]) @ R
    return matrix


def exp_twist(xi: ArrayLike) -> Array:
    """Move along a twist for one unit of time (exponential map of SE(3)).

    Args:
        xi: (linear; angular), (..., 6) [m; rad]

    Returns:
        (..., 4, 4)
    """
    xi = np.asarray(xi, dtype=np.float64)
    linear, angular = xi[..., :3], xi[..., 3:]
    p = (_left_jacobian(angular) @ linear[..., None])[..., 0]
    return transform(matrix_from_rotation_vector(angular), p)


def log_transform(T: ArrayLike) -> Array:
    """Compute the twist that leads from the identity to T, its turn in [0, pi]; undoes `exp_twist`.

    Args:
        T: (..., 4, 4)

    Returns:
        (linear; angular), (..., 6) [m; rad]
    """
    m = np.asarray(T, dtype=np.float64)
    angular = rotation_vector_from_matrix(m[..., :3, :3])
    linear = (_inverse_left_jacobian(angular) @ m[..., :3, 3:])[..., 0]
    return np.concatenate([linear, angular], axis=-1)


def _left_jacobian(v: Array) -> Array:
    """V = I + (1 - cos a) / a^2 [v]x + (a - sin a) / a^3 [v]x^2 with a = |v|."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    square = angle * angle
    small = angle < _SMALL_ANGLE
    safe = np.where(small, 1.0, angle)
    first = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    series = 1.0 / 6.0 - square / 120.0 + square * square / 5040.0
    second = np.where(small, series, (safe - np.sin(safe)) / safe**3)
    K = skew(v)
    return np.eye(3) + first * K + second * (K @ K)


def _inverse_left_jacobian(v: Array) -> Array:
    """V^-1 = I - [v]x / 2 + (1 - (a / 2) cot(a / 2)) / a^2 [v]x^2 with a = |v| <= pi."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    square = angle * angle
    small = angle < _SMALL_ANGLE
    half = np.where(small, 1.0, 0.5 * angle)
    series = 1.0 / 12.0 + square / 720.0 + square * square / 30240.0
    closed = (1.0 - half * np.cos(half) / np.sin(half)) / (4.0 * half * half)
    K = skew(v)
    return np.eye(3) - 0.5 * K + np.where(small, series, closed) * (K @ K)


def pose_difference(Ta: ArrayLike, Tb: ArrayLike) -> tuple[Array, Array]:
    """Measure how far two poses lie apart.

    Args:
        Ta, Tb: (..., 4, 4), leading axes broadcast

    Returns:
        distance of the origins (...) [m], angle between the axes (...) [rad]
    """
    a, b = np.asarray(Ta, dtype=np.float64), np.asarray(Tb, dtype=np.float64)
    distance = np.linalg.norm(a[..., :3, 3] - b[..., :3, 3], axis=-1)
    return np.asarray(distance), angle_between(a[..., :3, :3], b[..., :3, :3])


def pose_residuals(measured: ArrayLike, expected: ArrayLike) -> Array:
    """Compute measured less expected poses, in the axes of the frame that both are in.

    Args:
        measured, expected: (..., 4, 4)

    Returns:
        (shift; rotation vector), (..., 6) [m; rad]
    """
    one, two = np.asarray(measured, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    turn = one[..., :3, :3] @ np.swapaxes(two[..., :3, :3], -1, -2)
    sine = unskew(turn)
    size = np.linalg.norm(sine, axis=-1)
    cosine = 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(size, cosine)
    factor = np.where(size > 1e-12, angle / np.maximum(size, 1e-300), 1.0)
    away = (one - two)[..., :3, 3]
    return np.concatenate([away, sine * factor[..., None]], axis=-1)


def check_transform(T: ArrayLike, name: str = "pose") -> Array:
    """Check that T is a pose to `rotations.TOLERANCE`, and return it as float64.

    Args:
        T: (..., 4, 4)
        name: what to call it in the message

    Raises:
        InputError: wrong shape, not finite, last row not (0, 0, 0, 1), or a bad rotation part
    """
    m = np.asarray(T, dtype=np.float64)
    if m.ndim < 2 or m.shape[-2:] != (4, 4):
        raise InputError(f"{name}: expected shape (..., 4, 4), got {m.shape}")
    if m.ndim == 2 and _is_pose(m):  # the usual case, in a tenth of the time
        return m
    if not np.isfinite(m).all():
        raise InputError(f"{name}: expected finite numbers, got {m.tolist()}")
    if (np.abs(m[..., 3, :] - [0.0, 0.0, 0.0, 1.0]) > TOLERANCE).any():
        raise InputError(f"{name}: expected last row (0, 0, 0, 1), got {m[..., 3, :].tolist()}")
    check_rotation(m[..., :3, :3], name=f"{name}: rotation part")
    return m


def _is_pose(T: Array) -> bool:
    """Return whether one matrix (4, 4) is a pose, in plain numbers; NaN fails every comparison."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z), last = T.tolist()
    return (
        last == [0.0, 0.0, 0.0, 1.0]
        and isfinite(x + y + z)
        and abs(a * a + d * d + g * g - 1.0) <= TOLERANCE
        and abs(b * b + e * e + h * h - 1.0) <= TOLERANCE
        and abs(c * c + f * f + i * i - 1.0) <= TOLERANCE
        and abs(a * b + d * e + g * h) <= TOLERANCE
        and abs(a * c + d * f + g * i) <= TOLERANCE
        and abs(b * c + e * f + h * i) <= TOLERANCE
        and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0.0
    )
