"""Moves: time-optimal set-points within velocity and acceleration limits, and their handles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import ruckig
from numpy.typing import NDArray

from trocar.errors import InputError

Array = NDArray[np.float64]
#: The library, which has no type stubs.
_RUCKIG: Any = ruckig


class Motion:
    """A move under way, or over.

    Attributes:
        done: whether no set-point follows this move any longer
        goal_reached: whether the set-points arrived
        goal: joint positions that it moves to, (n,) [rad or m]
        reason: why the command was rejected, "" if it was not
    """

    def __init__(self, goal: Array, wait: Callable[[Motion, float | None], bool]) -> None:
        self.goal = goal
        self.reason = ""
        self.done = self.goal_reached = False
        self._wait = wait

    def __repr__(self) -> str:
        if self.reason:
            return f"<Motion rejected: {self.reason}>"
        ended = "goal reached" if self.goal_reached else "goal not reached"
        goal = ", ".join(f"{value:.4g}" for value in self.goal)
        return f"<Motion to ({goal}): {ended if self.done else 'under way'}>"

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until the move is over and return whether the goal was reached.

        Steps the world when no loop runs it, else blocks. Time is simulation time.
        """
        return self._wait(self, timeout_s)

    def finish(self, reached: bool) -> None:
        """Mark the move as over."""
        self.done, self.goal_reached = True, reached


