"""The part of space that an eye or a light reaches: a pyramid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frustum:
    """A pyramid ahead of an eye or a light.

    Attributes:
        T_eye_reference: from the reference frame, in which objects are placed (4, 4)
        left, right, top, bottom: its edges in the plane z = 1
        near: nothing is seen before this [m]
        pixels: pixels that a length of 1 covers at distance 1
    """

    T_eye_reference: Array
    left: float
    right: float
    top: float
    bottom: float
    near: float
    pixels: float

    @cached_property
    def planes(self) -> tuple[Array, Array]:
        """Its sides and its end at the eye: directions inwards (3, 5), least products (5,)."""
        sides = np.array(
            [
                [1.0, 0.0, -self.left],
                [-1.0, 0.0, self.right],
                [0.0, 1.0, -self.top],
                [0.0, -1.0, self.bottom],
                [0.0, 0.0, 1.0],
            ]
        )
        T = self.T_eye_reference
        least = -sides @ T[:3, 3] + [0.0, 0.0, 0.0, 0.0, self.near]
        return (sides @ T[:3, :3]).T, least
