"""Tasks that bring objects to places, with one arm or from one to the other."""

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
                T = self.object_pose(goal.object)
                point = T[:3, 3] + self.GRASP_M * UP
                yield from hand.pick(point, across(T), self.WAY_M)
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
        pegs = {prop.name: prop.pose[:3, 3] for prop in self.scene.rig.objects}
        for goal, at in self.goals:
            for _ in range(TRIES):
                middle = self.object_pose(goal.object)[:3, 3]
                side = 1.0 if middle[1] > pegs[goal.object][1] else -1.0  # where there is room
                point = middle + np.array([0.0, side * self.RADIUS_M, 0.0])
                yield from hand.pick(point, np.pi / 2, self.WAY_M, 0.6)
                if self.held(hand.arm) == goal.object:
                    break
            yield from hand.place(goal.object, at + self.RELEASE_M * UP, self.WAY_M, 0.6)


class Retrieve(Task):
    """An object is lifted, and held at a place in the air."""

    #: Height of the way above the object. Source: our own choice. [m]
    WAY_M = 0.02

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        return together(self, **{self.arms[0]: self._run(Hand(self, self.arms[0]))})

    def _run(self, hand: Hand) -> Motion:
        ((goal, at),) = self.goals
        for _ in range(TRIES):
            T = self.object_pose(goal.object)
            yield from hand.pick(T[:3, 3], across(T), self.WAY_M)
            if self.held(hand.arm) == goal.object:
                break
        yield from hand.shift(at - self.object_pose(goal.object)[:3, 3])


class NeedlePick(Task):
    """A needle that lies flat is lifted by the middle of its arc, and held in the air."""

    #: Radius of the arc, height of the way, and how much higher than other objects a wire is
    #: grasped, so that the fingers' ends do not press into the pad. Source: the scene. [m]
    RADIUS_M, WAY_M, RAISED_M = 0.01, 0.02, 0.0012

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        return together(self, **{self.arms[0]: self._run(Hand(self, self.arms[0]))})

    def _run(self, hand: Hand) -> Motion:
        ((goal, at),) = self.goals
        for _ in range(TRIES):
            T = self.object_pose(goal.object)
            middle = T[:3, 3] + self.RADIUS_M * T[:3, 1] + self.RAISED_M * UP
            yield from hand.pick(middle, across(T), self.WAY_M, 0.5)
            if self.held(hand.arm) == goal.object:
                break
        yield from hand.shift(at - self.object_pose(goal.object)[:3, 3])


class BiPegTransfer(Task):
    """A ring is lifted by the left arm, handed over in the air, and put on a peg by the right."""

    #: As of `PegBoard`; and where it is handed over, in the world. Source: our own choice. [m]
    RADIUS_M, WAY_M, RELEASE_M = 0.008, 0.025, 0.002
    MEETING_M = np.array([0.0, 0.0, 0.035])

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        left, right = Hand(self, self.arms[1]), Hand(self, self.arms[0])
        ((goal, at),) = self.goals
        side = np.array([self.RADIUS_M, 0.0, 0.0])

        def alone(hand: Hand, motion: Motion) -> Iterator[Array]:
            return together(self, **{hand.arm: motion})

        for _ in range(TRIES):
            ring = self.object_pose(goal.object)[:3, 3]
            yield from alone(left, left.pick(ring - side, 0.0, self.WAY_M, 0.6))
            if self.held(left.arm) == goal.object:
                break
        yield from alone(left, left.shift(self.MEETING_M - self.object_pose(goal.object)[:3, 3]))
        yield from alone(right, right.open(0.6))
        point = self.object_pose(goal.object)[:3, 3] + side
        yield from alone(right, right.over(point, self.WAY_M / 2.0, 0.0))
        yield from alone(right, right.over(point, 0.0))
        yield from alone(right, right.close())
        yield from alone(left, left.open(0.6))
        yield from alone(left, left.shift(self.WAY_M / 2.0 * UP))
        yield from together(
            self,
            **{
                left.arm: left.shift(np.array([-0.03, 0.0, 0.0])),
                right.arm: right.place(goal.object, at + self.RELEASE_M * UP, self.WAY_M, 0.6),
            },
        )


def across(T: Array) -> float:
    """Return the angle of an object's y axis about the world's z [rad]: along it jaws close."""
    return float(np.arctan2(T[1, 1], T[0, 1]))
