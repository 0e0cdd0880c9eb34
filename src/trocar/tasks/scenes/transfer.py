"""Tasks that bring objects to places, with one arm or from one to the other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Goal
from trocar.tasks.motions import TRIES, UP, Hand, Motion, together
from trocar.tasks.referee import SETTLED_S
from trocar.tasks.task import Task

Array = NDArray[np.float64]

#: Least number of rods of a round ring; one of fewer has corners, and is held in the middle of a
#: side. Source: our own choice, as rings are drawn.
ROUND = 8


class Carry(Task):
    """One arm brings objects to places, one after the other, and again what is not there then.

    Attributes of a class:
        GRASP_M: height of the grip above the object's middle, so that the fingers' ends do not
            press on the table or pad below [m]
        WAY_M, RELEASE_M: height of the way, and of the release above the goal [m]
        OPENING: of the jaw that takes and releases it [rad]
        LEVEL: as `Hand.take` has it
    """

    GRASP_M, WAY_M, RELEASE_M, OPENING, LEVEL = 0.001, 0.025, 0.002, 0.9, False

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        return together(self, **{self.arms[0]: self._run(Hand(self, self.arms[0]))})

    def _run(self, hand: Hand) -> Motion:
        for _ in range(TRIES):
            for goal, at in self.goals:
                if self.met(goal, at):
                    continue
                name = goal.object
                grip = lambda name=name: self.grasp(name)  # noqa: E731
                yield from hand.take(name, grip, self.WAY_M, self.OPENING, self.LEVEL)
                place = self.referee.place(goal, at)
                if goal.held:
                    yield from hand.shift(place - self.object_pose(name)[:3, 3])
                else:
                    over = place + self.RELEASE_M * UP
                    yield from hand.place(name, over, self.WAY_M, self.OPENING)
            yield from hand.wait(2.0 * SETTLED_S)

    def grasp(self, name: str) -> tuple[Array, float]:
        """Return the point of a grip on an object now, and the jaw's direction, (3,) [m], [rad]."""
        T = self.object_pose(name)
        return T[:3, 3] + self.GRASP_M * UP, across(T)


class PickPlace(Carry):
    """Cylinders that stand on the table go into cups."""

    task = "pick-place"

    #: Source: the scene's cylinders and cups are 14 and 10 mm high. Lower down, the fingers wedge a
    #: cylinder's upper end between them and do not let go of it.
    GRASP_M, WAY_M = 0.0045, 0.03


class Retrieve(Carry):
    """An object is lifted, and held at a place in the air."""

    task = "retrieve"

    WAY_M = 0.02


class NeedlePick(Retrieve):
    """A needle that lies flat is lifted by the middle of its arc, and held in the air."""

    task = "needle-pick"

    #: Radius of the arc, and height of the grip above the wire, so that the fingers' ends do not
    #: press into the pad. Source: the scene. [m]
    RADIUS_M, GRASP_M, OPENING, LEVEL = 0.01, 0.0012, 0.5, True

    def grasp(self, name: str) -> tuple[Array, float]:
        """Return the middle of the arc, and the direction to it."""
        T = self.object_pose(name)
        return T[:3, 3] + self.RADIUS_M * T[:3, 1] + self.GRASP_M * UP, across(T)


class PegBoard(Carry):
    """Rings and triangles go from pegs to other pegs."""

    task = "peg-board"

    OPENING = 0.6

    def grasp(self, name: str) -> tuple[Array, float]:
        """Return the side of the object that is farthest from the peg nearest to it."""
        T = self.object_pose(name)
        pegs = np.array([at[:2] for at in self.pegs()])
        off = T[:2, 3] - pegs[np.linalg.norm(pegs - T[:2, 3], axis=1).argmin()]
        point, angle = rim(self, name, float(np.arctan2(off[1], off[0])))
        return point + self.GRASP_M * UP, angle

    def pegs(self) -> list[Array]:
        """Return the places of the pegs: the goals, and those at which the objects begin."""
        return [
            *(self.referee.place(goal, at) for goal, at in self.goals),
            *(prop.pose[:3, 3] for prop in self.scene.rig.objects),
        ]


