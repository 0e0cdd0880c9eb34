"""Moves: time-optimal set-points within velocity and acceleration limits, and their handles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from ruckig import InputParameter, Result, Ruckig, Trajectory

from trocar.errors import InputError

Array = NDArray[np.float64]


class Motion:
    """A move under way, or over.

    Attributes:
        done: whether the set-point has stopped following this move
        goal_reached: whether the set-point arrived
        goal: joint positions that it moves to, (n,) [rad or m]
    """

    def __init__(self, goal: Array, wait: Callable[[Motion, float | None], bool]) -> None:
        self.goal = goal
        self.done = False
        self.goal_reached = False
        self._wait = wait

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until the move is over and tell whether the goal was reached.

        Steps the world when no loop runs it, else blocks. Time is simulation time.
        """
        return self._wait(self, timeout_s)

    def finish(self, reached: bool) -> None:
        """Mark the move as over."""
        if not self.done:
            self.done = True
            self.goal_reached = reached


class Profile:
    """Set-points from a state to a goal at rest.

    Jerk is unlimited and all joints arrive together, as with the dVRK's Reflexxes type II.
    """

    def __init__(
        self,
        start: tuple[Array, Array, Array],
        goal: Array,
        limits: tuple[Array, Array],
        time: float,
    ) -> None:
        count = len(goal)
        wanted = InputParameter(count)
        position, velocity, acceleration = start
        most, rate = limits
        wanted.current_position = position.tolist()
        wanted.current_velocity = np.clip(velocity, -most, most).tolist()
        wanted.current_acceleration = np.clip(acceleration, -rate, rate).tolist()
        wanted.target_position = goal.tolist()
        wanted.max_velocity = most.tolist()
        wanted.max_acceleration = rate.tolist()
        self._path = Trajectory(count)
        result = Ruckig(count).calculate(wanted, self._path)
        if result not in (Result.Working, Result.Finished):
            raise InputError(f"no trajectory to {goal.tolist()}: {result}")
        self.start = time
        self.duration = float(self._path.duration)

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Return (position, velocity, acceleration) at a time, (n,) each."""
        since = min(max(time - self.start, 0.0), self.duration)
        position, velocity, acceleration = self._path.at_time(since)
        return np.array(position), np.array(velocity), np.array(acceleration)

    def over(self, time: float) -> bool:
        """Tell whether the set-point has arrived."""
        return time >= self.start + self.duration - 1e-12
