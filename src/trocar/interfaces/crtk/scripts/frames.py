"""Frames with the names that PyKDL gives them, and all that it has beside them here."""

from __future__ import annotations

from typing import Any

from trocar.interfaces.crtk.scripts.vectors import Equal, Rotation, Vector, dot

__all__ = ["Equal", "Frame", "Rotation", "Vector", "dot"]


class Frame:
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
            if isinstance(part, Frame):
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
    def Identity(cls) -> Frame:
        """Return the frame that poses are told in."""
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

    def Inverse(self) -> Frame:
        """Return the inverse."""
        M = self._M.Inverse()
        return Frame(M, -(M * self._p))

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Frame):
            return Frame(self._M * other._M, self * other._p)
        if isinstance(other, Vector):
            return self._M * other + self._p
        return NotImplemented

    def __getitem__(self, where: tuple[int, int]) -> float:
        row, column = where
        return self._p[row] if column == 3 else self._M[row, column]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Frame) and Equal(self, other)

    def __repr__(self) -> str:
        return f"[{self._M!r}\n{self._p!r}]"