class HandOver(Task):
    """One arm lifts an object and hands it over in the air to another, which brings it to its goal.

    Of the scene's arms the first one is on the right. Where an object begins decides who gives it.

    Attributes of a class:
        GIVE, TAKE: directions in which the left and the right arm hold it [rad]
        RADIUS_M: of the circle that it is held at, with directions in its own axes; 0: the circle
            of its rods, with directions in the world
        RAISED_M: as `GRASP_M` of `Carry`, when it is lifted
        WAY_M, RELEASE_M, OPENING, LEVEL: as of `Carry`
        MEETING_M: place at which it is handed over [m]
    """

    task = "hand-over"

    GIVE, TAKE, RADIUS_M, RAISED_M = np.pi, 0.0, 0.0, 0.001
    WAY_M, RELEASE_M, OPENING, LEVEL = 0.025, 0.002, 0.6, False
    MEETING_M = np.array([0.0, 0.0, 0.035])
    #: Turns of the grip of a ring in the tries of a take: beside one side of it a peg may stand.
    TURNS = 0.0, np.pi / 3.0, -np.pi / 3.0
    #: Distance by which the giving arm goes aside. Source: our own choice. [m]
    ASIDE_M = 0.03

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        hands = {arm: Hand(self, arm) for arm in self.arms}
        for _ in range(TRIES * (1 + max(goal.stage for goal, _ in self.goals))):
            stage, before = self.referee.stage, None
            for goal, at in self.goals:
                if goal.stage != stage or self.met(goal, at):
                    continue
                left = self.object_pose(goal.object)[0, 3] < 0.0
                giver, taker = (hands[arm] for arm in (self.arms[::-1] if left else self.arms))
                giving = self._give(giver, goal, left)
                if before is None:
                    yield from together(self, **{giver.arm: giving})
                elif taker.arm == before[0]:  # places the last one while the next one is lifted
                    yield from together(self, **dict([before]), **{giver.arm: giving})
                else:
                    yield from together(self, **dict([before]))
                    yield from together(self, **{giver.arm: giving})
                yield from self.hand_over(giver, taker, goal.object, left)
                before = taker.arm, self._end(taker, goal, at)
            if before is not None:
                yield from together(self, **dict([before]))
            yield from together(self, **{self.arms[0]: hands[self.arms[0]].wait(2.0 * SETTLED_S)})

    def _give(self, hand: Hand, goal: Goal, left: bool) -> Motion:
        """Lift an object and bring it to the place at which it is handed over."""
        name, turns = goal.object, iter(self.TURNS)

        def grip() -> tuple[Array, float]:
            hand.turned = next(turns)
            point, angle = self.grasp(name, left, hand.turned)
            return point + self.RAISED_M * UP, angle

        yield from hand.take(name, grip, self.WAY_M, self.OPENING, self.LEVEL)
        yield from hand.shift(self.MEETING_M - self.object_pose(name)[:3, 3])

    def hand_over(self, giver: Hand, taker: Hand, name: str, left: bool) -> Iterator[Array]:
        """Let an arm take an object from another, which then goes upwards and aside."""
        yield from self._pass(giver, taker, *self.grasp(name, not left, giver.turned))
        way = np.array([-self.ASIDE_M if left else self.ASIDE_M, 0.0, 0.0])
        yield from together(self, **{giver.arm: giver.shift(way)})

    def _pass(self, giver: Hand, taker: Hand, point: Array, angle: float) -> Iterator[Array]:
        def take() -> Motion:
            yield from taker.open(self.OPENING)
            yield from taker.over(point, self.WAY_M / 2.0, angle)
            yield from taker.over(point, 0.0)
            yield from taker.close()

        def give() -> Motion:
            yield from giver.open(self.OPENING)
            yield from giver.shift(self.WAY_M / 2.0 * UP)

        yield from together(self, **{taker.arm: take()})
        yield from together(self, **{giver.arm: give()})

    def grasp(self, name: str, left: bool, turned: float = 0.0) -> tuple[Array, float]:
        """Return the point of an arm's grip, and the direction along which its fingers close.

        Args:
            name: of the object
            left: whether the left arm holds it
            turned: of the grip of a ring about z [rad]
        """
        angle = self.GIVE if left else self.TAKE
        return self._arc(name, angle) if self.RADIUS_M else rim(self, name, angle + turned)

    def _arc(self, name: str, angle: float) -> tuple[Array, float]:
        """Return a place on an object's circle, at an angle about its z axis, and the way there."""
        T = self.object_pose(name)
        way = T[:3, :3] @ [np.cos(angle), np.sin(angle), 0.0]  # of a needle that fell over, too
        return T[:3, 3] + self.RADIUS_M * way, float(np.arctan2(way[1], way[0]))

    def _end(self, hand: Hand, goal: Goal, at: Array) -> Motion:
        """Bring the object to its goal in the end."""
        place = self.referee.place(goal, at)
        if goal.held:
            yield from hand.shift(place - self.object_pose(goal.object)[:3, 3])
        else:
            over = place + self.RELEASE_M * UP
            yield from hand.place(goal.object, over, self.WAY_M, self.OPENING)


