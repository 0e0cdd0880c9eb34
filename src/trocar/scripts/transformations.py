"""Homogeneous matrices, quaternions (xyzw) and Euler angles with the names of tf.transformations.

Source of names and behaviour: the public documentation of tf.transformations (ROS 1 Noetic).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs]  none exist

Array = NDArray[np.float64]
Turn: Any = Rotation

__all__ = [
    "compose_matrix", "concatenate_matrices", "euler_from_matrix", "euler_from_quaternion",
    "euler_matrix", "identity_matrix", "inverse_matrix", "quaternion_about_axis",
    "quaternion_conjugate", "quaternion_from_euler", "quaternion_from_matrix", "quaternion_inverse",
    "quaternion_matrix", "quaternion_multiply", "quaternion_slerp", "rotation_from_matrix",
    "rotation_matrix", "translation_from_matrix", "translation_matrix", "unit_vector",
    "vector_norm",
]  # fmt: skip


def _sequence(axes: str) -> str:
    """Return scipy's name of a sequence of axes: "sxyz" of axes that stand still, "rzyx" turning.

    Raises:
        ValueError: no such sequence
    """
    kind, order = axes[:1], axes[1:]
    if kind not in ("s", "r") or len(order) != 3 or set(order) - set("xyz"):
        raise ValueError(f"axes: got {axes!r}; allowed: s or r with three of x, y, z, as sxyz")
    return order if kind == "s" else order.upper()


def _matrix(R: Any = None, p: Any = None) -> Array:
    T = np.eye(4)
    if R is not None:
        T[:3, :3] = R
    if p is not None:
        T[:3, 3] = np.asarray(p, dtype=np.float64)[:3]
    return T


def identity_matrix() -> Array:
    """Return the identity, (4, 4)."""
    return np.eye(4)


def translation_matrix(direction: Any) -> Array:
    """Return a translation, (4, 4) [m]."""
    return _matrix(p=direction)


def translation_from_matrix(matrix: Any) -> Array:
    """Return the translation of a matrix, (3,) [m]."""
    return np.array(matrix, dtype=np.float64)[:3, 3]


def rotation_matrix(angle: float, direction: Any, point: Any = None) -> Array:
    """Return a turn [rad] about an axis through the origin, or through a point [m]."""
    R = Turn.from_rotvec(angle * unit_vector(direction)).as_matrix()
    if point is None:
        return _matrix(R)
    at = np.asarray(point, dtype=np.float64)[:3]
    return _matrix(R, at - R @ at)


def rotation_from_matrix(matrix: Any) -> tuple[float, Array, Array]:
    """Return angle [rad], axis, and a point of the axis (4,) of a matrix."""
    T = np.array(matrix, dtype=np.float64)
    vector = Turn.from_matrix(T[:3, :3]).as_rotvec()
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle else np.array([0.0, 0.0, 1.0])
    point = np.linalg.pinv(np.eye(3) - T[:3, :3]) @ T[:3, 3]
    return angle, axis, np.append(point, 1.0)


def inverse_matrix(matrix: Any) -> Array:
    """Return the inverse of a matrix."""
    return np.asarray(np.linalg.inv(np.asarray(matrix, dtype=np.float64)), dtype=np.float64)


def concatenate_matrices(*matrices: Any) -> Array:
    """Return the product of matrices, (4, 4)."""
    found = np.eye(4)
    for matrix in matrices:
        found = found @ np.asarray(matrix, dtype=np.float64)
    return found


def compose_matrix(
    scale: Any = None, shear: Any = None, angles: Any = None, translate: Any = None,
    perspective: Any = None,
) -> Array:  # fmt: skip
    """Return the matrix of angles (sxyz) [rad], a translation [m] and a scale.

    Raises:
        ValueError: shear or perspective is given
    """
    if shear is not None or perspective is not None:
        raise ValueError("compose_matrix: got shear or perspective; allowed: none of them")
    R = np.eye(3) if angles is None else euler_matrix(*angles)[:3, :3]
    return _matrix(R if scale is None else R * np.asarray(scale, dtype=np.float64), translate)


def euler_matrix(ai: float, aj: float, ak: float, axes: str = "sxyz") -> Array:
    """Return the rotation of three angles, (4, 4) [rad]."""
    return _matrix(Turn.from_euler(_sequence(axes), [ai, aj, ak]).as_matrix())


def euler_from_matrix(matrix: Any, axes: str = "sxyz") -> tuple[float, float, float]:
    """Return three angles of a rotation [rad]."""
    R = np.array(matrix, dtype=np.float64)[:3, :3]
    first, second, third = Turn.from_matrix(R).as_euler(_sequence(axes))
    return float(first), float(second), float(third)


def euler_from_quaternion(quaternion: Any, axes: str = "sxyz") -> tuple[float, float, float]:
    """Return three angles of a quaternion xyzw [rad]."""
    first, second, third = Turn.from_quat(quaternion).as_euler(_sequence(axes))
    return float(first), float(second), float(third)


def quaternion_from_euler(ai: float, aj: float, ak: float, axes: str = "sxyz") -> Array:
    """Return the quaternion xyzw of three angles, (4,) [rad]."""
    return Turn.from_euler(_sequence(axes), [ai, aj, ak]).as_quat()


def quaternion_about_axis(angle: float, axis: Any) -> Array:
    """Return the quaternion xyzw of a turn about an axis, (4,) [rad]."""
    return Turn.from_rotvec(angle * unit_vector(axis)).as_quat()


def quaternion_matrix(quaternion: Any) -> Array:
    """Return the rotation of a quaternion xyzw, (4, 4)."""
    return _matrix(Turn.from_quat(quaternion).as_matrix())


def quaternion_from_matrix(matrix: Any) -> Array:
    """Return the quaternion xyzw of a rotation, (4,)."""
    return Turn.from_matrix(np.array(matrix, dtype=np.float64)[:3, :3]).as_quat()


def quaternion_multiply(quaternion1: Any, quaternion0: Any) -> Array:
    """Return the product of two quaternions xyzw, (4,)."""
    x1, y1, z1, w1 = quaternion1
    x0, y0, z0, w0 = quaternion0
    return np.array([
        x1 * w0 + y1 * z0 - z1 * y0 + w1 * x0,
        -x1 * z0 + y1 * w0 + z1 * x0 + w1 * y0,
        x1 * y0 - y1 * x0 + z1 * w0 + w1 * z0,
        -x1 * x0 - y1 * y0 - z1 * z0 + w1 * w0,
    ])  # fmt: skip


def quaternion_conjugate(quaternion: Any) -> Array:
    """Return the conjugate of a quaternion xyzw, (4,)."""
    x, y, z, w = quaternion
    return np.array([-x, -y, -z, w], dtype=np.float64)


def quaternion_inverse(quaternion: Any) -> Array:
    """Return the inverse of a quaternion xyzw, (4,)."""
    return quaternion_conjugate(quaternion) / np.dot(quaternion, quaternion)


def quaternion_slerp(quat0: Any, quat1: Any, fraction: float, *_: Any) -> Array:
    """Return a quaternion xyzw between two, at a ratio of the shorter way, (4,)."""
    first, second = Turn.from_quat(quat0), Turn.from_quat(quat1)
    way = (first.inv() * second).as_rotvec()
    return (first * Turn.from_rotvec(fraction * way)).as_quat()


def vector_norm(data: Any, axis: int | None = None) -> Any:
    """Return the length of a vector, or of those along an axis."""
    return np.linalg.norm(np.asarray(data, dtype=np.float64), axis=axis)


def unit_vector(data: Any, axis: int | None = None) -> Array:
    """Return a vector, or those along an axis, with the length 1."""
    values = np.array(data, dtype=np.float64)
    return values / np.linalg.norm(values, axis=axis, keepdims=axis is not None)
