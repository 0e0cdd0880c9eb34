"""Dynamic tasks: push, stack, stop a pendulum, pull a band, carry with two arms, carry balls."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Goal
from trocar.descriptions.sensors import TensionReading
from trocar.geometry.se3 import transform
from trocar.tasks.motions import TRIES, UP, Hand, Motion, together
from trocar.tasks.referee import SETTLED_S
from trocar.tasks.scenes.transfer import Carry, across
from trocar.tasks.task import Task

Array = NDArray[np.float64]


class Push(Task):
    """A puck is pushed along the table to a place, by the closed jaw."""

    task = "push"

    #: Radius of the puck and of the jaw's end, height of the pads' ends above the table, height of
    #: the way, speed, and steering: speed of the jaw across the line per distance of the puck
    #: from it. Source: the scene's puck; the rest is our own choice. [m, m/s, 1/s]
    RADIUS_M, END_M, LOW_M, WAY_M, SPEED_M_S, STEER = 0.01, 0.003, 0.003, 0.03, 0.03, 2.0

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        return together(self, **{self.arms[0]: self._run(Hand(self, self.arms[0]))})

    def _run(self, hand: Hand) -> Motion:
        ((goal, at),) = self.goals
        yield from hand.close(0.0)
        for _ in range(TRIES):
            way, _ = self._way(goal, at)
            behind = self.object_pose(goal.object)[:3, 3] - (self.RADIUS_M + 0.006) * way
            behind[2] = self.LOW_M - 0.002
            yield from hand.over(behind, self.WAY_M, 0.0)
            yield from hand.over(behind, 0.0)
            for _ in range(400):
                way, far = self._way(goal, at)
                if far < 0.0005:
                    break
                here = self.controller.target(hand.arm)[:3, 3]
                off = self.object_pose(goal.object)[:3, 3] - here
                side = np.array([-way[1], way[0], 0.0])
                speed = min(self.SPEED_M_S, 2.0 * far + 0.004)
                step = speed * way + self.STEER * float(off @ side) * side
                yield np.concatenate([step, np.zeros(3), [hand.jaw]])
            way, _ = self._way(goal, at)
            yield from hand.shift(-0.006 * way)
            yield from hand.shift(self.WAY_M * UP)
            yield from hand.wait(2.0 * SETTLED_S)

    def _way(self, goal: Goal, at: Array) -> tuple[Array, float]:
        """Return the direction from the object to its place, and the distance [m]."""
        way = (at - self.object_pose(goal.object)[:3, 3]) * [1.0, 1.0, 0.0]
        far = float(np.linalg.norm(way))
        return way / max(far, 1e-9), far


class Stack(Carry):
    """Blocks are put on top of each other."""

    task = "stack"

    GRASP_M, RELEASE_M, OPENING = 0.001, 0.0005, 0.9


class Pendulum(Task):
    """A pendulum is stopped: the closed jaw meets it from the side, and leaves it at rest.

    It is met when it hangs at rest and no arm touches it.
    """

    task = "pendulum"

    #: Speed of the bob at rest; distance from the bob's middle at which the jaw meets it, height
    #: above it. Source: our own choice, the bob of the scene. [m/s, m]
    REST_M_S, SIDE_M, WAY_M = 0.02, 0.009, 0.03

    def met(self, goal: Goal, at: Array) -> bool:
        """Return whether it hangs at rest, away from the jaw."""
        states = self.referee.states
        row = states.names.index(goal.object)
        T = self.object_pose(goal.object)
        tip = self.referee.tips[self.arms[0]][:3, 3]
        bob = T[:3, 3] + T[:3, :3] @ self.bob
        alone = np.linalg.norm((tip - bob)[:2]) > self.SIDE_M + 0.002
        swinging = abs(states.joint[row, 1]) * np.linalg.norm(self.bob) > self.REST_M_S
        off = bob - at
        return bool(alone and not swinging and np.hypot(off[0], off[1]) <= goal.radius)

    @property
    def bob(self) -> Array:
        """The middle of the bob in the pendulum's frame, (3,) [m]."""
        prop = next(p for p in self.scene.rig.objects if p.name == self.scene.goals[0].object)
        return next(s.pose[:3, 3] for s in prop.shapes if s.kind == "sphere")

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        return together(self, **{self.arms[0]: self._run(Hand(self, self.arms[0]))})

    def _run(self, hand: Hand) -> Motion:
        ((_, at),) = self.goals
        side = 1.0 if self.controller.target(hand.arm)[0, 3] > at[0] else -1.0
        beside = at + hand.reach * UP
        down = hand.pointing_down(np.pi / 2.0, beside)
        outwards = np.array([side, 0.0, 0.0])
        yield from hand.close(0.0)
        for _ in range(TRIES):
            yield from hand.go(transform(down, beside + 0.035 * outwards))
            yield from hand.go(transform(down, beside + self.SIDE_M * outwards), 0.05)
            yield from hand.wait(1.0)
            yield from hand.shift(0.012 * outwards, 0.006)
            yield from hand.wait(0.4)


