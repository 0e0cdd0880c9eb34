"""Vectors, rotations, frames, twists and wrenches with the names of PyKDL, where it is missing.

Source of names and behaviour: the public documentation of Orocos KDL's Python binding.
"""

from __future__ import annotations

import math
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

__all__ = ["Equal", "Frame", "Rotation", "Twist", "Vector", "Wrench", "addDelta", "diff", "dot"]
Array = NDArray[np.float64]
#: Two numbers that differ by less are equal. Source: KDL's `epsilon`.
EPSILON = 1e-6


class Vector:
    """Three numbers [m], or another vector's."""

    __slots__ = ("xyz",)
    __hash__ = None  # type: ignore[assignment]  it can be changed

    def __init__(self, x: Any = 0.0, y: float = 0.0, z: float = 0.0) -> None:
        given = x.xyz if isinstance(x, Vector) else (x, y, z)
        self.xyz = np.array(given, dtype=np.float64)

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
        return float(np.linalg.norm(self.xyz))

    def Normalize(self) -> float:
        """Make the length 1; return what it was."""
        length = self.Norm()
        self.xyz[:] = self.xyz / length if length > EPSILON else (1.0, 0.0, 0.0)
        return length

    def ReverseSign(self) -> None:
        """Become the opposite."""
        self.xyz[:] = -self.xyz

    def _entry(self, which: int, value: float | None) -> float:
        if value is not None:
            self.xyz[which] = value
        return float(self.xyz[which])

    def __getitem__(self, which: int) -> float:
        return float(self.xyz[which])

    def __setitem__(self, which: int, value: float) -> None:
        self.xyz[which] = value

    def __iter__(self) -> Iterator[float]:
        return iter(self.xyz.tolist())

    def __len__(self) -> int:
        return 3

    def __add__(self, other: Vector) -> Vector:
        return Vector(*(self.xyz + other.xyz))

    def __sub__(self, other: Vector) -> Vector:
        return Vector(*(self.xyz - other.xyz))

    def __neg__(self) -> Vector:
        return Vector(*(-self.xyz))

    def __mul__(self, other: Any) -> Vector:
        """Return the product with a number, or the cross product with a vector."""
        found = np.cross(self.xyz, other.xyz) if isinstance(other, Vector) else self.xyz * other
        return Vector(*found)

    def __rmul__(self, factor: float) -> Vector:
        return Vector(*(self.xyz * factor))

    def __truediv__(self, divisor: float) -> Vector:
        return Vector(*(self.xyz / divisor))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Vector) and Equal(self, other)

    def __repr__(self) -> str:
        return f"[{', '.join(f'{value:12.6g}' for value in self.xyz)}]"


class Rotation:
    """A rotation: of nine numbers row by row, or another's."""

    __slots__ = ("matrix",)
    __hash__ = None  # type: ignore[assignment]  it can be changed

    def __init__(self, *numbers: Any) -> None:
        if len(numbers) == 1 and isinstance(numbers[0], Rotation):
            self.matrix = numbers[0].matrix.copy()
        elif len(numbers) == 3 and all(isinstance(one, Vector) for one in numbers):
            self.matrix = np.stack([one.xyz for one in numbers], axis=1)
        elif len(numbers) in (0, 9):
            self.matrix = np.array(numbers or np.eye(3), dtype=np.float64).reshape(3, 3)
        else:
            raise TypeError(f"Rotation: got {len(numbers)} values; allowed: none, 9, or 3 vectors")

    @classmethod
    def _of(cls, R: Array) -> Rotation:
        made = cls()
        made.matrix = np.array(R, dtype=np.float64)
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
        return cls._of(matrix_from_rotation_vector(angle * axis.xyz / max(axis.Norm(), 1e-300)))

    Rot2 = Rot

    def GetQuaternion(self) -> tuple[float, float, float, float]:
        """Return x, y, z, w."""
        w, x, y, z = (float(value) for value in quaternion_from_matrix(self.matrix))
        return x, y, z, w

    def GetRPY(self) -> tuple[float, float, float]:
        """Return roll, pitch and yaw [rad]."""
        roll, pitch, yaw = (float(value) for value in rpy_from_matrix(self.matrix))
        return roll, pitch, yaw

    def GetEulerZYX(self) -> tuple[float, float, float]:
        """Return yaw, pitch and roll [rad]."""
        roll, pitch, yaw = self.GetRPY()
        return yaw, pitch, roll

    def GetEulerZYZ(self) -> tuple[float, float, float]:
        """Return turns about z, y and z of axes that turn along [rad]."""
        R = self.matrix
        beta = math.atan2(math.hypot(R[2, 0], R[2, 1]), R[2, 2])
        if abs(R[2, 2]) > 1.0 - EPSILON:
            return math.atan2(R[1, 0] * R[2, 2], R[0, 0] * R[2, 2]), beta, 0.0
        return math.atan2(R[1, 2], R[0, 2]), beta, math.atan2(R[2, 1], -R[2, 0])

    def GetRot(self) -> Vector:
        """Return the axis, as long as the angle [rad]."""
        return Vector(*rotation_vector_from_matrix(self.matrix))

    def GetRotAngle(self, *_: float) -> tuple[float, Vector]:
        """Return the angle [rad] and the axis."""
        axis = self.GetRot()
        angle = axis.Norm()
        return angle, (axis / angle if angle > 0.0 else Vector(0.0, 0.0, 1.0))

    def DoRotX(self, angle: float) -> None:
        """Turn about its own x [rad]."""
        self.matrix = self.matrix @ rotation_x(angle)

    def DoRotY(self, angle: float) -> None:
        """Turn about its own y [rad]."""
        self.matrix = self.matrix @ rotation_y(angle)

    def DoRotZ(self, angle: float) -> None:
        """Turn about its own z [rad]."""
        self.matrix = self.matrix @ rotation_z(angle)

    def Inverse(self, vector: Vector | None = None) -> Any:
        """Return the inverse, or that times a vector."""
        if vector is not None:
            return Vector(*(self.matrix.T @ vector.xyz))
        return Rotation._of(self.matrix.T)

    def SetInverse(self) -> None:
        """Become the inverse."""
        self.matrix = self.matrix.T.copy()

    def UnitX(self) -> Vector:
        """Return the x axis."""
        return Vector(*self.matrix[:, 0])

    def UnitY(self) -> Vector:
        """Return the y axis."""
        return Vector(*self.matrix[:, 1])

    def UnitZ(self) -> Vector:
        """Return the z axis."""
        return Vector(*self.matrix[:, 2])

    def __getitem__(self, where: tuple[int, int]) -> float:
        return float(self.matrix[where])

    def __setitem__(self, where: tuple[int, int], value: float) -> None:
        self.matrix[where] = value

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Vector):
            return Vector(*(self.matrix @ other.xyz))
        if isinstance(other, Rotation):
            return Rotation._of(self.matrix @ other.matrix)
        if isinstance(other, KdlSix):
            return type(other)(*(self * part for part in other.parts))
        return NotImplemented

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rotation) and Equal(self, other)

    def __repr__(self) -> str:
        return "[" + ";\n ".join(", ".join(f"{n:12.6g}" for n in row) for row in self.matrix) + "]"


