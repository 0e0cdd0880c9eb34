"""Tasks that bring objects to places, with one arm or from one to the other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from trocar.apps.motions import UP, Hand, Motion, together
from trocar.apps.task import Task

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


class HandOver(Task):
    """The left arm lifts a ring or a needle, and hands it over in the air to the right arm.

    Attributes of a class:
        RADIUS_M: of the circle that it is held at
        GIVE, TAKE: angles on this circle where the left and the right arm hold it [rad]
        TURNS: whether these turn with the object
        RAISED_M: as of `NeedlePick`
    """

    RADIUS_M, GIVE, TAKE, TURNS, RAISED_M = 0.008, np.pi, 0.0, False, 0.0
    #: Height of the way, opening of the jaws, and where the object is handed over.
    #: Source: our own choice. [m, rad]
    WAY_M, OPENING, MEETING_M = 0.025, 0.6, np.array([0.0, 0.0, 0.035])

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        right, left = (Hand(self, arm) for arm in self.arms)
        ((goal, _),) = self.goals
        name = goal.object
        for _ in range(TRIES):
            point, angle = self._grip(name, self.GIVE)
            point = point + self.RAISED_M * UP
            yield from self._alone(left, left.pick(point, angle, self.WAY_M, self.OPENING))
            if self.held(left.arm) == name:
                break
        way = self.MEETING_M - self.object_pose(name)[:3, 3]
        yield from self._alone(left, left.shift(way))
        yield from self._pass(left, right, self._grip(name, self.TAKE))
        aside = left.shift(np.array([-0.03, 0.0, 0.0]))
        yield from together(self, **{left.arm: aside, right.arm: self._end(right)})

    def _pass(self, giver: Hand, taker: Hand, grip: tuple[Array, float]) -> Iterator[Array]:
        """Let an arm take what another holds, which then withdraws upwards."""
        point, angle = grip
        yield from self._alone(taker, taker.open(self.OPENING))
        yield from self._alone(taker, taker.over(point, self.WAY_M / 2.0, angle))
        yield from self._alone(taker, taker.over(point, 0.0))
        yield from self._alone(taker, taker.close())
        yield from self._alone(giver, giver.open(self.OPENING))
        yield from self._alone(giver, giver.shift(self.WAY_M / 2.0 * UP))

    def _alone(self, hand: Hand, motion: Motion) -> Iterator[Array]:
        return together(self, **{hand.arm: motion})

    def _grip(self, name: str, angle: float) -> tuple[Array, float]:
        """Return the point on the circle and the direction along which fingers close there."""
        T = self.object_pose(name)
        angle += float(np.arctan2(T[1, 0], T[0, 0])) if self.TURNS else 0.0
        return T[:3, 3] + self.RADIUS_M * np.array([np.cos(angle), np.sin(angle), 0.0]), angle

    def _end(self, hand: Hand) -> Motion:
        """Bring the object to its goal in the end."""
        ((goal, at),) = self.goals
        yield from hand.shift(at - self.object_pose(goal.object)[:3, 3])


class BiPegTransfer(HandOver):
    """A ring goes from a peg to another one, handed over in the air."""

    def _end(self, hand: Hand) -> Motion:
        ((goal, at),) = self.goals
        place = at + PegBoard.RELEASE_M * UP
        yield from hand.place(goal.object, place, self.WAY_M, self.OPENING)


class NeedleHandOver(HandOver):
    """A needle goes from the left arm to the right one."""

    RADIUS_M, GIVE, TAKE, TURNS = 0.01, np.radians(150.0), np.radians(30.0), True
    RAISED_M, OPENING = NeedlePick.RAISED_M, 0.5


class NeedleRegrasp(NeedleHandOver):
    """A needle goes from the left arm to the right one and back, held at another place."""

    #: Where the left arm takes it again. Source: our own choice. [rad]
    AGAIN = np.radians(120.0)

    def _end(self, hand: Hand) -> Motion:
        yield from hand.wait(1.0)

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        yield from super().policy()
        right, left = (Hand(self, arm) for arm in self.arms)
        ((goal, at),) = self.goals
        yield from self._pass(right, left, self._grip(goal.object, self.AGAIN))
        yield from self._alone(left, left.shift(at - self.object_pose(goal.object)[:3, 3]))


def across(T: Array) -> float:
    """Return the angle of an object's y axis about the world's z [rad]: along it jaws close."""
    return float(np.arctan2(T[1, 1], T[0, 1]))