class BandPull(Task):
    """A handle on an elastic band is pulled until the band has a tension, which is held."""

    task = "band-pull"

    #: Speed per newton, tolerance of the tension, and time for which it must be kept. Source: our
    #: own choice. [m/s/N, N, s]
    M_S_PER_N, NEAR_N, HELD_S = 0.04, 0.05, 1.0
    #: Range of the tension that a reset draws. Source: our own choice. [N]
    LEAST_N, MOST_N = 0.5, 1.2
    WAY_M = 0.015

    def reset(self, seed: int) -> dict[str, Array]:
        """Draw the tension, and begin."""
        rng = np.random.default_rng((seed, 1))
        self.wanted = float(rng.uniform(self.LEAST_N, self.MOST_N))
        return super().reset(seed)

    def begin(self) -> None:
        """Begin to count, with no tension held."""
        self._near_since: float | None = None
        super().begin()

    def observation(self) -> dict[str, Array]:
        """Return also the tension of the band, and the goal of it [N]."""
        return {**super().observation(), "tension": np.array([self.tension(), self.wanted])}

    def tension(self) -> float:
        """Return the tension of the band [N]."""
        return cast(TensionReading, self.world.sensor("pull")).tension

    def met(self, goal: Goal, at: Array) -> bool:  # noqa: ARG002
        """Return whether the handle is held, and the tension was right for a second."""
        held = goal.object in self.referee.held.values()
        if not held or abs(self.tension() - self.wanted) > self.NEAR_N:
            self._near_since = None
            return False
        if self._near_since is None:
            self._near_since = self.world.time
        return self.world.time - self._near_since >= self.HELD_S

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        return together(self, **{self.arms[0]: self._run(Hand(self, self.arms[0]))})

    def _run(self, hand: Hand) -> Motion:
        name = self.goals[0][0].object

        def grip() -> tuple[Array, float]:
            T = self.object_pose(name)
            return T[:3, 3] + 0.001 * UP, across(T)

        yield from hand.take(name, grip, self.WAY_M)
        away = self.object_pose(name)[:3, 3] - self.goals[0][1]
        away[2] = 0.0
        away /= np.linalg.norm(away)
        while not self.done:
            lacking = self.wanted - self.tension()
            speed = float(np.clip(self.M_S_PER_N * lacking, -0.03, 0.03))
            yield np.concatenate([speed * away, np.zeros(3), [hand.jaw]])


class BarCarry(Task):
    """Two arms lift one bar by its ends, carry it to a place, and put it down."""

    task = "bar-carry"

    #: Distance of the grips from its middle, along its x axis; heights. Source: the scene. [m]
    END_M, WAY_M, RELEASE_M, OPENING = 0.026, 0.02, 0.001, 0.9

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        ((goal, at),) = self.goals
        right, left = (Hand(self, arm) for arm in self.arms)

        def both(one: Motion, other: Motion) -> Iterator[Array]:
            return together(self, **{right.arm: one, left.arm: other})

        for _ in range(TRIES):
            T = self.object_pose(goal.object)
            ends = [T[:3, 3] + sign * self.END_M * T[:3, 0] for sign in (1.0, -1.0)]
            if ends[0][0] < ends[1][0]:
                ends.reverse()
            angle = across(T)
            yield from both(
                *(
                    hand.grasp(end, angle, self.WAY_M, self.OPENING)
                    for hand, end in zip((right, left), ends, strict=True)
                )
            )
            place = at + self.RELEASE_M * UP - self.object_pose(goal.object)[:3, 3]
            up = self.WAY_M * UP
            for way in (up, place * [1.0, 1.0, 0.0], place * [0.0, 0.0, 1.0] - up):
                yield from both(*(hand.shift(way, 0.06) for hand in (right, left)))
            yield from both(right.open(self.OPENING), left.open(self.OPENING))
            yield from both(*(hand.shift(up) for hand in (right, left)))
            yield from both(right.wait(2.0 * SETTLED_S), left.wait(2.0 * SETTLED_S))
            if self.done:
                return


class TrayCarry(Carry):
    """A tray with balls is carried by its handle; the balls stay on it."""

    task = "tray-carry"

    #: Source: the scene; speed is our own choice.
    GRASP_M, WAY_M, RELEASE_M, SPEED_M_S = 0.013, 0.015, 0.0005, 0.05

    def _run(self, hand: Hand) -> Motion:
        ((goal, at), *_) = self.goals
        yield from hand.take(goal.object, lambda: self.grasp(goal.object), self.WAY_M)
        way = at - self.object_pose(goal.object)[:3, 3]
        yield from hand.shift(way * [1.0, 1.0, 0.0], self.SPEED_M_S)
        low = at + self.RELEASE_M * UP - self.object_pose(goal.object)[:3, 3]
        yield from hand.shift(low, self.SPEED_M_S)
        yield from hand.open(self.OPENING)
        yield from hand.shift(0.03 * UP)
