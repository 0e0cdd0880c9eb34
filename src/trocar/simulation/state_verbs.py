"""Power, homing and faults of an arm: the verbs of its operating state."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.controllers import Law
from trocar.simulation.homing import Homing
from trocar.simulation.journal import command
from trocar.simulation.motion import Motion
from trocar.simulation.readings import Readings

Array = NDArray[np.float64]
log = logging.getLogger("trocar")

STATE_COMMANDS = ("enable", "disable", "home", "unhome", "pause", "resume")


class StateVerbs(Readings):
    """The part of an arm that switches it on, off and home."""

    poses: dict[str, Array]
    _laws: dict[str, Law]

    def _end_laws(self) -> None:
        """End periodic laws; `Arm` does."""
        raise NotImplementedError

    @command
    def state_command(self, name: str) -> bool:
        """Obey "enable", "disable", "home", "unhome", "pause" or "resume".

        As on the hardware, "home" lets an arm that is on and home already stay where it is.

        Returns:
            whether it was accepted
        """
        if name not in STATE_COMMANDS:
            self._verbs.refusals.warn(
                "state_command",
                f"state_command: got {name!r}; allowed: {', '.join(STATE_COMMANDS)}",
            )
            return False
        if name == "home":
            motion = self.home(anew=False)
            return not motion.done or motion.goal_reached
        return bool(getattr(self, name)())

    @command
    def enable(self) -> bool:
        """Give the motors power, from DISABLED or FAULT; the arm holds where it is."""
        if not self._states.powered:
            self._states.state = "ENABLED"
            self._settle()
            self._drives.switch(True)
            self._verbs.write()
            self.tell_state()
        return True

    @command
    def disable(self) -> bool:
        """End everything and take the motors' power; the arm is held where it is."""
        self._switch_off()
        self._states.state = "DISABLED"
        self.tell_state()
        return True

    @command
    def pause(self) -> bool:
        """End moves and hold; no command moves the arm until `resume`."""
        if not self._may("pause"):
            return False
        self._stop()
        self._states.state = "PAUSED"
        self.tell_state()
        return True

    @command
    def resume(self) -> bool:
        """Take commands again after `pause`."""
        if not self._may("resume"):
            return False
        self._states.state = "ENABLED"
        self.tell_state()
        return True

    @command
    def home(self, anew: bool = True) -> Motion:
        """Bring the arm to its home pose, with power if it has none; the jaw stays.

        The motion is over when the joints are measured there; if they are not within two seconds,
        the arm is in FAULT.

        Args:
            anew: whether an arm that is on and home already goes there once more. On the hardware
                it stays as it is, moving or not. Source: SAW, mtsIntuitiveResearchKitArm: the
                state that is desired, HOMED, is the current one
        """
        own = self._verbs.setpoints.position[self._own]
        if not self._may("home"):
            return self._verbs.refused(self._own)
        if self._states.homed and self._states.powered and not anew:
            self.tell_state()
            return self._arrived(own)
        self._states.homed = False
        self.enable()
        self._stop()
        goal = self.poses["home"][self._own] if "home" in self.poses else own
        motion = Motion(goal.copy(), self._clock.wait)
        moves = "home" in self.poses and not self._drives.welded and not self._drives.brakes
        way = (
            self._verbs.setpoints.move(goal, [self._own], self._clock.time)
            if moves
            else self._arrived(own)
        )
        kinds = [j.kind == "prismatic" for j in self.description.joints[self._own]]
        self._homing = Homing(motion, way, np.array(kinds))
        self.tell_state()
        return motion

    @command
    def unhome(self) -> bool:
        """Forget that the arm was homed; it holds where it is."""
        if self._states.state == "ENABLED":
            self._stop()
        self._states.homed = False
        self.tell_state()
        return True

    def fault(self, reason: str) -> None:
        """Take the motors' power because something went wrong (the world calls this)."""
        self._switch_off()
        self._states.state = "FAULT"
        log.error("%s: FAULT: %s", self.name, reason)
        self._verbs.refusals.last = f"FAULT: {reason}"
        self._verbs.tell("error", text=reason)
        self.tell_state()

    # ------------------------------------------------------------------ inside

    def _may(self, verb: str) -> bool:
        why = self._states.why_not(verb)
        if why:
            self._verbs.refusals.warn(f"{verb} state", f"{verb}: {why}")
        return not why

    def _arrived(self, q: Array) -> Motion:
        motion = Motion(q.copy(), self._clock.wait)
        motion.finish(True)
        return motion

    def _stop(self) -> None:
        """End everything under way; stay at the set-points, or where joints were free."""
        self._abandon_homing()
        self._end_laws()
        every = slice(0, len(self.joint_names))
        self._verbs.under_position(every)
        self._verbs.setpoints.end(every)
        self._verbs.setpoints.velocity[:] = 0.0
        self._verbs.write()
        self._verbs.exert(np.zeros(len(self.joint_names)), every, "hold")
        self.tell_state()

    def _settle(self) -> None:
        """Put the set-points where the joints are measured."""
        if not self._drives.welded:
            self._verbs.stay(list(range(len(self.joint_names))))
            self._verbs.setpoints.effort[:] = 0.0

    def _switch_off(self) -> None:
        if not self._states.powered:
            return
        self._abandon_homing()
        self._end_laws()
        self._verbs.under_position(slice(0, len(self.joint_names)))
        self._settle()
        self._drives.switch(False)
        self._verbs.write()

    def _abandon_homing(self) -> None:
        homing, self._homing = self._homing, None
        if homing is not None:
            homing.motion.finish(False)
            self._verbs.tell("goal_reached", reached=False)

    def _watch(self, homing: Homing) -> None:
        measured = self.positions()[self._own]
        outcome = homing.look(measured, self._clock.time)
        if outcome == "home":
            self._homing = None
            self._states.homed = True
            homing.motion.finish(True)
        elif outcome == "stopped":
            self._abandon_homing()
        elif outcome == "late":
            names = np.array(self.joint_names[self._own])[homing.far(measured)]
            self.fault(f"homing: {', '.join(names)} did not arrive")
