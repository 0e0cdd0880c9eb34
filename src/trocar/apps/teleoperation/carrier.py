"""A hand that carries a simulated master: by the handles of the page, or as it was recorded."""

from __future__ import annotations

from math import radians
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.apps.teleoperation.slave import Slave
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_vector_from_matrix
from trocar.geometry.se3 import transform

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]

#: Fastest that a hand carries a master. Source: our own choice: hands are slower. [m/s, rad/s]
SPEED, TURN = 0.5, radians(180.0)
#: A hand comes up to its goal as slowly as this makes it. Source: our own choice. [s]
SOFT_S = 0.06


class Carrier:
    """Carry a master's handle towards where it is wanted; in the loop's thread.

    Args:
        world: the master is an arm of its rig
        name: of the arm
    """

    def __init__(self, world: World, name: str) -> None:
        self._world, self._name = world, name
        self._goal: Array | None = None
        self._hand: Slave | None = None

    @property
    def busy(self) -> bool:
        """Whether a hand has hold of it."""
        return self._goal is not None

    def carry(self, T: Array) -> None:
        """Bring the handle to a pose in the world, (4, 4), by and by."""
        self._goal = T
        if self._hand is None:
            arm = self._world.arm(self._name)
            arm.hold()  # its set-points are then where it is
            self._hand = Slave(arm, self._world.reference_pose(self._name))

    def let_go(self) -> None:
        """Take the hand away; the master stays where it is."""
        if self._hand is not None:
            self._world.arm(self._name).hold()
        self._goal = self._hand = None

    def tick(self, period_s: float) -> None:
        """Go on by a period [s]."""
        if self._goal is None or self._hand is None:
            return
        here = self._hand.T
        way = self._goal[:3, 3] - here[:3, 3]
        turn = rotation_vector_from_matrix(self._goal[:3, :3] @ here[:3, :3].T)
        p = here[:3, 3] + _part(way, SPEED, period_s)
        R = matrix_from_rotation_vector(_part(turn, TURN, period_s)) @ here[:3, :3]
        self._hand.follow(transform(R, p), period_s)


def _part(way: Array, fastest: float, period_s: float) -> Array:
    """Return how much of a way is made in a period: softly at its end, not faster than allowed."""
    length = float(np.linalg.norm(way))
    if length == 0.0:
        return way
    step = min(length / SOFT_S, fastest) * period_s
    return way * min(step / length, 1.0)