class KdlSix:
    """Two vectors: a twist or a wrench.

    Attributes:
        parts: the linear one and the angular one
    """

    __slots__ = ("parts",)
    __hash__ = None  # type: ignore[assignment]  it can be changed

    def __init__(self, *given: Any) -> None:
        if len(given) == 1 and isinstance(given[0], type(self)):
            given = given[0].parts
        if len(given) not in (0, 2) or not all(isinstance(one, Vector) for one in given):
            kind = type(self).__name__.removeprefix("Kdl")
            raise TypeError(f"{kind}: got {given!r}; allowed: two Vectors, another {kind}")
        parts: tuple[Any, ...] = given or (Vector(), Vector())
        first, second = parts
        self.parts = Vector(*first), Vector(*second)

    @classmethod
    def Zero(cls) -> Any:
        """Return zeros."""
        return cls()

    def ReverseSign(self) -> None:
        """Become the opposite."""
        for part in self.parts:
            part.ReverseSign()

    def _set(self, which: int, value: Vector) -> None:
        self.parts[which].xyz[:] = value.xyz

    def __getitem__(self, which: int) -> float:
        return self.parts[which // 3][which % 3]

    def __setitem__(self, which: int, value: float) -> None:
        self.parts[which // 3][which % 3] = value

    def __iter__(self) -> Iterator[float]:
        return (value for part in self.parts for value in part)

    def __len__(self) -> int:
        return 6

    def __add__(self, other: Any) -> Any:
        if type(other) is not type(self):
            return NotImplemented
        return type(self)(*(a + b for a, b in zip(self.parts, other.parts, strict=True)))

    def __sub__(self, other: Any) -> Any:
        return self + -other if type(other) is type(self) else NotImplemented

    def __neg__(self) -> Any:
        return type(self)(*(-part for part in self.parts))

    def __mul__(self, factor: float) -> Any:
        return type(self)(*(part * factor for part in self.parts))

    __rmul__ = __mul__

    def __truediv__(self, divisor: float) -> Any:
        return type(self)(*(part / divisor for part in self.parts))

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and Equal(self, other)

    def __repr__(self) -> str:
        return f"[{', '.join(f'{value:12.6g}' for value in self)}]"


class KdlTwist(KdlSix):
    """A linear and an angular velocity [m/s, rad/s], at a point."""

    __slots__ = ()

    @property
    def vel(self) -> Vector:
        """The linear velocity."""
        return self.parts[0]

    @vel.setter
    def vel(self, value: Vector) -> None:
        self._set(0, value)

    @property
    def rot(self) -> Vector:
        """The angular velocity."""
        return self.parts[1]

    @rot.setter
    def rot(self, value: Vector) -> None:
        self._set(1, value)

    def RefPoint(self, point: Vector) -> KdlTwist:
        """Return the twist at another point, from the one of this twist [m]."""
        return KdlTwist(self.vel + self.rot * point, self.rot)


class KdlWrench(KdlSix):
    """A force and a torque [N, N m], at a point."""

    __slots__ = ()

    @property
    def force(self) -> Vector:
        """The force."""
        return self.parts[0]

    @force.setter
    def force(self, value: Vector) -> None:
        self._set(0, value)

    @property
    def torque(self) -> Vector:
        """The torque."""
        return self.parts[1]

    @torque.setter
    def torque(self, value: Vector) -> None:
        self._set(1, value)

    def RefPoint(self, point: Vector) -> KdlWrench:
        """Return the wrench at another point, from the one of this wrench [m]."""
        return KdlWrench(self.force, self.torque + self.force * point)


class KdlFrame:
    """A pose: where its origin is, and how its axes stand.

    Attributes:
        p: the origin; what is assigned is copied
        M: the axes; what is assigned is copied
    """

    __slots__ = ("_p", "_rotation")
    __hash__ = None  # type: ignore[assignment]  it can be changed

    def __init__(self, *parts: Any) -> None:
        self._rotation, self._p = Rotation(), Vector()
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
        return self._rotation

    @M.setter
    def M(self, value: Rotation) -> None:
        self._rotation = Rotation(value)

    @classmethod
    def DH(cls, a: float, alpha: float, d: float, theta: float) -> KdlFrame:
        """Return the frame of a link by standard DH parameters [m, rad]."""
        turn = Rotation.RotZ(theta)
        return cls(turn * Rotation.RotX(alpha), turn * Vector(a, 0.0, d))

    @classmethod
    def DH_Craig1989(cls, a: float, alpha: float, d: float, theta: float) -> KdlFrame:
        """Return the frame of a link by modified DH parameters [m, rad]."""
        turn = Rotation.RotX(alpha)
        return cls(turn * Rotation.RotZ(theta), Vector(a, 0.0, 0.0) + turn * Vector(0.0, 0.0, d))

    def Inverse(self, vector: Vector | None = None) -> Any:
        """Return the inverse, or that times a vector."""
        M = self._rotation.Inverse()
        made = KdlFrame(M, -(M * self._p))
        return made if vector is None else made * vector

    def Integrate(self, twist: KdlTwist, frequency: float) -> None:
        """Move by a twist in its own axes for one period of a frequency [Hz]."""
        turn = Rotation.Rot(twist.rot, twist.rot.Norm() / frequency)
        moved = self * KdlFrame(turn, twist.vel / frequency)
        self.M, self.p = moved.M, moved.p

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, KdlFrame):
            return KdlFrame(self._rotation * other._rotation, self * other._p)
        if isinstance(other, Vector):
            return self._rotation * other + self._p
        if isinstance(other, KdlTwist):
            turned = self._rotation * other
            return KdlTwist(turned.vel + self._p * turned.rot, turned.rot)
        if isinstance(other, KdlWrench):
            turned = self._rotation * other
            return KdlWrench(turned.force, turned.torque + self._p * turned.force)
        return NotImplemented

    def __getitem__(self, where: tuple[int, int]) -> float:
        row, column = where
        return self._p[row] if column == 3 else self._rotation[row, column]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, KdlFrame) and Equal(self, other)

    def __repr__(self) -> str:
        return f"[{self._rotation!r}\n{self._p!r}]"


