"""What an arm is told, for any part of its joints: checked, clipped, handed to the motors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import ArmDescription
from trocar.simulation.drives import Drives
from trocar.simulation.journal import Journal
from trocar.simulation.motion import Motion
from trocar.simulation.records import JointState
from trocar.simulation.refusals import Refusals
from trocar.simulation.setpoints import SetPoints
from trocar.simulation.states import States

Array = NDArray[np.float64]

#: A joint whose brake is locked was asked to move when its target is farther than this from where
#: it is told to be. Source: our own choice; below it a reading that is sent back. [rad or m]
BRAKE_SLACK = 1e-4


class Clock(Protocol):
    """What an arm needs of its world."""

    @property
    def journal(self) -> Journal:
        """Where commands and events are told."""
        ...

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        ...

    def wait(self, motion: Motion, timeout_s: float | None) -> bool:
        """Wait for a move."""
        ...

    def base_pose(self, name: str) -> tuple[Array, str]:
        """Return the pose of an arm's reference frame in the frame of its public poses."""
        ...

    def exchange_tool(self, name: str, tool: str) -> None:
        """Mount another tool on an arm."""
        ...


class Verbs:
    """Commands and readings of an arm's joints, for the arm without its jaw and for the jaw.

    A position command takes joints back from effort control that an effort command had taken; a
    joint that was put into mode "effort" on purpose stays there.

    Attributes:
        setpoints: what the servos are told
        refusals: what was wrong with commands
        states: the operating state
        strict_limits: whether targets beyond limits are refused in place of clipped
    """

    def __init__(self, name: str, arm: ArmDescription, drives: Drives, clock: Clock) -> None:
        self._name = name
        self._names = arm.mechanism.joint_names
        self._lower, self._upper = arm.mechanism.lower, arm.mechanism.upper
        self._drives, self._clock = drives, clock
        #: Joints that an effort command took from position control, and that a law took back.
        self._lent: set[int] = set()
        self._taken: set[int] = set()
        self.states = States()
        self.strict_limits = False
        self.refusals = Refusals(name, lambda: clock.time, clock.journal)
        self.setpoints = SetPoints(
            np.array([j.velocity_max for j in arm.joints]),
            np.array([j.acceleration_max for j in arm.joints]),
            clock.wait,
            self._over,
        )

    def inherit(self, before: Verbs) -> None:
        """Keep what was set and happened before another tool was mounted."""
        self.states, self.refusals = before.states, before.refusals
        self.strict_limits = before.strict_limits
        self.setpoints.velocity_ratio = before.setpoints.velocity_ratio
        self.setpoints.acceleration_ratio = before.setpoints.acceleration_ratio

    # ------------------------------------------------------------------ readings

    def positions(self) -> Array:
        """Return measured positions of every joint, the jaw included, (n,) [rad or m]."""
        return self.setpoints.position.copy() if self._drives.welded else self._drives.positions()

    def readings(self) -> tuple[Array, Array, Array]:
        """Return (positions, velocities, efforts) of every joint, the jaw included, (n,) each."""
        if self._drives.welded:
            still = np.zeros(len(self._names))
            return self.setpoints.position.copy(), still, still.copy()
        return self._drives.positions(), self._drives.velocities(), self._drives.efforts()

    def state(self, part: slice, setpoint: bool) -> JointState:
        """Return measured values or set-points of some joints."""
        s = self.setpoints
        values = (s.position, s.velocity, s.effort) if setpoint else self.readings()
        q, v, effort = (value[part].copy() for value in values)
        return JointState(self._names[part], q, v, effort, self._clock.time)

    # ------------------------------------------------------------------ commands

    def servo(self, q: ArrayLike, v: ArrayLike | None, part: slice, verb: str) -> bool:
        """Set positions (and velocities) of some joints now; tell whether it was accepted."""
        names = self._names[part]
        target = self.refusals.vector(q, names, verb, "positions")
        speed = self.refusals.vector(
            np.zeros(len(names)) if v is None else v, names, verb, "velocities"
        )
        if target is None or speed is None or self._stuck(part, verb):
            return False
        allowed = self._allowed(target, part, verb)
        if allowed is None:
            return False
        inside, moves = allowed
        self.under_position(part)
        self.setpoints.servo(part, inside, np.where(moves, speed, 0.0))
        self.write()
        return True

    def servo_relative(self, dq: ArrayLike, part: slice, verb: str) -> bool:
        """Add to the set-points of some joints; tell whether it was accepted."""
        change = self.refusals.vector(dq, self._names[part], verb, "positions")
        return change is not None and self.servo(self.told(part) + change, None, part, verb)

    def servo_effort(self, effort: ArrayLike, part: slice, verb: str) -> bool:
        """Set efforts; tell whether it was accepted.

        Joints that are in mode "effort" take theirs; where none is, all of them are put there
        until the next position command.
        """
        wanted = self.refusals.vector(effort, self._names[part], verb, "efforts")
        if wanted is None or not self.ready(verb):
            return False
        if self._drives.welded or self._drives.locked[part].all():
            return not self._stuck(part, verb)
        self.under_effort(part)
        self.exert(wanted, part, verb)
        return True

    def exert(self, effort: Array, part: slice, verb: str) -> None:
        """Hand efforts to the motors, within their limits; joints under position ignore theirs."""
        open_loop = np.array([m == "effort" for m in self._drives.modes[part]])
        wanted = np.where(open_loop, effort, 0.0)
        limit = self._drives.effort_limit[part]
        if (np.abs(wanted) > limit).any():
            self.refusals.warn(f"{verb} limit", f"{verb}: effort clipped to the limits")
        self.setpoints.effort[part] = np.clip(wanted, -limit, limit)
        self._drives.command_effort(self.setpoints.effort)

    def move(self, q: ArrayLike, part: slice, verb: str) -> Motion:
        """Move some joints together to a goal within velocity and acceleration limits."""
        return self.move_parts(q, [part], verb)

    def move_relative(self, dq: ArrayLike, part: slice, verb: str) -> Motion:
        """Move on from the goal that some joints have, or from their set-points."""
        change = self.refusals.vector(dq, self._names[part], verb, "positions")
        if change is None:
            return self.refused(part)
        goal = self.told(part) if self._lent else self.setpoints.goal(part)
        return self.move(goal + change, part, verb)

    def move_parts(self, q: ArrayLike, parts: Sequence[slice], verb: str) -> Motion:
        """Move adjoining parts to a goal; each arrives in its own time."""
        whole = slice(parts[0].start, parts[-1].stop)
        target = self.refusals.vector(q, self._names[whole], verb, "positions")
        if target is None or self._stuck(whole, verb):
            return self.refused(whole)
        allowed = self._allowed(target, whole, verb)
        if allowed is None:
            return self.refused(whole)
        self.under_position(whole)
        return self.setpoints.move(allowed[0], parts, self._clock.time)

    def refused(self, part: slice) -> Motion:
        """Return a motion that is over and reached nothing."""
        motion = Motion(self.setpoints.position[part].copy(), self._clock.wait)
        motion.finish(False)
        return motion

    def hold_end(self, q: float, effort: float) -> None:
        """Hold a gripper's levers at an opening, with an effort that is fed forward."""
        self.setpoints.position[-1], self.setpoints.effort[-1] = q, effort
        self._drives.finger("position", q, effort)

    def push_end(self, effort: float) -> None:
        """Exert an effort on a gripper's levers, and nothing else."""
        self.setpoints.effort[-1] = effort
        self._drives.finger("effort", float(self.setpoints.position[-1]), effort)

    def write(self) -> None:
        """Hand the set-points to the motors."""
        self._drives.command(self.setpoints.position, self.setpoints.velocity)

    def stay(self, which: Sequence[int]) -> None:
        """End every move; the given joints' set-points are where they are measured."""
        here = np.clip(self.positions(), self._lower, self._upper)
        self.setpoints.end(slice(0, len(self._names)))
        self.setpoints.position[which] = here[which]
        self.setpoints.velocity[:] = 0.0

    # ------------------------------------------------------------------ effort and back

    def under_effort(self, part: slice) -> None:
        """Put joints into mode "effort", unless some were put there on purpose."""
        modes = self._drives.modes
        inside = range(part.start, part.stop)
        if self._taken:
            self.lend(sorted(self._taken), part)
        if any(modes[i] == "effort" for i in inside):
            return
        which = [i for i in inside if modes[i] == "position" and not self._drives.locked[i]]
        self.lend(which, part)

    def under_position(self, part: slice) -> None:
        """Take joints back that `under_effort` had put into mode "effort", where they are."""
        which = sorted(self._lent & set(range(part.start, part.stop)))
        if which:
            self.take(which, part)
        self._taken.clear()

    def keep_modes(self) -> None:
        """Forget which joints were lent: their modes are now the caller's choice."""
        self._lent.clear()
        self._taken.clear()

    def told(self, part: slice) -> Array:
        """Return the set-points; of joints under effort control where they are, (n,)."""
        told = self.setpoints.position.copy()
        if self._lent:
            lent = sorted(self._lent)
            told[lent] = self.positions()[lent]
        return told[part]

    def take(self, which: Sequence[int], part: slice) -> None:
        """Put some joints of a part under position control, from where they are."""
        self._rest_here(which, part)
        self._drives.set_mode("position", which, self.setpoints.position)
        self._taken |= self._lent & set(which)
        self._lent -= set(which)

    def lend(self, which: Sequence[int], part: slice) -> None:
        """Put some joints of a part under effort control until the next position command."""
        self._rest_here(which, part)
        self._drives.set_mode("effort", which, self.setpoints.position)
        self._lent |= set(which)
        self._taken -= set(which)

    def steer(self, q: Array, v: Array | None, part: slice) -> None:
        """Set the set-points of joints under position control inside their limits; NaN: leave."""
        inside = np.clip(q, self._lower[part], self._upper[part])
        told, wanted = self.setpoints, np.isfinite(q)
        told.position[part] = np.where(wanted, inside, told.position[part])
        if v is not None:
            told.velocity[part] = np.where(wanted, v, told.velocity[part])
        self.write()

    # ------------------------------------------------------------------ inside

    def _rest_here(self, which: Sequence[int], part: slice) -> None:
        """End the moves of a part; some joints' set-points are where they are, without effort."""
        here = np.clip(self.positions(), self._lower, self._upper)
        self.setpoints.end(part)
        self.setpoints.position[which] = here[which]
        self.setpoints.velocity[which] = 0.0
        self.setpoints.effort[which] = 0.0

    def ready(self, verb: str) -> bool:
        """Tell whether the operating state lets the arm move, with a warning when not."""
        why = self.states.why_not_ready()
        if why:
            self.refusals.warn(f"{verb} {why}", f"{verb}: {why}")
        return not why

    def tell(self, event: str, **values: object) -> None:
        """Tell the journal that something happened to this arm."""
        self._clock.journal.event(self._name, event, **values)

    def _over(self, motion: Motion) -> None:
        self.tell("goal_reached", reached=motion.goal_reached)

    def _stuck(self, part: slice, verb: str) -> bool:
        """Warn and return True when no joint could follow."""
        if not self.ready(verb):
            return True
        chosen = [
            mode
            for i, mode in enumerate(self._drives.modes[part], part.start)
            if i not in self._lent
        ]
        if self._drives.welded:
            why = "the setup joints are welded into the model"
        elif self._drives.locked[part].all():
            why = "the brakes are locked; release them first"
        elif chosen and all(mode == "effort" for mode in chosen):
            why = 'every joint is in mode "effort"; nothing moves'
        else:
            return False
        self.refusals.warn(f"{verb} stuck", f"{verb}: {why}")
        return True

    def _allowed(
        self, target: Array, part: slice, verb: str
    ) -> tuple[Array, NDArray[np.bool_]] | None:
        """Return the target inside the limits, locked joints left alone, and which may move.

        None when it is beyond and limits are strict.
        """
        names = self._names[part]
        inside = np.clip(target, self._lower[part], self._upper[part])
        if (inside != target).any():
            beyond = ", ".join(n for n, c in zip(names, inside != target, strict=True) if c)
            if self.strict_limits:
                self.refusals.warn(
                    f"{verb} {beyond} strict", f"{verb}: {beyond} beyond the limit; nothing moves"
                )
                return None
            self.refusals.warn(f"{verb} {beyond} clipped", f"{verb}: {beyond} clipped to the limit")
        locked, told = self._drives.locked[part], self.setpoints.position[part]
        asked = locked & (np.abs(inside - told) > BRAKE_SLACK)
        if asked.any():
            held = ", ".join(n for n, c in zip(names, asked, strict=True) if c)
            self.refusals.warn(f"{verb} {held} held", f"{verb}: {held} stays: its brake is locked")
        return np.where(locked, told, inside), ~locked
