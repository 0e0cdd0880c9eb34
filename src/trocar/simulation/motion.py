"""Moves: time-optimal set-points within velocity and acceleration limits, and their handles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from ruckig import InputParameter, Result, Ruckig, RuckigError, Trajectory

from trocar.errors import InputError

Array = NDArray[np.float64]

RATIO_MIN = 0.002
"""Least trajectory ratio of a move. Source: Ruckig plans at most 7600 s; at this ratio the longest
move of the catalogue, suj_psm3 over its whole range, takes 6600 s. The dVRK accepts ]0, 1]."""


class Motion:
    """A move under way, or over.

    Attributes:
        done: whether no set-point follows this move any longer
        goal_reached: whether the set-points arrived
        goal: joint positions that it moves to, (n,) [rad or m]
    """

    def __init__(
        self, goal: Array, wait: Callable[[Motion, float | None], bool], parts: int = 1
    ) -> None:
        self.goal = goal
        self._wait = wait
        self._left = parts
        self._arrived = parts > 0

    @property
    def done(self) -> bool:
        """Whether no set-point follows this move any longer."""
        return self._left == 0

    @property
    def goal_reached(self) -> bool:
        """Whether the set-points arrived, all of them."""
        return self.done and self._arrived

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until the move is over and tell whether the goal was reached.

        Steps the world when no loop runs it, else blocks. Time is simulation time.
        """
        return self._wait(self, timeout_s)

    def finish(self, reached: bool) -> None:
        """Mark one of the move's parts as over."""
        self._left -= 1
        self._arrived &= reached


class Profile:
    """Set-points from a position and velocity to a goal at rest.

    Jerk is unlimited and all joints arrive together, as with the dVRK's Reflexxes type II.
    """

    def __init__(
        self,
        start: tuple[Array, Array],
        goal: Array,
        limits: tuple[Array, Array],
        time: float,
    ) -> None:
        count = len(goal)
        wanted = InputParameter(count)
        position, velocity = start
        most, rate = limits
        wanted.current_position = position.tolist()
        wanted.current_velocity = np.clip(velocity, -most, most).tolist()
        wanted.target_position = goal.tolist()
        wanted.max_velocity = most.tolist()
        wanted.max_acceleration = rate.tolist()
        self._path = Trajectory(count)
        try:
            result = Ruckig(count).calculate(wanted, self._path)
        except (RuckigError, ValueError) as error:  # ValueError: a result that its enum lacks
            raise InputError(
                f"no trajectory from {position.tolist()} to {goal.tolist()} within velocities"
                f" {most.tolist()} and accelerations {rate.tolist()}"
            ) from error
        if result not in (Result.Working, Result.Finished):
            raise InputError(f"no trajectory to {goal.tolist()}: {result}")
        self.goal = goal.copy()
        self.start = time
        self.duration = float(self._path.duration)

    def at(self, time: float) -> tuple[Array, Array]:
        """Return (position, velocity) at a time, (n,) each; at rest on the goal once over."""
        if self.over(time):
            return self.goal.copy(), np.zeros(len(self.goal))
        position, velocity, _ = self._path.at_time(max(time - self.start, 0.0))
        return np.array(position), np.array(velocity)

    def over(self, time: float) -> bool:
        """Tell whether the set-point has arrived."""
        return time >= self.start + self.duration - 1e-12
