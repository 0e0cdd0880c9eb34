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


class Verbs:
    """Commands and readings of an arm's joints, for the arm without its jaw and for the jaw.

    Attributes:
        setpoints: what the servos are told
        refusals: what was wrong with commands
    """

    def __init__(self, name: str, arm: ArmDescription, drives: Drives, clock: Clock) -> None:
        self._names = arm.mechanism.joint_names
        self._lower, self._upper = arm.mechanism.lower, arm.mechanism.upper
        self._drives, self._clock = drives, clock
        self.refusals = Refusals(name, lambda: clock.time, clock.journal)
        self.setpoints = SetPoints(
            np.array([j.velocity_max for j in arm.joints]),
            np.array([j.acceleration_max for j in arm.joints]),
            clock.wait,
        )

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

    def servo(self, q: ArrayLike, v: ArrayLike | None, part: slice, verb: str) -> bool:
        """Set positions (and velocities) of some joints now; tell whether it was accepted."""
        names = self._names[part]
        target = self.refusals.vector(q, names, verb, "positions")
        speed = self.refusals.vector(
            np.zeros(len(names)) if v is None else v, names, verb, "velocities"
        )
        if target is None or speed is None or self._stuck(part, verb):
            return False
        inside, moves = self._allowed(target, part, verb)
        self.setpoints.servo(part, inside, np.where(moves, speed, 0.0))
        self.write()
        return True

    def servo_effort(self, effort: ArrayLike, part: slice, verb: str) -> bool:
        """Set efforts of the joints in mode "effort"; tell whether it was accepted."""
        wanted = self.refusals.vector(effort, self._names[part], verb, "efforts")
        if wanted is None:
            return False
        open_loop = np.array([m == "effort" for m in self._drives.modes[part]])
        if not open_loop.any():
            self.refusals.warn(
                f"{verb} mode", f'{verb}: no joint is in mode "effort"; nothing is applied'
            )
            return False
        wanted = np.where(open_loop, wanted, 0.0)
        limit = self._drives.effort_limit[part]
        if (np.abs(wanted) > limit).any():
            self.refusals.warn(f"{verb} limit", f"{verb}: effort clipped to the limits")
        self.setpoints.effort[part] = np.clip(wanted, -limit, limit)
        self._drives.command_effort(self.setpoints.effort)
        return True

    def move(self, q: ArrayLike, part: slice, verb: str) -> Motion:
        """Move some joints together to a goal within velocity and acceleration limits."""
        return self.move_parts(q, [part], verb)

    def move_parts(self, q: ArrayLike, parts: Sequence[slice], verb: str) -> Motion:
        """Move adjoining parts to a goal; each arrives in its own time."""
        whole = slice(parts[0].start, parts[-1].stop)
        target = self.refusals.vector(q, self._names[whole], verb, "positions")
        if target is None or self._stuck(whole, verb):
            refused = Motion(self.setpoints.position[whole].copy(), self._clock.wait)
            refused.finish(False)
            return refused
        goal, _ = self._allowed(target, whole, verb)
        return self.setpoints.move(goal, parts, self._clock.time)

    def write(self) -> None:
        """Hand the set-points to the motors."""
        self._drives.command(self.setpoints.position, self.setpoints.velocity)

    def stay(self, which: Sequence[int]) -> None:
        """End every move; the given joints' set-points are where they are measured."""
        here = np.clip(self.readings()[0], self._lower, self._upper)
        self.setpoints.end(slice(0, len(self._names)))
        self.setpoints.position[which] = here[which]
        self.setpoints.velocity[:] = 0.0

    def _stuck(self, part: slice, verb: str) -> bool:
        """Warn and return True when no joint could follow."""
        if self._drives.welded:
            why = "the setup joints are welded into the model"
        elif self._drives.locked[part].all():
            why = "the brakes are locked; release them first"
        elif all(mode == "effort" for mode in self._drives.modes[part]):
            why = 'every joint is in mode "effort"; nothing moves'
        else:
            return False
        self.refusals.warn(f"{verb} stuck", f"{verb}: {why}")
        return True

    def _allowed(self, target: Array, part: slice, verb: str) -> tuple[Array, NDArray[np.bool_]]:
        """Return the target inside the limits, locked joints left alone, and which may move."""
        names = self._names[part]
        inside = np.clip(target, self._lower[part], self._upper[part])
        if (inside != target).any():
            beyond = ", ".join(n for n, c in zip(names, inside != target, strict=True) if c)
            self.refusals.warn(f"{verb} {beyond} clipped", f"{verb}: {beyond} clipped to the limit")
        locked, told = self._drives.locked[part], self.setpoints.position[part]
        asked = locked & (np.abs(inside - told) > BRAKE_SLACK)
        if asked.any():
            held = ", ".join(n for n, c in zip(names, asked, strict=True) if c)
            self.refusals.warn(f"{verb} {held} held", f"{verb}: {held} stays: its brake is locked")
        return np.where(locked, told, inside), ~locked
