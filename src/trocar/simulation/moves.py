"""Moves: time-optimal set-points within velocity and acceleration limits, and their handles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ruckig
from numpy.typing import NDArray

from trocar.errors import InputError

Array = NDArray[np.float64]
#: The library, which has no type stubs.
_RUCKIG: Any = ruckig

RATIO_MIN = 0.002
"""Least trajectory ratio of a move. Source: Ruckig plans at most 7600 s; at this ratio the longest
move of the catalogue, suj_psm3 over its whole range, takes 6600 s. The dVRK accepts ]0, 1]."""


class Motion:
    """A move under way, or over.

    Attributes:
        done: whether no set-point follows this move any longer
        goal_reached: whether the set-points arrived
        goal: joint positions that it moves to, (n,) [rad or m]
        reason: why the command was rejected, "" if it was not
    """

    def __init__(
        self, goal: Array, wait: Callable[[Motion, float | None], bool], parts: int = 1
    ) -> None:
        self.goal = goal
        self.reason = ""
        self._wait = wait
        self._left = parts
        self._arrived = parts > 0

    def __repr__(self) -> str:
        if self.reason:
            return f"<Motion rejected: {self.reason}>"
        ended = "goal reached" if self.goal_reached else "goal not reached"
        goal = ", ".join(f"{value:.4g}" for value in self.goal)
        return f"<Motion to ({goal}): {ended if self.done else 'under way'}>"

    @property
    def done(self) -> bool:
        """Whether no set-point follows this move any longer."""
        return self._left == 0

    @property
    def goal_reached(self) -> bool:
        """Whether the set-points arrived, all of them."""
        return self.done and self._arrived

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until the move is over and return whether the goal was reached.

        Steps the world when no loop runs it, else blocks. Time is simulation time.
        """
        return self._wait(self, timeout_s)

    def save(self) -> tuple[Array, int, bool]:
        """Return the goal, how many parts are under way, and whether all until now arrived."""
        return self.goal.copy(), self._left, self._arrived

    def load(self, left: int, arrived: bool) -> None:
        """Go on where a saved move was."""
        self._left, self._arrived = left, arrived

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
        profile_input = _RUCKIG.InputParameter(count)
        position, velocity = start
        most, rate = limits
        profile_input.current_position = position.tolist()
        profile_input.current_velocity = np.clip(velocity, -most, most).tolist()
        profile_input.target_position = goal.tolist()
        profile_input.max_velocity = most.tolist()
        profile_input.max_acceleration = rate.tolist()
        self._inputs = (position.copy(), velocity.copy()), goal.copy(), limits, time
        self._path = _RUCKIG.Trajectory(count)
        try:
            result = _RUCKIG.Ruckig(count).calculate(profile_input, self._path)
        except (
            _RUCKIG.RuckigError,
            ValueError,
        ) as error:  # ValueError: a result that its enum lacks
            raise InputError(
                f"no trajectory from {position.tolist()} to {goal.tolist()} within velocities"
                f" {most.tolist()} and accelerations {rate.tolist()}"
            ) from error
        if result not in (_RUCKIG.Result.Working, _RUCKIG.Result.Finished):
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
        """Return whether the set-point has arrived."""
        return time >= self.start + self.duration - 1e-12

    def __reduce__(self) -> tuple[type[Profile], tuple[object, ...]]:
        """Pickle the inputs, from which the same profile is planned again."""
        return Profile, self._inputs


@dataclass(frozen=True, eq=False)
class Leg:
    """The part of a move that some joints make."""

    motion: Motion
    profile: Profile
    part: slice


@dataclass(frozen=True, eq=False)
class Drift:
    """Set-points that go on at constant velocities, each joint until it is at a limit.

    Attributes:
        part: joints that drift
        start, velocity: at the beginning, (n,) [rad or m, per s]
        lower, upper: limits, (n,) [rad or m]
        time: of the beginning [s]
    """

    part: slice
    start: Array
    velocity: Array
    lower: Array
    upper: Array
    time: float

    def at(self, time: float) -> tuple[Array, Array]:
        """Return (position, velocity) at a time, (n,) each."""
        ahead = self.start + self.velocity * (time - self.time)
        inside = np.clip(ahead, self.lower, self.upper)
        return inside, np.where(inside == ahead, self.velocity, 0.0)


class Moves:
    """The moves of one arm; its joints and its jaw move independently of each other.

    Args:
        position, velocity: set-points, (n,) [rad or m, per s]; written in place
        limits: largest velocities and accelerations, (n,) each
        wait: waits for a move
        over: called with every move that ends

    Attributes:
        velocity_max: largest velocities, (n,)
        velocity_ratio, acceleration_ratio: of the limits that moves keep to, RATIO_MIN to 1
        legs: moves under way
        drift: joints that go on at constant velocities, if any do
    """

    def __init__(
        self,
        position: Array,
        velocity: Array,
        limits: tuple[Array, Array],
        wait: Callable[[Motion, float | None], bool],
        over: Callable[[Motion], None],
    ) -> None:
        self._position, self._velocity, self._limits = position, velocity, limits
        self._wait, self._over = wait, over
        self.velocity_max = limits[0]
        self.velocity_ratio = self.acceleration_ratio = 1.0
        self.legs: list[Leg] = []
        self.drift: Drift | None = None

    def reattach(self, position: Array, velocity: Array) -> None:
        """Go on with set-points in another place."""
        self._position, self._velocity = position, velocity

    def motion(self, goal: Array, parts: int = 1) -> Motion:
        """Return the handle of a move to a goal that so many parts make."""
        return Motion(goal, self._wait, parts)

    def begin(self, goal: Array, parts: Sequence[slice], time: float) -> Motion:
        """Start a move of adjoining parts to a goal, from where their set-points are and go.

        Moves that these joints were making end; those of other joints go on.

        Raises:
            InputError: no trajectory leads there; nothing changes
        """
        first, motion = parts[0].start, self.motion(goal, len(parts))
        most, rate = self._limits
        legs: list[Leg] = []
        for part in parts:
            start = self._position[part].copy(), self._velocity[part].copy()
            limits = self.velocity_ratio * most[part], self.acceleration_ratio * rate[part]
            there = goal[part.start - first : part.stop - first]
            legs.append(Leg(motion, Profile(start, there, limits, time), part))
        for part in parts:
            self.end(part)
        self.legs += legs
        return motion

    @property
    def active(self) -> bool:
        """Whether set-points change as time passes."""
        return bool(self.legs) or self.drift is not None

    def end(self, part: slice) -> None:
        """End the moves of some joints; the caller sets their next set-points."""
        for leg in list(self.legs):
            if leg.part.start < part.stop and part.start < leg.part.stop:
                self._finish(leg, False)
        drift = self.drift
        if drift and drift.part.start < part.stop and part.start < drift.part.stop:
            self.drift = None

    def goal(self, part: slice) -> Array:
        """Return the goals of some joints, or their set-points where nothing moves, (n,)."""
        goal = self._position.copy()
        for leg in self.legs:
            goal[leg.part] = leg.profile.goal
        return goal[part]

    def follow(self, time: float) -> None:
        """Advance the set-points to a time."""
        for leg in list(self.legs):
            self._position[leg.part], self._velocity[leg.part] = leg.profile.at(time)
            if leg.profile.over(time):
                self._finish(leg, True)
        if self.drift:
            part = self.drift.part
            self._position[part], self._velocity[part] = self.drift.at(time)

    def _finish(self, leg: Leg, reached: bool) -> None:
        self.legs.remove(leg)
        leg.motion.finish(reached)
        if leg.motion.done:
            self._over(leg.motion)
