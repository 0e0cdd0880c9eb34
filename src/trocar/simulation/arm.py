"""An arm in time: the dVRK's states and verbs."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import RigArm
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.se3 import transform
from trocar.kinematics.forward import pose
from trocar.simulation.controllers import (
    CartesianForce,
    CartesianImpedance,
    Law,
    WrenchFrame,
)
from trocar.simulation.drives import Drives
from trocar.simulation.homing import Homing
from trocar.simulation.jaw import Jaw
from trocar.simulation.journal import command
from trocar.simulation.motion import Motion
from trocar.simulation.readings import FRAMES, Readings
from trocar.simulation.settings import Settings
from trocar.simulation.states import OperatingState
from trocar.simulation.verbs import Clock, Verbs

Array = NDArray[np.float64]
log = logging.getLogger("trocar")

#: Cartesian commands need the first wrist joint this far past the remote centre. Source:
#: mtsIntuitiveResearchKit.h, SafeDistanceFromRCM. [m]
SAFE_DEPTH_M = 0.045
STATE_COMMANDS = ("enable", "disable", "home", "unhome", "pause", "resume")


class Arm(Readings, Settings):
    """One arm of a rig. Commands that cannot be used are refused with a warning; nothing moves.

    Attributes:
        name: "PSM1", ...
        type: PSM, ECM, SUJ or MTM
        joint_names: every joint, the jaw last where there is one
        lower, upper: limits, (n,) [rad or m]
        poses: {name: q (n,)}
        jaw: the jaw's own verbs, None without one
        journal: where its commands and events are told
    """

    def __init__(self, rig_arm: RigArm, drives: Drives, clock: Clock) -> None:
        self.name = rig_arm.name
        self.description = rig_arm.arm
        self.type = rig_arm.arm.type
        self.joint_names = rig_arm.arm.mechanism.joint_names
        self.lower, self.upper = rig_arm.arm.mechanism.lower, rig_arm.arm.mechanism.upper
        self.poses = dict(rig_arm.arm.poses)
        self.journal = self._journal = clock.journal
        self._source, self._prefix = rig_arm.name, ""
        self._drives = drives
        self._clock = clock
        self._base: tuple[Array, str] | None = None
        self._verbs = Verbs(self.name, self.description, drives, clock)
        self._states = self._verbs.states
        self._homing: Homing | None = None
        #: Periodic laws by name; the efforts that were commanded, which theirs are added to.
        self._laws: dict[str, Law] = {}
        self._push = np.zeros(len(self.joint_names) - rig_arm.arm.has_jaw)
        self._absolute = False
        self._told: OperatingState | None = None
        jaw = rig_arm.arm.has_jaw
        count, last = len(self.joint_names) - jaw, len(self.joint_names) - 1
        self._own = slice(0, count)
        self._parts = [self._own, slice(last, last + 1)] if jaw else [self._own]
        self.jaw = Jaw(self, self._verbs, last) if jaw else None

    # ------------------------------------------------------------------ states

    def operating_state(self) -> OperatingState:
        """Return the state as CRTK has it."""
        busy = self.busy or self._homing is not None
        return OperatingState(self._states.state, self._states.homed, busy, self._clock.time)

    @command
    def state_command(self, name: str) -> bool:
        """Obey "enable", "disable", "home", "unhome", "pause" or "resume".

        Returns:
            whether it was accepted
        """
        if name not in STATE_COMMANDS:
            self._verbs.refusals.warn(
                "state_command",
                f"state_command: got {name!r}; allowed: {', '.join(STATE_COMMANDS)}",
            )
            return False
        answer = getattr(self, name)()
        return not answer.done or answer.goal_reached if name == "home" else bool(answer)

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
    def home(self) -> Motion:
        """Bring the arm to its home pose, with power if it has none; the jaw stays.

        The motion is over when the joints are measured there; if they are not within two seconds,
        the arm is in FAULT.
        """
        own = self._verbs.setpoints.position[self._own]
        if not self._may("home"):
            return self._verbs.refused(self._own)
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

    # ------------------------------------------------------------------ joints

    @command
    def servo_jp(self, q: ArrayLike, v: ArrayLike | None = None) -> bool:
        """Set the servos' positions now, the jaw not included.

        Args:
            q: (n,) [rad or m]; beyond a limit it is clipped with a warning
            v: (n,) [rad/s or m/s], zero when omitted

        Returns:
            whether the command was accepted
        """
        return self._ended(self._verbs.servo(q, v, self._own, "servo_jp"))

    @command
    def servo_jr(self, dq: ArrayLike) -> bool:
        """Add to the set-points now, (n,) [rad or m]; tell whether it was accepted."""
        return self._ended(self._verbs.servo_relative(dq, self._own, "servo_jr"))

    @command
    def servo_jf(self, effort: ArrayLike) -> bool:
        """Set the joints' efforts; they persist until the next command.

        Args:
            effort: (n,) [N m or N], the jaw not included. Joints in mode "effort" take theirs;
                where none is, all joints are under effort control until the next position command

        Returns:
            whether the command was accepted
        """
        return self._pushed(self._verbs.servo_effort(effort, self._own, "servo_jf"))

    @command
    def move_jp(self, q: ArrayLike) -> Motion:
        """Move the set-points to a goal within velocity and acceleration limits.

        Args:
            q: (n,) [rad or m], the jaw not included; beyond a limit it is clipped with a warning
        """
        return self._begun(self._verbs.move(q, self._own, "move_jp"))

    @command
    def move_jr(self, dq: ArrayLike) -> Motion:
        """Move on by (n,) [rad or m] from the goal of the move under way, or the set-points."""
        return self._begun(self._verbs.move_relative(dq, self._own, "move_jr"))

    @command
    def move_to(self, name: str) -> Motion:
        """Move every joint, the jaw too, to a named pose.

        Raises:
            UnknownNameError: no such pose; the known ones are listed
        """
        if name not in self.poses:
            raise UnknownNameError("pose", name, self.poses, self.name)
        return self._begun(self._verbs.move_parts(self.poses[name], self._parts, "move_to"))

    @command
    def hold(self) -> None:
        """End every move and law, and stay at the set-points."""
        if self._verbs.ready("hold"):
            self._stop()

    @command
    def free(self) -> bool:
        """Exert nothing but gravity compensation, until the next command; the jaw holds."""
        zero = np.zeros(len(self._push))
        return self._pushed(self._verbs.servo_effort(zero, self._own, "free"))

    # ------------------------------------------------------------------ tip

    @command
    def servo_cp(self, T: ArrayLike) -> bool:
        """Bring the tip to a pose (4, 4) in the frame of `measured_cp` now."""
        q = self._solved(T, "servo_cp")
        return q is not None and self._ended(self._verbs.servo(q, None, self._own, "servo_cp"))

    @command
    def servo_cr(self, T: ArrayLike) -> bool:
        """Move the tip from its set-point by a translation and a rotation, (4, 4), now.

        Both in axes of the frame of `measured_cp`: p + dp, dR @ R.
        """
        change = np.asarray(T, dtype=np.float64)
        told = self.setpoint_cp().T
        if change.shape == (4, 4):
            told = transform(change[:3, :3] @ told[:3, :3], told[:3, 3] + change[:3, 3])
        else:
            told = change
        q = self._solved(told, "servo_cr")
        return q is not None and self._ended(self._verbs.servo(q, None, self._own, "servo_cr"))

    @command
    def move_cp(self, T: ArrayLike) -> Motion:
        """Move to a pose (4, 4) in the frame of `measured_cp`: solved once, then joint by joint."""
        q = self._solved(T, "move_cp")
        if q is None:
            return self._verbs.refused(self._own)
        return self._begun(self._verbs.move(q, self._own, "move_cp"))

    @command
    def servo_cf(self, wrench: ArrayLike, frame: WrenchFrame = "body") -> bool:
        """Exert a wrench (force; torque), (6,) [N, N m], that persists until the next command.

        Args:
            wrench: what the arm exerts on its surroundings
            frame: "body": at the tip in its axes; "spatial": about the reference frame's origin
        """
        names = ("fx", "fy", "fz", "tx", "ty", "tz")
        wanted = self._verbs.refusals.vector(wrench, names, "servo_cf", "forces")
        if wanted is None:
            return False
        if frame not in FRAMES:
            self._verbs.refusals.warn(
                "servo_cf frame", f"servo_cf: got frame {frame!r}; allowed: {', '.join(FRAMES)}"
            )
            return False
        return self._follow_law(CartesianForce(wanted, frame, self._absolute), "servo_cf")

    @command
    def set_cf_orientation_absolute(self, on: bool) -> None:
        """Take the wrenches of `servo_cf` in the axes of `measured_cp`'s frame, at the tip."""
        self._absolute = bool(on)

    @command
    def servo_ci(self, impedance: CartesianImpedance) -> bool:
        """Be a spring and damper about a pose, until the next command."""
        return self._follow_law(impedance, "servo_ci")

    # ------------------------------------------------------------------ used by the world

    @property
    def active(self) -> bool:
        """Whether set-points or efforts change from period to period."""
        return self.busy or self._homing is not None or bool(self._laws)

    def follow(self, time: float) -> None:
        """Advance the set-points of moves to a time, and renew the efforts of laws."""
        self._verbs.setpoints.follow(time)
        self._verbs.write()
        if self._laws:
            self._obey()
        if self._homing is not None:
            self._watch(self._homing)
        self.tell_state()

    def start_at(self, q: Array) -> None:
        """Forget every command and start at joint positions, (n,)."""
        self._laws.clear()
        self._verbs.refusals.forget()
        self._verbs.setpoints.put(q)
        self._drives.place(q, np.zeros(len(q)))
        self._drives.apply()

    def begin(self, q: Array, ready: bool) -> None:
        """Start anew at joint positions, (n,): enabled and homed, or as after power-on."""
        self._abandon_homing()
        self._verbs.keep_modes()
        self._drives.restore()
        self._states.begin(ready)
        self.start_at(q)
        if not ready:
            self._drives.switch(False)
        self._told = None

    def come_to_rest(self) -> None:
        """Hold, when the set-points are on their way."""
        if self.active or self._verbs.setpoints.velocity.any():
            self._stop()

    def prepare_to_play(self) -> None:
        """Take joints back from effort control, for a table of set-points.

        Raises:
            InputError: the arm takes no commands now
        """
        why = self._states.why_not_ready()
        if why:
            raise InputError(f"play: {self.name}: {why}")
        self._end_laws()
        self._verbs.under_position(slice(0, len(self.joint_names)))

    def take_over(self, q: Array, v: Array, effort: Array) -> None:
        """Take over set-points that a played trajectory has written, (n,) each."""
        if self._states.powered:
            self._verbs.setpoints.put(q)
            self._verbs.setpoints.velocity = v.copy()
            self._verbs.setpoints.effort = effort.copy()

    def tell_state(self) -> None:
        """Tell the journal of the operating state, when it changed."""
        now = self.operating_state()
        if self._told is None or (now.state, now.is_homed, now.is_busy) != (
            self._told.state,
            self._told.is_homed,
            self._told.is_busy,
        ):
            self._told = now
            self._verbs.tell(
                "operating_state", state=now.state, is_homed=now.is_homed, is_busy=now.is_busy
            )

    # ------------------------------------------------------------------ inside

    def _may(self, verb: str) -> bool:
        why = self._states.why_not(verb)
        if why:
            self._verbs.refusals.warn(f"{verb} state", f"{verb}: {why}")
        return not why

    def _ended(self, accepted: bool) -> bool:
        """End laws after a position command that was accepted."""
        if accepted:
            self._end_laws()
            self.tell_state()
        return accepted

    def _pushed(self, accepted: bool) -> bool:
        """End the law of the tip after an effort command that was accepted."""
        if accepted:
            self._laws.pop("wrench", None)
            self._push = self._verbs.setpoints.effort[self._own].copy()
            self.tell_state()
        return accepted

    def _begun(self, motion: Motion) -> Motion:
        self._ended(not motion.done)
        return motion

    def _end_laws(self) -> None:
        self._laws.clear()

    def _arrived(self, q: Array) -> Motion:
        motion = Motion(q.copy(), self._clock.wait)
        motion.finish(True)
        return motion

    def _stop(self) -> None:
        """End everything under way; stay at the set-points, or where joints were free."""
        self._abandon_homing()
        self._laws.clear()
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
        self._laws.clear()
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
        measured = self.readings()[0][self._own]
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

    def _solved(self, T: ArrayLike, verb: str) -> Array | None:
        """Return the joints of a pose, when Cartesian commands are allowed now."""
        if not self._verbs.ready(verb) or not self._deep_enough(verb):
            return None
        return self._nearest(T, verb)

    def _deep_enough(self, verb: str) -> bool:
        """Warn and return False while an instrument's wrist is too near its remote centre."""
        mechanism = self.description.mechanism
        if self.type != "PSM" or "wrist_pitch" not in mechanism.frame_index:
            return True
        q = self.readings()[0]
        wrist = pose(mechanism, q, "wrist_pitch")[:3, 3]
        depth = float(pose(mechanism, q, "roll")[:3, 2] @ wrist)
        if depth >= SAFE_DEPTH_M:
            return True
        self._verbs.refusals.warn(
            f"{verb} depth",
            f"{verb}: the wrist is {1e3 * depth:.1f} mm past the remote centre; allowed from "
            f"{1e3 * SAFE_DEPTH_M:.0f} mm on; insert the instrument first",
        )
        return False

    def _follow_law(self, law: Law, verb: str) -> bool:
        if not self._verbs.ready(verb) or not self._deep_enough(verb):
            return False
        if not self._pushed(self._verbs.servo_effort(0.0 * self._push, self._own, verb)):
            return False
        self._laws["wrench"] = law
        self._obey()
        self.tell_state()
        return True

    def _obey(self) -> None:
        """Add up the efforts of all laws and hand them to the motors."""
        now = self._tip_state()
        effort = self._push.copy()
        for law in self._laws.values():
            action = law.act(now)
            effort += action.effort
            if action.position is not None:
                self._verbs.steer(action.position, self._own)
        self._verbs.exert(effort, self._own, "efforts")
