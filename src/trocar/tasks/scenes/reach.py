"""Tasks of tips and of the endoscope: go somewhere, or look at something."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Goal
from trocar.geometry.se3 import transform
from trocar.kinematics.chain_pose import chain_pose
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.motions import Hand, Motion, together
from trocar.tasks.task import Task

Array = NDArray[np.float64]

#: Ratio of the distance to its goal that the endoscope goes in a period. Source: our own choice.
GAIN = 0.1
#: Step of finite differences [rad, m]. Source: our own choice.
STEP = 1e-5
#: Half width of the damped inverse near singular poses [m]. Source: our own choice.
DAMPING = 1e-3


class Reach(Task):
    """Tips go to places, alone or beside objects."""

    task = "reach"

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        motions: dict[str, Motion] = {}
        for goal, at in self.goals:
            if self.world.arms[goal.arm].description.type == "ECM":
                motions[goal.arm] = self._creep(goal.arm, at)
            else:
                place = at + (self.object_pose(goal.object)[:3, 3] if goal.object else 0.0)
                facing = self.controller.target(goal.arm)[:3, :3]
                motions[goal.arm] = Hand(self, goal.arm).go(transform(facing, place))
        return together(self, **motions)

    def _creep(self, arm: str, at: Array) -> Motion:
        """Yield joint velocities that bring an endoscope's tip to a place, (3,) [m]."""
        scope = self.world.arms[arm]
        while not self.done:
            error = at - scope.measured_cp("world").matrix[:3, 3]
            yield self.joint_rates(arm, lambda T: T[:3, 3], error)

    def joint_rates(self, arm: str, value: Callable[[Array], Array], error: Array) -> Array:
        """Return an endoscope's joint velocities that reduce an error of its tip.

        Args:
            arm: name of the endoscope
            value: function of the tip's pose in the world, (4, 4), whose error it is
            error: (k,)
        """
        scope, base = self.world.arms[arm], self.world.reference_pose(arm)
        q, tip = scope.joints.positions(), chain_pose(scope.description.mechanism)

        def at(joints: Array) -> Array:
            return value(base @ tip(joints))

        here = at(q)
        J = np.array([(at(q + STEP * row) - here) / STEP for row in np.eye(len(q))]).T
        J[:, -1] = 0.0  # the picture stays upright
        damped = J @ J.T + DAMPING**2 * np.eye(len(error))
        return GAIN / PERIOD_S * J.T @ np.linalg.solve(damped, error)


class Track(Reach):
    """The endoscope looks at places: its optical axis passes within `radius` of each goal."""

    task = "track"

    def met(self, goal: Goal, at: Array) -> bool:
        """Return whether the axis passes near a place that lies ahead."""
        seen = self.seen(self.world.arms[goal.arm].measured_cp("world").matrix, at)
        return bool(seen[2] > 0.0 and np.hypot(seen[0], seen[1]) <= goal.radius)

    @staticmethod
    def seen(T: Array, at: Array) -> Array:
        """Return a place in the frame of a tip, (3,) [m]."""
        return T[:3, :3].T @ (at - T[:3, 3])

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        ((goal, _),) = self.goals
        return together(self, **{goal.arm: self._follow(goal.arm)})

    def _follow(self, arm: str) -> Motion:
        while not self.done:
            at = self.goals[0][1]
            here = self.seen(self.world.arms[arm].measured_cp("world").matrix, at)[:2]
            yield self.joint_rates(arm, lambda T, at=at: self.seen(T, at)[:2], -here)


class ActiveTrack(Track):
    """The endoscope follows a target that circles; it is in the middle 95 % of the time."""

    task = "active-track"

    #: Radius of the circle and time of a turn. Source: our own choice. [m, s]
    CIRCLE_M, TURN_S = 0.03, 12.0
    #: Least ratio of the looks at which the target is in the middle. Source: our own choice.
    SHARE = 0.95
    #: Time to find the target at the beginning. Source: our own choice. [s]
    FIND_S = 2.0

    def begin(self) -> None:
        """Begin to count, with the target where the goal is."""
        self._middle = self.goals[0][1]
        self._looks = self._good = 0
        super().begin()

    def measure(self) -> None:
        """Move the target, and count the looks at which it is in the middle."""
        goal, _ = self.goals[0]
        angle = 2.0 * np.pi * self.world.time / self.TURN_S
        at = self._middle + self.CIRCLE_M * np.array([np.cos(angle), np.sin(angle), 0.0])
        self.referee.goals = ((goal, at),)
        if self.world.time > self.FIND_S:
            self._looks += 1
            self._good += self.met(goal, at)

    def accomplished(self, settled: bool, late: bool) -> bool:  # noqa: ARG002  it goes on
        """Return whether the time is over and the target was in the middle for most of it."""
        return late and self._good >= self.SHARE * self._looks


class Upright(Reach):
    """The endoscope rolls until its picture is upright; a reset turns all of its joints."""

    task = "upright"

    #: Largest tilt of an upright picture; tilts at the beginning, and the other joints about the
    #: start pose. Source: our own choice; SurRoL asks for 0.01 rad. [rad, rad, rad and m]
    UPRIGHT_RAD, LEAST_RAD, MOST_RAD = 0.01, np.radians(10.0), np.radians(60.0)
    SPREAD = np.array([0.25, 0.15, 0.03])
    #: Ratio of the tilt that is corrected in a period. Source: our own choice.
    GAIN = 0.1

    def reset(self, seed: int) -> dict[str, Array]:
        """Draw the joints of the endoscope, and begin."""
        super().reset(seed)
        rng = np.random.default_rng((seed, 1))
        (name,) = self.arms
        joints = self.world.arms[name].joints
        q = joints.positions()
        q[:3] += self.SPREAD * rng.uniform(-1.0, 1.0, 3)
        q[3] = 0.0
        self.world.set_state(name, np.clip(q, joints.lower, joints.upper))
        q = joints.positions()
        side = -1.0 if rng.uniform() < 0.5 else 1.0
        tilt = side * cast(float, rng.uniform(self.LEAST_RAD, self.MOST_RAD))
        q[3] = tilt - self.tilt(name)
        self.world.set_state(name, q)
        self.begin()
        return self.observation()

    def met(self, goal: Goal, at: Array) -> bool:  # noqa: ARG002  the place does not count
        """Return whether the picture is upright."""
        return abs(self.tilt(goal.arm)) <= self.UPRIGHT_RAD

    def tilt(self, arm: str) -> float:
        """Return the angle by which an endoscope's picture is rolled from the horizon [rad]."""
        T = self.world.arms[arm].measured_cp("world").matrix
        return float(np.arctan2(T[2, 0], T[2, 1]))

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        (name,) = self.arms
        return together(self, **{name: self._roll(name)})

    def _roll(self, arm: str) -> Motion:
        while not self.done:
            yield np.array([0.0, 0.0, 0.0, -self.GAIN / PERIOD_S * self.tilt(arm)])
