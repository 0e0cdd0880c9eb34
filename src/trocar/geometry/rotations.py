"""Rotations: matrices, quaternions (wxyz), rotation vectors and angles.

Every function works over leading axes: (..., 3, 3), (..., 4), (..., 3).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError

Array = NDArray[np.float64]

# Source: our choice; wide enough for matrices that were stored as float32 or with seven digits.
TOLERANCE = 1e-6

# Source: below it the next term of atan(x) / x, x**2 / 3, is under the float64 rounding step.
_SMALL = 1e-8


def rotation_x(angle: ArrayLike) -> Array:
    """Turn about the x axis.

    Args:
        angle: (...) [rad]

    Returns:
        rotation matrices, (..., 3, 3)
    """
    return _rotation_about(angle, 0)


def rotation_y(angle: ArrayLike) -> Array:
    """Turn about the y axis; see `rotation_x`."""
    return _rotation_about(angle, 1)


def rotation_z(angle: ArrayLike) -> Array:
    """Turn about the z axis; see `rotation_x`."""
    return _rotation_about(angle, 2)


def _rotation_about(angle: ArrayLike, axis: int) -> Array:
    theta = np.asarray(angle, dtype=np.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*theta.shape, 3, 3))
    matrix[..., axis, axis] = 1.0
    matrix[..., i, i] = matrix[..., j, j] = np.cos(theta)
    matrix[..., j, i] = np.sin(theta)
    matrix[..., i, j] = -np.sin(theta)
    return matrix


def skew(v: ArrayLike) -> Array:
    """Compute the matrix K with K @ x = v x x (cross product).

    Args:
        v: (..., 3)

    Returns:
        (..., 3, 3)
    """
    v = np.asarray(v, dtype=np.float64)
    matrix = np.zeros((*v.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., k, j] = v[..., i]
        matrix[..., j, k] = -v[..., i]
    return matrix


def unskew(K: ArrayLike) -> Array:
    """Compute the vector of the skew part of a matrix; undoes `skew`.

    Args:
        K: (..., 3, 3)

    Returns:
        (..., 3)
    """
    m = np.asarray(K, dtype=np.float64)
    half = 0.5 * (m - np.swapaxes(m, -1, -2))
    return np.stack([half[..., 2, 1], half[..., 0, 2], half[..., 1, 0]], axis=-1)


def matrix_from_rpy(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Turn about the fixed axes x, then y, then z, as URDF does: R = Rz(yaw) Ry(pitch) Rx(roll).

    Args:
        roll, pitch, yaw: (...) [rad]

    Returns:
        (..., 3, 3)
    """
    return rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll)


def rpy_from_matrix(R: ArrayLike) -> Array:
    """Compute angles about the fixed axes x, y, z that make a rotation; undoes `matrix_from_rpy`.

    Args:
        R: (..., 3, 3), a rotation (not checked, see `check_rotation`)

    Returns:
        roll, pitch, yaw, (..., 3) [rad], pitch in [-pi/2, pi/2]; with pitch at +-pi/2, where only
        roll -+ yaw is determined, yaw is 0
    """
    m = np.asarray(R, dtype=np.float64)
    level = np.hypot(m[..., 0, 0], m[..., 1, 0])
    pitch = np.arctan2(-m[..., 2, 0], level)
    upright = level < 1e-9
    yaw = np.where(upright, 0.0, np.arctan2(m[..., 1, 0], m[..., 0, 0]))
    # With the yaw undone what is left is Ry Rx, whose second row is (0, cos roll, -sin roll).
    cosine = np.cos(yaw) * m[..., 1, 1] - np.sin(yaw) * m[..., 0, 1]
    sine = np.sin(yaw) * m[..., 0, 2] - np.cos(yaw) * m[..., 1, 2]
    return np.stack([np.arctan2(sine, cosine), pitch, yaw], axis=-1) + 0.0


def matrix_from_quaternion(q_wxyz: ArrayLike) -> Array:
    """Compute the rotation matrix of a quaternion.

    Args:
        q_wxyz: (..., 4), scalar first; any length but zero, it is normalised

    Returns:
        (..., 3, 3)

    Raises:
        InputError: a quaternion that is not finite or has no length
    """
    q = np.asarray(q_wxyz, dtype=np.float64)
    if q.ndim == 0 or q.shape[-1] != 4:
        raise InputError(f"quaternion: expected shape (..., 4), got {q.shape}")
    if q.size == 4:
        return _matrix_from_quaternion(*q.ravel().tolist()).reshape(*q.shape[:-1], 3, 3)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    if not (np.isfinite(length).all() and (length > 0.0).all()):
        raise InputError(
            f"quaternion: expected finite numbers of non-zero length, got {q.tolist()}"
        )
    q = q / length
    w, v = q[..., :1, None], q[..., 1:]
    # R = (w^2 - v.v) I + 2 v v^T + 2 w [v]x, with w^2 - v.v written so that R(1, 0, 0, 0) is exact.
    square = np.sum(v * v, axis=-1)[..., None, None]
    outer = v[..., :, None] * v[..., None, :]
    return np.eye(3) * (1.0 - 2.0 * square) + 2.0 * outer + 2.0 * w * skew(v)


