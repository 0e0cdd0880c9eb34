"""Vectors, rotations and frames with the names that PyKDL gives them, for where it is missing.

Source of names and behaviour: the public documentation of Orocos KDL's Python binding.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import (
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    matrix_from_rpy,
    quaternion_from_matrix,
    rotation_vector_from_matrix,
    rotation_x,
    rotation_y,
    rotation_z,
    rpy_from_matrix,
)

__all__ = ["Equal", "Frame", "Rotation", "Vector", "dot"]
Array = NDArray[np.float64]
#: Two numbers that differ by less are equal. Source: KDL's `epsilon`.
EPSILON = 1e-6


class Vector:
    """Three numbers [m], or another vector's."""

    __slots__ = ("_v",)
    __hash__ = None  # type: ignore[assignment]  it can be changed

    def __init__(self, x: Any = 0.0, y: float = 0.0, z: float = 0.0) -> None:
        given = x._v if isinstance(x, Vector) else (x, y, z)
        self._v = np.array(given, dtype=np.float64)

    @classmethod
    def Zero(cls) -> Vector:
        """Return three zeros."""
        return cls()

    def x(self, value: float | None = None) -> float:
        """Return the first number; set it, where one is given."""
        return self._entry(0, value)

    def y(self, value: float | None = None) -> float:
        """Return the second number; set it, where one is given."""
        return self._entry(1, value)

    def z(self, value: float | None = None) -> float:
        """Return the third number; set it, where one is given."""
        return self._entry(2, value)

    def Norm(self) -> float:
        """Return the length."""
        return float(np.linalg.norm(self._v))

    def Normalize(self) -> float:
        """Make the length 1; return what it was."""
        length = self.Norm()
        self._v[:] = self._v / length if length > EPSILON else (1.0, 0.0, 0.0)
        return length

    def _entry(self, which: int, value: float | None) -> float:
        if value is not None:
            self._v[which] = value
        return float(self._v[which])

    def __getitem__(self, which: int) -> float:
        return float(self._v[which])

    def __setitem__(self, which: int, value: float) -> None:
        self._v[which] = value

    def __iter__(self) -> Iterator[float]:
        return iter(self._v.tolist())

    def __len__(self) -> int:
        return 3

    def __add__(self, other: Vector) -> Vector:
        return Vector(*(self._v + other._v))

    def __sub__(self, other: Vector) -> Vector:
        return Vector(*(self._v - other._v))

    def __neg__(self) -> Vector:
        return Vector(*(-self._v))

    def __mul__(self, other: Any) -> Vector:
        """Return the product with a number, or the cross product with a vector."""
        found = np.cross(self._v, other._v) if isinstance(other, Vector) else self._v * other
        return Vector(*found)

    def __rmul__(self, factor: float) -> Vector:
        return Vector(*(self._v * factor))

    def __truediv__(self, divisor: float) -> Vector:
        return Vector(*(self._v / divisor))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Vector) and Equal(self, other)

    def __repr__(self) -> str:
        return f"[{', '.join(f'{value:12.6g}' for value in self._v)}]"


