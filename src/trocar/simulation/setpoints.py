"""What an arm's servos are told, and the moves that change it as time passes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.motion import Motion, Profile

Array = NDArray[np.float64]
Wait = Callable[[Motion, float | None], bool]


@dataclass(frozen=True, eq=False)
class Leg:
    """The part of a move that some joints make."""

    motion: Motion
    profile: Profile
    part: slice


class SetPoints:
    """Set-points of every joint; arm and jaw move independently of each other.

    Attributes:
        position, velocity, effort: (n,) [rad or m, per s, N m or N]
        velocity_ratio, acceleration_ratio: shares of the limits that moves keep to, RATIO_MIN to 1
    """

    def __init__(
        self,
        velocity_max: Array,
        acceleration_max: Array,
        wait: Wait,
        over: Callable[[Motion], None],
    ) -> None:
        self._most, self._rate = velocity_max, acceleration_max
        self._wait, self._over = wait, over
        self.velocity_ratio = self.acceleration_ratio = 1.0
        self._legs: list[Leg] = []
        self.position = np.zeros(len(velocity_max))
        self.velocity = np.zeros(len(velocity_max))
        self.effort = np.zeros(len(velocity_max))

    @property
    def moving(self) -> bool:
        """Whether a move is under way."""
        return bool(self._legs)

    def put(self, q: Array) -> None:
        """End every move and rest at q, (n,), without effort."""
        self.end(slice(0, len(q)))
        self.position = q.copy()
        self.velocity = np.zeros(len(q))
        self.effort = np.zeros(len(q))

    def servo(self, part: slice, q: Array, v: Array) -> None:
        """Set positions and velocities of some joints now; their moves end."""
        self.end(part)
        self.position[part] = q
        self.velocity[part] = v

    def move(self, goal: Array, parts: Sequence[slice], time: float) -> Motion:
        """Start a move of adjoining parts to a goal, from where their set-points are and go.

        Moves that these joints were making end; those of other joints go on.

        Raises:
            InputError: no trajectory leads there; nothing changes
        """
        first = parts[0].start
        motion = Motion(goal, self._wait, len(parts))
        legs: list[Leg] = []
        for part in parts:
            start = (self.position[part], self.velocity[part])
            limits = (
                self.velocity_ratio * self._most[part],
                self.acceleration_ratio * self._rate[part],
            )
            there = goal[part.start - first : part.stop - first]
            legs.append(Leg(motion, Profile(start, there, limits, time), part))
        for part in parts:
            self.end(part)
        self._legs += legs
        return motion

    def end(self, part: slice) -> None:
        """End the moves of some joints; what they are told next is up to the caller."""
        for leg in list(self._legs):
            if leg.part.start < part.stop and part.start < leg.part.stop:
                self._finish(leg, False)

    def goal(self, part: slice) -> Array:
        """Return where some joints are on their way to, or are, (n,)."""
        goal = self.position.copy()
        for leg in self._legs:
            goal[leg.part] = leg.profile.goal
        return goal[part]

    def follow(self, time: float) -> None:
        """Advance to a time."""
        for leg in list(self._legs):
            self.position[leg.part], self.velocity[leg.part] = leg.profile.at(time)
            if leg.profile.over(time):
                self._finish(leg, True)

    def _finish(self, leg: Leg, reached: bool) -> None:
        self._legs.remove(leg)
        leg.motion.finish(reached)
        if leg.motion.done:
            self._over(leg.motion)