def _matrix_from_quaternion(w: float, x: float, y: float, z: float) -> Array:
    """Do the same to one quaternion, ten times as fast."""
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0.0 < length < math.inf:
        raise InputError(
            f"quaternion: expected finite numbers of non-zero length, got {[w, x, y, z]}"
        )
    w, x, y, z = w / length, x / length, y / length, z / length
    rest = 1.0 - 2.0 * (x * x + y * y + z * z)
    xy, xz, yz, wx, wy, wz = x * y, x * z, y * z, w * x, w * y, w * z
    return np.array(
        [
            [rest + 2.0 * x * x, 2.0 * (xy - wz), 2.0 * (xz + wy)],
            [2.0 * (xy + wz), rest + 2.0 * y * y, 2.0 * (yz - wx)],
            [2.0 * (xz - wy), 2.0 * (yz + wx), rest + 2.0 * z * z],
        ]
    )


def _outer() -> tuple[Array, Array]:
    """Return factors and offset of 4 q q^T, (16,), as a function of a rotation matrix, (9,)."""
    factors, rest = np.zeros((4, 4, 3, 3)), np.eye(4)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        a, b, c = 1 + i, 1 + j, 1 + k
        factors[(0, a, b, c), (0, a, b, c), i, i] = 1.0, 1.0, -1.0, -1.0
        factors[(0, a), (a, 0), k, j], factors[(0, a), (a, 0), j, k] = 1.0, -1.0
        factors[(b, c), (c, b), j, k] = factors[(b, c), (c, b), k, j] = 1.0
    return factors.reshape(16, 9).T.copy(), rest.ravel()


_OUTER, _OUTER_REST = _outer()
#: The sign of the sum is that of the first component that is not 0.
_LEAD = np.array([8.0, 4.0, 2.0, 1.0])


def quaternion_from_matrix(R: ArrayLike) -> Array:
    """Compute the unit quaternion of a rotation matrix.

    Builds the matrix 4 q q^T from R and takes its longest column, so no angle loses digits.

    Args:
        R: (..., 3, 3), a rotation (not checked, see `check_rotation`)

    Returns:
        (..., 4), wxyz, w >= 0; for half turns (w = 0) the first component that is not 0 is positive

    Source: S. W. Shepperd, Quaternion from rotation matrix, J. Guidance and Control 1 (1978).
    """
    m = np.asarray(R, dtype=np.float64)
    if m.size == 9:
        return np.array(quaternion_numbers(m.reshape(3, 3))).reshape(*m.shape[:-2], 4)
    outer = (m.reshape(-1, 9) @ _OUTER + _OUTER_REST).reshape(-1, 4, 4)
    best = outer.reshape(-1, 16)[:, ::5].argmax(axis=-1)
    q = outer[np.arange(len(outer)), best]
    q /= np.sqrt((q * q).sum(axis=-1, keepdims=True))
    q[np.sign(q) @ _LEAD < 0.0] *= -1.0
    return q.reshape(*m.shape[:-2], 4) + 0.0  # no negative zeros