def dot(a: Any, b: Any) -> float:
    """Return the scalar product of two vectors, or of a twist and a wrench [W]."""
    return float(_numbers(a) @ _numbers(b))


def diff(a: Any, b: Any, dt: float = 1.0) -> Any:
    """Return the change from a to b per time [s].

    Of vectors and rotations a vector, of frames a twist, of twists a twist; in the axes that a and
    b are in.
    """
    if isinstance(a, Vector | KdlSix):
        return (b - a) / dt
    if isinstance(a, Rotation):
        return a * (a.Inverse() * b).GetRot() / dt
    return KdlTwist(diff(a.p, b.p, dt), diff(a.M, b.M, dt))


def addDelta(a: Any, delta: Any, dt: float = 1.0) -> Any:
    """Return a moved by what `diff` returns, for some time [s]."""
    if isinstance(a, Vector | KdlSix):
        return a + delta * dt
    if isinstance(a, Rotation):
        return a * Rotation.Rot(a.Inverse(delta), delta.Norm() * dt)
    return KdlFrame(addDelta(a.M, delta.rot, dt), addDelta(a.p, delta.vel, dt))


def Equal(a: Any, b: Any, eps: float = EPSILON) -> bool:
    """Return whether two of a kind are the same to within `eps` in each number."""
    return bool(np.all(np.abs(_numbers(a) - _numbers(b)) < eps))


def _numbers(value: Any) -> Array:
    if isinstance(value, Vector):
        return value.xyz
    if isinstance(value, Rotation):
        return value.matrix
    if isinstance(value, KdlSix):
        return np.array([*value])
    if isinstance(value, KdlFrame):
        return np.column_stack([value.M.matrix, value.p.xyz])
    return np.asarray(value, dtype=np.float64)


#: PyKDL's names.
Frame, Twist, Wrench = KdlFrame, KdlTwist, KdlWrench