class WallTransfer(HandOver):
    """A red and a blue ring change sides of a board whose pose is not observed.

    The board turns with the line from one ring to the other, which are on its pegs; where they lie
    on them, they do not show. A goal counts once its ring has been in both hands; its score is a
    point each.
    """

    task = "wall-transfer"

    MEETING_M = np.array([0.0, 0.0, 0.055])

    def begin(self) -> None:
        """Begin to count, and estimate the pose of the board."""
        self.hands: dict[str, set[str]] = {}
        super().begin()
        self.T_board = self._estimated()

    def measure(self) -> None:
        """Note the hands that each ring has been in."""
        for arm, name in self.referee.held.items():
            self.hands.setdefault(name, set()).add(arm)

    def met(self, goal: Goal, at: Array) -> bool:
        """Return whether a ring is at its goal after both arms have held it."""
        return len(self.hands.get(goal.object, ())) == 2 and super().met(goal, at)

    def score(self) -> float:
        """Return a point for each ring at its goal."""
        return float(self.referee.met_count)

    def _estimated(self) -> Array:
        """Estimate the board's pose by the rings that lie on its pegs."""
        props = {prop.name: prop for prop in self.scene.rig.objects}
        names = [goal.object for goal, _ in self.goals]
        seen = np.array([self.object_pose(name)[:3, 3] for name in names])
        drawn = np.array([props[name].pose[:3, 3] for name in names])
        way, nominal = seen[1] - seen[0], drawn[1] - drawn[0]
        turn = np.arctan2(way[1], way[0]) - np.arctan2(nominal[1], nominal[0])
        c, s = np.cos(turn), np.sin(turn)
        T = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        T[:3, 3] = seen.mean(axis=0) - T[:3, :3] @ drawn.mean(axis=0)
        return T @ props[self.goals[0][0].on].pose

    def _end(self, hand: Hand, goal: Goal, at: Array) -> Motion:
        place = self.T_board[:3, :3] @ at + self.T_board[:3, 3]
        over = place + self.RELEASE_M * UP
        yield from hand.place(goal.object, over, self.WAY_M, self.OPENING)


class NeedleHandOver(HandOver):
    """A needle goes from the left arm to the right one."""

    task = "needle-handover"

    GIVE, TAKE = np.radians(150.0), np.radians(30.0)
    RADIUS_M, RAISED_M = NeedlePick.RADIUS_M, NeedlePick.GRASP_M
    OPENING, LEVEL = NeedlePick.OPENING, True


class NeedleRegrasp(NeedleHandOver):
    """A needle goes from the left arm to the right one and back, held at another place."""

    task = "needle-regrasp"

    #: Direction of the left arm's second grip. Source: our own choice. [rad]
    AGAIN = np.radians(120.0)

    def hand_over(self, giver: Hand, taker: Hand, name: str, left: bool) -> Iterator[Array]:
        """Hand it over, and back."""
        yield from super().hand_over(giver, taker, name, left)
        yield from self._pass(taker, giver, *self._arc(name, self.AGAIN))
        yield from together(self, **{giver.arm: self._end(giver, *self.goals[0])})


def across(T: Array) -> float:
    """Return the angle of an object's y axis about the world's z [rad]: along it jaws close."""
    return float(np.arctan2(T[1, 1], T[0, 1]))


def rim(task: Task, name: str, angle: float) -> tuple[Array, float]:
    """Return the point of a ring's grip that is nearest to a direction, and the direction there.

    Args:
        task: the episode
        name: of a ring of rods: in the middle of one where it has corners
        angle: about the world's z [rad]
    """
    T = task.object_pose(name)
    prop = next(prop for prop in task.scene.rig.objects if prop.name == name)
    rods = np.array([s.pose[:3, 3] for s in prop.shapes if s.kind == "capsule"])
    radius, turned = float(np.linalg.norm(rods[0])), float(np.arctan2(T[1, 0], T[0, 0]))
    if len(rods) < ROUND:
        sides = np.arctan2(rods[:, 1], rods[:, 0]) + turned
        angle = float(sides[np.cos(sides - angle).argmax()])
    return T[:3, 3] + radius * np.array([np.cos(angle), np.sin(angle), 0.0]), angle
