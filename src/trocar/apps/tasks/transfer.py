"""Tasks that bring objects to places with one arm."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from trocar.apps.tasks.motions import UP, Hand, Motion, together
from trocar.apps.tasks.task import Task

Array = NDArray[np.float64]

#: How often a grasp is tried. Source: our own choice.
TRIES = 3


class PickPlace(Task):
    """Cylinders that stand on the table go into cups."""

    #: Heights: of the grasp above the cylinder's middle, of the way, and of the release above the
    #: goal. Source: the scene's cylinders and cups are 14 and 10 mm high. [m]
    GRASP_M, WAY_M, RELEASE_M = 0.003, 0.03, 0.002

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        return together(self, **{self.arms[0]: self._run(Hand(self, self.arms[0]))})

    def _run(self, hand: Hand) -> Motion:
        for goal, at in self.goals:
            for _ in range(TRIES):
                point = self.object_pose(goal.object)[:3, 3] + self.GRASP_M * UP
                yield from hand.pick(point, np.pi / 2, self.WAY_M)
                if self.held(hand.arm) == goal.object:
                    break
            yield from hand.place(goal.object, at + self.RELEASE_M * UP, self.WAY_M)


class PegBoard(Task):
    """Rings go from pegs to other pegs."""

    #: Radius of a ring's middle line, its thickness, height of the way, of the release.
    #: Source: the scene's rings and pegs. [m]
    RADIUS_M, WAY_M, RELEASE_M = 0.008, 0.025, 0.002

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        return together(self, **{self.arms[0]: self._run(Hand(self, self.arms[0]))})

    def _run(self, hand: Hand) -> Motion:
        for goal, at in self.goals:
            for _ in range(TRIES):
                middle = self.object_pose(goal.object)[:3, 3]
                side = -1.0 if middle[1] > 0.0 else 1.0
                point = middle + np.array([0.0, side * self.RADIUS_M, 0.0])
                yield from hand.pick(point, np.pi / 2, self.WAY_M, 0.6)
                if self.held(hand.arm) == goal.object:
                    break
            yield from hand.place(goal.object, at + self.RELEASE_M * UP, self.WAY_M, 0.6)