class Profile:
    """Set-points from a position and velocity to a goal at rest.

    Jerk is unlimited and all joints arrive together, as with the dVRK's Reflexxes type II. Where
    the trajectory leads beyond bounds, set-points wait there, also on its way back. Source: SAW,
    mtsIntuitiveResearchKitArm.cpp:1548 and mtsIntuitiveResearchKitPSM.cpp:1383, which clip what the
    trajectory has, but not the trajectory.

    Args:
        start: position and velocity, (n,) each [rad or m, per s]
        goal: (n,) [rad or m]
        limits: largest velocities and accelerations, (n,) each
        time: of the beginning [s]
        bounds: lower and upper bound of set-points, (n,) each; None: none

    Raises:
        InputError: no trajectory leads there
    """

    def __init__(
        self,
        start: tuple[Array, Array],
        goal: Array,
        limits: tuple[Array, Array],
        time: float,
        bounds: tuple[Array, Array] | None = None,
    ) -> None:
        count = len(goal)
        profile_input = _RUCKIG.InputParameter(count)
        position, velocity = start
        most, rate = limits
        profile_input.current_position = position.tolist()
        profile_input.current_velocity = velocity.tolist()
        profile_input.target_position = goal.tolist()
        profile_input.max_velocity = most.tolist()
        profile_input.max_acceleration = rate.tolist()
        self._inputs = (position.copy(), velocity.copy()), goal.copy(), limits, time, bounds
        self._path = _RUCKIG.Trajectory(count)
        try:
            result = _RUCKIG.Ruckig(count).calculate(profile_input, self._path)
        except (
            _RUCKIG.RuckigError,
            ValueError,
        ) as error:  # ValueError: a result that its enum lacks; it plans at most 7600 s
            raise InputError(
                f"no trajectory from {position.tolist()} to {goal.tolist()} within velocities"
                f" {most.tolist()} and accelerations {rate.tolist()}"
            ) from error
        if result not in (_RUCKIG.Result.Working, _RUCKIG.Result.Finished):
            raise InputError(f"no trajectory to {goal.tolist()}: {result}")
        self.goal = goal.copy()
        self.start = time
        self.duration = float(self._path.duration)
        #: None where no bound is met: from rest a trajectory stays between its ends.
        self._bounds = bounds
        if bounds is not None and not velocity.any():
            lower, upper = bounds
            ends = np.array([position, goal])
            if (ends >= lower).all() and (ends <= upper).all():
                self._bounds = None

    def at(self, time: float) -> tuple[Array, Array]:
        """Return (position, velocity) of set-points at a time, (n,) each; at rest once over."""
        position, velocity = self.ahead(time)
        if self._bounds is None:
            return position, velocity
        inside = np.clip(position, *self._bounds)
        return inside, np.where(inside == position, velocity, 0.0)

    def ahead(self, time: float) -> tuple[Array, Array]:
        """Return (position, velocity) of the trajectory itself, (n,) each."""
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
    """The moves of one arm: one trajectory of its joints and its jaw, which arrive together.

    Source: SAW, mtsIntuitiveResearchKitArm.cpp (move_jp, move_jr, SetControlSpaceAndMode) and
    mtsIntuitiveResearchKitPSM.cpp:1349 (jaw_move_jp).

    Args:
        position, velocity: set-points, (n,) [rad or m, per s]; written in place
        limits: largest velocities and accelerations, (n,) each
        bounds: lower and upper limits of positions, (n,) each [rad or m]
        joints: those that moves move, the jaw is the last where there is one
        own: those of them that are not the jaw
        wait: waits for a move
        over: called with whether it arrived when a trajectory ends

    Attributes:
        velocity_max: largest velocities, (n,)
        velocity_ratio, acceleration_ratio: of the limits that moves keep to, in ]0, 1]
        profile: the trajectory under way, None without one
        motions: handles of the moves that it makes, with the joints of each
        target: goal of the last trajectory, (n,) [rad or m]
        tracking: whether a trajectory was the last command that set positions
        cartesian: whether the arm's last command was one of its tip, which was deep enough
        silent: whether the end of the trajectory under way makes no event
        drift: joints that go on at constant velocities, if any do
    """

    def __init__(
        self,
        position: Array,
        velocity: Array,
        limits: tuple[Array, Array],
        bounds: tuple[Array, Array],
        joints: tuple[slice, slice],
        wait: Callable[[Motion, float | None], bool],
        over: Callable[[bool], None],
    ) -> None:
        self._position, self._velocity, self._limits = position, velocity, limits
        self._bounds = bounds
        self.joints, self._own = joints
        self._wait, self._over = wait, over
        self.velocity_max = limits[0]
        self.velocity_ratio = self.acceleration_ratio = 1.0
        self.profile: Profile | None = None
        self.motions: list[tuple[Motion, slice]] = []
        self.target = position.copy()
        self.tracking = self.silent = self.cartesian = False
        self.drift: Drift | None = None

    def reattach(self, position: Array, velocity: Array) -> None:
        """Go on with set-points in another place."""
        self._position, self._velocity = position, velocity

    def motion(self, goal: Array) -> Motion:
        """Return the handle of a move to a goal."""
        return Motion(goal, self._wait)

    def begin(
        self,
        goal: Array,
        part: slice,
        time: float,
        silent: bool = False,
        jaw: float | None = None,
    ) -> Motion:
        """Move some joints to a goal, from where their set-points are and go.

        From beyond a limit, where only the last trajectory went, it leads back from there.

        The other joints go on to theirs, and all arrive together. Where no trajectory was before,
        the arm's joints stay for a move of the jaw; for one of the arm the jaw goes to the goal of
        its last trajectory, as on the robot.

        Args:
            goal: of the joints of `part`, (n,) [rad or m]
            part: which joints
            time: of the beginning, now or later [s]
            silent: whether its end makes no event, as that of a homing, which no limit bounds
            jaw: another goal of the jaw, which goes along [rad]

        Raises:
            InputError: no trajectory leads there; nothing changes
        """
        target = self.target.copy()
        if not self.tracking:
            target[self._own] = self._position[self._own]
        target[part] = goal
        if jaw is not None:
            target[self.joints.stop - 1] = jaw
        profile = self._plan(target, time, bounded=not silent)
        for motion, moved in list(self.motions):
            if moved.start < part.stop and part.start < moved.stop:
                motion.finish(False)
                self.motions.remove((motion, moved))
        self._end_drift(self.joints)
        motion = self.motion(goal.copy())
        self.motions.append((motion, part))
        self.profile, self.target, self.tracking, self.silent = profile, target, True, silent
        self.cartesian = self.cartesian and part.start >= self._own.stop
        return motion

    def plan_again(self, time: float) -> None:
        """Go on to the goal within limits that changed."""
        if self.profile is not None:
            start = max(time, self.profile.start)
            self.profile = self._plan(self.target, start, bounded=not self.silent)

    def end(self, part: slice) -> None:
        """End the trajectory, for a command to some joints that sets their next set-points."""
        if part.start < self.joints.stop and self.joints.start < part.stop:
            self.tracking = False
            self.cartesian = self.cartesian and part.start >= self._own.stop
            if self.profile is not None:
                self._velocity[self.joints] = 0.0
                self._finish(False)
        self._end_drift(part)

    def goal(self, part: slice) -> Array:
        """Return the goals of some joints, or their set-points where nothing moves, (n,)."""
        return (self._position if self.profile is None else self.target)[part].copy()

    def rest(self, q: Array) -> None:
        """Take joint positions as those of the last trajectory, (n,), without a move."""
        self.end(slice(0, len(q)))
        self.target = q.copy()

    def follow(self, time: float) -> None:
        """Advance the set-points to a time."""
        profile = self.profile
        if profile is not None:
            self._position[self.joints], self._velocity[self.joints] = profile.at(time)
            if profile.over(time):
                self._finish(True)
        if self.drift:
            part = self.drift.part
            self._position[part], self._velocity[part] = self.drift.at(time)

    def _plan(self, target: Array, time: float, *, bounded: bool) -> Profile:
        part = self.joints
        q, v = self._position[part].copy(), self._velocity[part].copy()
        lower, upper = (bound[part] for bound in self._bounds)
        bounds = np.minimum(lower, q), np.maximum(upper, q)
        if self.tracking:
            profile = self.profile
            own, rate = (self.target[part], 0.0 * v) if profile is None else profile.ahead(time)
            beyond = (own < lower) | (own > upper)
            q[beyond], v[beyond] = own[beyond], rate[beyond]
        most, rate = self._limits
        limits = self.velocity_ratio * most[part], self.acceleration_ratio * rate[part]
        try:
            return Profile((q, v), target[part], limits, time, bounds if bounded else None)
        except InputError as problem:
            raise InputError(
                f"no trajectory at ratios {self.velocity_ratio:g} of velocities and"
                f" {self.acceleration_ratio:g} of accelerations; allowed: one of at most 7600 s"
            ) from problem

    def _end_drift(self, part: slice) -> None:
        drift = self.drift
        if drift and drift.part.start < part.stop and part.start < drift.part.stop:
            self.drift = None

    def _finish(self, reached: bool) -> None:
        self.profile = None
        motions, self.motions = self.motions, []
        for motion, _ in motions:
            motion.finish(reached)
        if not self.silent:
            self._over(reached)