def quaternion_numbers(R: Array) -> tuple[float, float, float, float]:
    """Do as `quaternion_from_matrix` to one matrix (3, 3), five times as fast."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    diagonal = (a + e + i + 1.0, a - e - i + 1.0, -a + e - i + 1.0, -a - e + i + 1.0)
    best = diagonal.index(max(diagonal))
    if best == 0:
        w, x, y, z = diagonal[0], h - f, c - g, d - b
    elif best == 1:
        w, x, y, z = h - f, diagonal[1], b + d, c + g
    elif best == 2:
        w, x, y, z = c - g, b + d, diagonal[2], f + h
    else:
        w, x, y, z = d - b, c + g, f + h, diagonal[3]
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if w < 0.0 or (w == 0.0 and (x < 0.0 or (x == 0.0 and (y < 0.0 or (y == 0.0 and z < 0.0))))):
        length = -length
    # no negative zeros
    return w / length + 0.0, x / length + 0.0, y / length + 0.0, z / length + 0.0


def matrix_from_rotation_vector(v: ArrayLike) -> Array:
    """Turn by |v| about v (exponential map of SO(3)).

    R = cos|v| I + (sin|v| / |v|) [v]x + ((1 - cos|v|) / |v|^2) v v^T

    Args:
        v: (..., 3) [rad]

    Returns:
        (..., 3, 3)
    """
    v = np.asarray(v, dtype=np.float64)
    if v.shape == (3,):
        return np.array(rotation_rows(*v.tolist()))
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    sine = np.sinc(angle / np.pi)  # sin(angle) / angle, 1 at 0
    versine = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 - cos(angle)) / angle**2, 1/2 at 0
    outer = v[..., :, None] * v[..., None, :]
    return np.cos(angle) * np.eye(3) + sine * skew(v) + versine * outer


def matrices_from_rotation_vectors(v: Array) -> Array:
    """Turn by |v| about v, as `matrix_from_rotation_vector` of each alone, to the last bit.

    Args:
        v: (n, 3) [rad]

    Returns:
        (n, 3, 3)
    """
    x, y, z = v.T
    angle = np.sqrt(x * x + y * y + z * z)
    still = angle == 0.0
    length = np.where(still, 1.0, angle)
    x, y, z = x / length, y / length, z / length
    # functions of plain numbers, since numpy's own round otherwise on some processors
    c, s = np.array([*map(math.cos, angle.tolist())]), np.array([*map(math.sin, angle.tolist())])
    half = np.array([*map(math.sin, (0.5 * angle).tolist())])
    w = 2.0 * half * half
    rows = (
        *(c + w * x * x, w * x * y - s * z, w * x * z + s * y),
        *(w * y * x + s * z, c + w * y * y, w * y * z - s * x),
        *(w * z * x - s * y, w * z * y + s * x, c + w * z * z),
    )
    found = np.stack(rows, axis=-1).reshape(-1, 3, 3)
    found[still] = np.eye(3)
    return found


def rotation_rows(x: float, y: float, z: float) -> list[list[float]]:
    """List the rows of `matrix_from_rotation_vector` of one vector, six times as fast."""
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    x, y, z = x / angle, y / angle, z / angle
    c, s, half = math.cos(angle), math.sin(angle), math.sin(0.5 * angle)
    v = 2.0 * half * half  # 1 - c, with all its digits
    return [
        [c + v * x * x, v * x * y - s * z, v * x * z + s * y],
        [v * y * x + s * z, c + v * y * y, v * y * z - s * x],
        [v * z * x - s * y, v * z * y + s * x, c + v * z * z],
    ]


def rotation_vector_from_matrix(R: ArrayLike) -> Array:
    """Compute axis times angle, angle in [0, pi] (logarithm of SO(3)).

    Goes through the quaternion, so it keeps its digits at angles near 0 and near pi. At pi exactly
    the axis whose first component that is not 0 is positive is taken.

    Args:
        R: (..., 3, 3), a rotation (not checked)

    Returns:
        (..., 3) [rad]
    """
    q = quaternion_from_matrix(R)
    w, v = q[..., :1], q[..., 1:]
    half_sine = np.linalg.norm(v, axis=-1, keepdims=True)
    small = half_sine < _SMALL
    safe = np.where(small, 1.0, half_sine)
    return v * np.where(small, 2.0, 2.0 * np.arctan2(safe, w) / safe)


def angle_between(Ra: ArrayLike, Rb: ArrayLike) -> Array:
    """Measure the angle of the turn that takes Ra to Rb.

    Args:
        Ra, Rb: (..., 3, 3), leading axes broadcast

    Returns:
        (...) [rad] in [0, pi]
    """
    back = np.swapaxes(np.asarray(Ra, dtype=np.float64), -1, -2)
    q = quaternion_from_matrix(back @ np.asarray(Rb, dtype=np.float64))
    return 2.0 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), q[..., 0])


def nearest_rotation(M: ArrayLike) -> Array:
    """Return the rotation nearest to a matrix, least squares of the entries, (..., 3, 3).

    Source: Kabsch, A discussion of the solution for the best rotation to relate two sets of
    vectors, 1978.
    """
    left, _, right = np.linalg.svd(np.asarray(M, dtype=np.float64))
    left[..., 2] *= np.linalg.det(left @ right)[..., None]
    return np.asarray(left @ right, dtype=np.float64)


def check_rotation(R: ArrayLike, name: str = "rotation") -> Array:
    """Check that R is a rotation to `TOLERANCE`, and return it as float64.

    Args:
        R: (..., 3, 3)
        name: what to call it in the message

    Raises:
        InputError: wrong shape, not finite, not orthonormal, or a reflection
    """
    m = np.asarray(R, dtype=np.float64)
    if m.ndim < 2 or m.shape[-2:] != (3, 3):
        raise InputError(f"{name}: expected shape (..., 3, 3), got {m.shape}")
    if not np.isfinite(m).all():
        raise InputError(f"{name}: expected finite numbers, got {m.tolist()}")
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers beyond 1e154
        residual = np.abs(np.swapaxes(m, -1, -2) @ m - np.eye(3))
    if residual.size and not residual.max() <= TOLERANCE:
        raise InputError(
            f"{name}: not orthonormal, R^T R differs from the identity by {residual.max():.3g} "
            f"(allowed {TOLERANCE:g})"
        )
    if (np.linalg.det(m) < 0.0).any():
        raise InputError(f"{name}: a reflection (determinant -1); expected a rotation")
    return m