class Rotation:
    """A rotation: of nine numbers row by row, or another's."""

    __slots__ = ("_R",)
    __hash__ = None  # type: ignore[assignment]  it can be changed

    def __init__(self, *numbers: Any) -> None:
        if len(numbers) == 1 and isinstance(numbers[0], Rotation):
            self._R = numbers[0]._R.copy()
        elif len(numbers) == 3 and all(isinstance(one, Vector) for one in numbers):
            self._R = np.stack([one._v for one in numbers], axis=1)
        elif len(numbers) in (0, 9):
            self._R = np.array(numbers or np.eye(3), dtype=np.float64).reshape(3, 3)
        else:
            raise TypeError(f"Rotation: got {len(numbers)} values; allowed: none, 9, or 3 vectors")

    @classmethod
    def _of(cls, R: Array) -> Rotation:
        made = cls()
        made._R = np.array(R, dtype=np.float64)
        return made

    @classmethod
    def Identity(cls) -> Rotation:
        """Return none."""
        return cls()

    @classmethod
    def Quaternion(cls, x: float, y: float, z: float, w: float) -> Rotation:
        """Return the one of a quaternion."""
        return cls._of(matrix_from_quaternion([w, x, y, z]))

    @classmethod
    def RPY(cls, roll: float, pitch: float, yaw: float) -> Rotation:
        """Return turns about x, y and z of axes that stand still [rad]."""
        return cls._of(matrix_from_rpy(roll, pitch, yaw))

    @classmethod
    def EulerZYX(cls, alpha: float, beta: float, gamma: float) -> Rotation:
        """Return turns about z, y and x of axes that turn along [rad]."""
        return cls.RPY(gamma, beta, alpha)

    @classmethod
    def EulerZYZ(cls, alpha: float, beta: float, gamma: float) -> Rotation:
        """Return turns about z, y and z of axes that turn along [rad]."""
        return cls._of(rotation_z(alpha) @ rotation_y(beta) @ rotation_z(gamma))

    @classmethod
    def RotX(cls, angle: float) -> Rotation:
        """Return a turn about x [rad]."""
        return cls._of(rotation_x(angle))

    @classmethod
    def RotY(cls, angle: float) -> Rotation:
        """Return a turn about y [rad]."""
        return cls._of(rotation_y(angle))

    @classmethod
    def RotZ(cls, angle: float) -> Rotation:
        """Return a turn about z [rad]."""
        return cls._of(rotation_z(angle))

    @classmethod
    def Rot(cls, axis: Vector, angle: float) -> Rotation:
        """Return a turn about an axis of any length [rad]."""
        return cls._of(matrix_from_rotation_vector(angle * axis._v / max(axis.Norm(), 1e-300)))

    Rot2 = Rot

    def GetQuaternion(self) -> tuple[float, float, float, float]:
        """Return x, y, z, w."""
        w, x, y, z = (float(value) for value in quaternion_from_matrix(self._R))
        return x, y, z, w

    def GetRPY(self) -> tuple[float, float, float]:
        """Return roll, pitch and yaw [rad]."""
        roll, pitch, yaw = (float(value) for value in rpy_from_matrix(self._R))
        return roll, pitch, yaw

    def GetEulerZYX(self) -> tuple[float, float, float]:
        """Return yaw, pitch and roll [rad]."""
        roll, pitch, yaw = self.GetRPY()
        return yaw, pitch, roll

    def GetRot(self) -> Vector:
        """Return the axis, as long as the angle [rad]."""
        return Vector(*rotation_vector_from_matrix(self._R))

    def GetRotAngle(self, *_: float) -> tuple[float, Vector]:
        """Return the angle [rad] and the axis."""
        axis = self.GetRot()
        angle = axis.Norm()
        return angle, (axis / angle if angle > 0.0 else Vector(0.0, 0.0, 1.0))

    def DoRotX(self, angle: float) -> None:
        """Turn about its own x [rad]."""
        self._R = self._R @ rotation_x(angle)

    def DoRotY(self, angle: float) -> None:
        """Turn about its own y [rad]."""
        self._R = self._R @ rotation_y(angle)

    def DoRotZ(self, angle: float) -> None:
        """Turn about its own z [rad]."""
        self._R = self._R @ rotation_z(angle)

    def Inverse(self, vector: Vector | None = None) -> Any:
        """Return the inverse, or that times a vector."""
        if vector is not None:
            return Vector(*(self._R.T @ vector._v))
        return Rotation._of(self._R.T)

    def SetInverse(self) -> None:
        """Become the inverse."""
        self._R = self._R.T.copy()

    def UnitX(self) -> Vector:
        """Return the x axis."""
        return Vector(*self._R[:, 0])

    def UnitY(self) -> Vector:
        """Return the y axis."""
        return Vector(*self._R[:, 1])

    def UnitZ(self) -> Vector:
        """Return the z axis."""
        return Vector(*self._R[:, 2])

    def __getitem__(self, where: tuple[int, int]) -> float:
        return float(self._R[where])

    def __setitem__(self, where: tuple[int, int], value: float) -> None:
        self._R[where] = value

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Vector):
            return Vector(*(self._R @ other._v))
        if isinstance(other, Rotation):
            return Rotation._of(self._R @ other._R)
        return NotImplemented

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rotation) and Equal(self, other)

    def __repr__(self) -> str:
        return "[" + ";\n ".join(", ".join(f"{n:12.6g}" for n in row) for row in self._R) + "]"


class KdlFrame:
    """A pose: where its origin is, and how its axes stand.

    Attributes:
        p: the origin; what is assigned is copied
        M: the axes; what is assigned is copied
    """

    __slots__ = ("_M", "_p")
    __hash__ = None  # type: ignore[assignment]  it can be changed

    def __init__(self, *parts: Any) -> None:
        self._M, self._p = Rotation(), Vector()
        for part in parts:
            if isinstance(part, KdlFrame):
                self.M, self.p = part.M, part.p
            elif isinstance(part, Rotation):
                self.M = part
            elif isinstance(part, Vector):
                self.p = part
            else:
                raise TypeError(
                    f"Frame: got {part!r}; allowed: a Rotation, a Vector, both, a Frame"
                )

    @classmethod
    def Identity(cls) -> KdlFrame:
        """Return the identity."""
        return cls()

    @property
    def p(self) -> Vector:
        """The origin."""
        return self._p

    @p.setter
    def p(self, value: Vector) -> None:
        self._p = Vector(value)

    @property
    def M(self) -> Rotation:
        """The axes."""
        return self._M

    @M.setter
    def M(self, value: Rotation) -> None:
        self._M = Rotation(value)

    def Inverse(self) -> KdlFrame:
        """Return the inverse."""
        M = self._M.Inverse()
        return KdlFrame(M, -(M * self._p))

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, KdlFrame):
            return KdlFrame(self._M * other._M, self * other._p)
        if isinstance(other, Vector):
            return self._M * other + self._p
        return NotImplemented

    def __getitem__(self, where: tuple[int, int]) -> float:
        row, column = where
        return self._p[row] if column == 3 else self._M[row, column]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, KdlFrame) and Equal(self, other)

    def __repr__(self) -> str:
        return f"[{self._M!r}\n{self._p!r}]"


def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return float(a._v @ b._v)


def Equal(a: Any, b: Any, eps: float = EPSILON) -> bool:
    """Return whether two of a kind are the same to within `eps` in each number."""
    return bool(np.all(np.abs(_numbers(a) - _numbers(b)) < eps))


def _numbers(value: Any) -> Array:
    if isinstance(value, Vector):
        return value._v
    if isinstance(value, Rotation):
        return value._R
    if isinstance(value, KdlFrame):
        return np.column_stack([value.M._R, value.p._v])
    return np.asarray(value, dtype=np.float64)


#: PyKDL's name.
Frame = KdlFrame
