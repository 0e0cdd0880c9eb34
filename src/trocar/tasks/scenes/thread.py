"""Tasks with a thread that jaws grasp: handing it over, and pulling a knot shut."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Goal
from trocar.tasks.motions import TRIES, UP, Hand, Motion, together
from trocar.tasks.referee import SETTLED_S
from trocar.tasks.scenes.transfer import HandOver
from trocar.tasks.task import Task

Array = NDArray[np.float64]


class ThreadTask(Task):
    """A task with a thread.

    Attributes of a class:
        RAISED_M: how far above its middle it is held [m]
        WAY_M, OPENING: height of the way, opening of the jaws [m, rad]
    """

    RAISED_M, WAY_M, OPENING = 0.001, 0.02, 0.6

    def middle(self, name: str, along: float) -> tuple[Array, float]:
        """Return the place at a distance from a thread's beginning, and the direction across it."""
        thread = self.world.threads[name]
        points = thread.points()
        number = along / thread.thread.link
        first = min(int(number), len(points) - 2)
        way = points[first + 1] - points[first]
        point = points[first] + (number - first) * way + self.RAISED_M * UP
        return point, float(np.arctan2(way[1], way[0])) + 0.5 * np.pi

    def take(self, hand: Hand, name: str, along: float, height: float) -> Motion:
        """Lift a thread to a height, gripped at a distance from its beginning [m]."""
        yield from hand.take(name, lambda: self.middle(name, along), height, self.OPENING)


class ThreadHandOver(ThreadTask):
    """One arm lifts a thread by its beginning, the other takes it farther along and carries it."""

    task = "thread-handover"

    #: Places along the thread of the left and the right arm's grip, height of the right one above
    #: its place, and the place at which the left one holds it out. Source: our own choice. [m]
    GIVE_M, TAKE_M, OVER_M, MEETING_M = 0.006, 0.03, 0.004, np.array([-0.018, 0.0, 0.034])

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        taker, giver = (Hand(self, arm) for arm in self.arms)
        goal, at = self.goals[0]
        for _ in range(TRIES):
            if self.met(goal, at):
                break
            if self.referee.held.get(taker.arm) != goal.object:
                yield from together(self, **{giver.arm: self._give(giver, goal.object)})
                take = self.take(taker, goal.object, self.TAKE_M, self.OVER_M)
                yield from together(self, **{taker.arm: take})
                yield from together(self, **{giver.arm: self._leave(giver)})
            carry = taker.shift(self.referee.place(goal, at) - self.object_pose(goal.object)[:3, 3])
            yield from together(self, **{taker.arm: carry})
            yield from together(self, **{taker.arm: taker.wait(2.0 * SETTLED_S)})

    def _give(self, hand: Hand, name: str) -> Motion:
        """Lift a thread by its beginning and hold it out."""
        yield from self.take(hand, name, self.GIVE_M, self.WAY_M)
        yield from hand.shift(self.MEETING_M - self.middle(name, self.GIVE_M)[0])
        yield from hand.wait(SETTLED_S)

    def _leave(self, hand: Hand) -> Motion:
        """Let go of the thread, go up and aside."""
        yield from hand.open(self.OPENING)
        yield from hand.shift(self.WAY_M * UP)
        yield from hand.shift(np.array([-HandOver.ASIDE_M, 0.0, 0.0]))


class ThreadKnot(ThreadTask):
    """Two arms lift a thread by its ends and pull the overhand knot shut that is laid in it.

    The goal is met while both hold the thread, after it was pulled with `PULL_N` on both sides of
    a knot that still takes `KNOT_M` of it.
    """

    task = "thread-knot"

    #: Tension and length of the knot at which the goal is met, distance of the grips from the
    #: ends, and height to which the thread is lifted. Source: our own choice. [N, m, m, m]
    PULL_N, KNOT_M, END_M, LIFT_M = 0.5, 0.01, 0.006, 0.012
    #: Distance and speed of each arm's pull, and the length of the knot that ends it. Source: our
    #: own choice; jaws that jerk lose thread. [m, m/s, m]
    PULLS = ((0.05, 0.03, 0.038), (0.02, 0.006, 0.0))

    def reset(self, seed: int) -> dict[str, Array]:
        """Begin an episode, with a loose knot laid about the place of the thread."""
        super().reset(seed)
        name = self.goals[0][0].object
        T = self.object_pose(name)
        self.world.objects[name].set_curve(loose_knot() @ T[:3, :3].T + T[:3, 3])
        self.begin()
        return self.observation()

    def begin(self) -> None:
        """Begin to count, with no tension."""
        self.tension = 0.0
        super().begin()

    def measure(self) -> None:
        """Measure the largest tension on both sides of the knot."""
        found = self.world.threads[self.goals[0][0].object].tension()[[2, -3]]
        self.tension = max(self.tension, float(found.min()))

    def met(self, goal: Goal, at: Array) -> bool:
        """Return whether both arms hold a thread with a knot that was pulled shut."""
        both = all(self.referee.held.get(arm) == goal.object for arm in self.arms)
        pulled = self.tension >= self.PULL_N and self.knotted() >= self.KNOT_M
        return both and pulled and super().met(goal, at)

    def knotted(self) -> float:
        """Return the length by which the thread between both grips exceeds their distance [m]."""
        thread = self.world.threads[self.goals[0][0].object]
        points = thread.points()[2:-2]
        return float(
            (len(points) - 1) * thread.thread.link - np.linalg.norm(points[-1] - points[0])
        )

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        right, left = (Hand(self, arm) for arm in self.arms)
        name = self.goals[0][0].object
        length = self.world.threads[name].thread.length
        for _ in range(TRIES):
            ends = {left: self.END_M, right: length - self.END_M}
            takes = {
                hand.arm: self.take(hand, name, along, self.LIFT_M) for hand, along in ends.items()
            }
            yield from together(self, **takes)
            way = self.middle(name, ends[right])[0] - self.middle(name, ends[left])[0]
            way /= np.linalg.norm(way)
            for far, speed, least in self.PULLS:
                pulls = {left.arm: left.shift(-far * way, speed)}
                pulls[right.arm] = right.shift(far * way, speed)
                for action in together(self, **pulls):
                    yield action
                    if self.tension >= self.PULL_N or self.knotted() < least:
                        break
            yield from together(self, **{left.arm: left.wait(2.0 * SETTLED_S)})


def loose_knot() -> Array:
    """Return points of an open overhand knot with ends to both sides, (n, 3) [m].

    Source: the trefoil of Shastri's polynomials; sizes are our own choice.
    """
    t = np.linspace(-2.02, 2.02, 800)
    knot = np.column_stack([5.2 * (t**3 - 3 * t), 5.2 * (t**4 - 4 * t**2), 0.12 * (t**5 - 10 * t)])
    ahead = knot[-1] - knot[-2]
    first, radius, tail = float(np.arctan2(ahead[1], ahead[0])), 9.0, 13.0
    turn = np.linspace(first, 0.0, 60)[1:]
    bend = np.column_stack([np.sin(first) - np.sin(turn), np.cos(turn) - np.cos(first), 0.0 * turn])
    end = np.concatenate([knot[-1] + radius * bend, knot[-1] + radius * bend[-1:] + [[tail, 0, 0]]])
    whole = np.concatenate([end[::-1] * [-1.0, 1.0, -1.0], knot, end])
    return 1e-3 * (whole - [0.0, np.ptp(whole[:, 1]) / 2 + whole[:, 1].min(), whole[:, 2].min()])
