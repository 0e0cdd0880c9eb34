"""An arm in time: the dVRK's states and verbs."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import RigArm
from trocar.errors import InputError, UnknownNameError
from trocar.simulation.controllers import Law
from trocar.simulation.drives import Drives
from trocar.simulation.gripper import Gripper
from trocar.simulation.homing import Homing
from trocar.simulation.jaw import Jaw, NoJaw
from trocar.simulation.journal import command
from trocar.simulation.locking import Locking
from trocar.simulation.motion import Motion
from trocar.simulation.records import ArmSample
from trocar.simulation.settings import Settings
from trocar.simulation.state_verbs import StateVerbs
from trocar.simulation.states import OperatingState
from trocar.simulation.tip_verbs import TipVerbs
from trocar.simulation.verbs import Clock, Verbs

Array = NDArray[np.float64]


class Arm(StateVerbs, Locking, TipVerbs, Settings):
    """One arm of a rig. Commands that cannot be used are refused with a warning; nothing moves.

    Attributes:
        name: "PSM1", ...
        type: PSM, ECM, SUJ or MTM
        joint_names: every joint, the jaw last where there is one
        lower, upper: limits, (n,) [rad or m]
        poses: {name: q (n,)}
        jaw: the jaw's own verbs, None without one
        gripper: a master's gripper, None without one
        journal: where its commands and events are told
    """

    def __init__(self, rig_arm: RigArm, drives: Drives, clock: Clock) -> None:
        self.name, self.type = rig_arm.name, rig_arm.arm.type
        self.journal = self._journal = clock.journal
        self._source, self._prefix = rig_arm.name, ""
        self._clock = clock
        self._base: tuple[Array, str] | None = None
        self._homing: Homing | None = None
        #: Periodic laws by name; the efforts that were commanded, which theirs are added to.
        self._laws: dict[str, Law] = {}
        self._lock: Array | None = None
        self._absolute = False
        self._told: OperatingState | None = None
        #: The one jaw that is ever handed out; `jaw` is None while a tool has none.
        self._jaw: Jaw | None = None
        self._fit(rig_arm, drives)

    def _fit(self, rig_arm: RigArm, drives: Drives) -> None:
        """Take what the mounted tool determines."""
        self.description = rig_arm.arm
        self.joint_names = rig_arm.arm.mechanism.joint_names
        self.lower, self.upper = rig_arm.arm.mechanism.lower, rig_arm.arm.mechanism.upper
        self.poses = dict(rig_arm.arm.poses)
        self._drives = drives
        self._verbs = Verbs(self.name, self.description, drives, self._clock)
        self._states = self._verbs.states
        self._push = np.zeros(rig_arm.arm.own_joints)
        jaw, last = rig_arm.arm.has_jaw, len(self.joint_names) - 1
        self._own = slice(0, rig_arm.arm.own_joints)
        self._parts = [self._own, slice(last, last + 1)] if jaw else [self._own]
        if jaw and self._jaw is None:
            self._jaw = Jaw(self, self._verbs, last)
        elif self._jaw is not None:
            self._jaw.fit(self._verbs if jaw else NoJaw(self.name), last)
        self.jaw = self._jaw if jaw else None
        grips = rig_arm.arm.has_gripper
        told = (self.journal, self.name, lambda: self._clock.time)
        self.gripper = Gripper(self._verbs, rig_arm.arm.joints[last], last, told) if grips else None

    @command
    def set_tool_type(self, name: str) -> None:
        """Mount another tool; the world's `exchange_tool` says what becomes of the arm.

        Raises:
            UnknownNameError, InputError, DescriptionError: as `exchange_tool` does
        """
        self._clock.exchange_tool(self.name, name)

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
        goal = self.poses[name][: self._parts[-1].stop]
        return self._begun(self._verbs.move_parts(goal, self._parts, "move_to"))

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

    # ------------------------------------------------------------------ looking

    def sample(self, read: tuple[Array, Array, Array, Array] | None = None) -> ArmSample:
        """Return copies of what every reading of this arm is computed from.

        Args:
            read: positions, velocities, efforts and loads (n,) each, where somebody has read them
        """
        told, welded = self._verbs.setpoints, self._drives.welded
        return ArmSample(
            *(read or (*self.readings(), self._drives.load())),
            told.position.copy(),
            told.velocity.copy(),
            told.effort.copy(),
            not welded and self._drives.gravity_compensated,
            self._states.state,
            self._states.homed,
            self.busy or self._homing is not None,
            self._base,
            self.description.tool,
            (told.velocity_ratio, told.acceleration_ratio),
            self.gripper is not None and self.gripper.closed,
            self._lock is not None,
            bool(self._drives.brakes) and bool(self._drives.locked.all()),
        )

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
        self._end_laws()
        self._verbs.refusals.forget()
        self._verbs.setpoints.put(q)
        self._drives.place(q, np.zeros(len(q)))
        self._drives.apply()

    def begin(self, q: Array, ready: bool) -> None:
        """Start anew at joint positions, (n,): enabled and homed, or as after power-on."""
        self._abandon_homing()
        self._verbs.keep_modes()
        self._drives.restore()
        if self.gripper is not None:
            self.gripper.forget()
        self._states.begin(ready)
        self.start_at(q)
        if not ready:
            self._drives.switch(False)
        self._told = None

    def come_off(self) -> None:
        """End every move, law and effort, before another tool is mounted."""
        self._stop()

    def setpoints(self) -> Array:
        """Return the set-points of every joint, the jaw included, (n,) [rad or m]."""
        return self._verbs.setpoints.position.copy()

    def refit(self, rig_arm: RigArm, drives: Drives, q: Array, told: Array) -> None:
        """Take another tool with its motors; what was set stays.

        The arm is at rest at joint positions q and told to be at others, (n,) each.
        """
        before = self._verbs
        self._fit(rig_arm, drives)
        self._verbs.inherit(before)
        self._states = self._verbs.states
        self._verbs.setpoints.put(told)
        drives.place(q, np.zeros(len(q)))
        drives.command(told, np.zeros(len(q)))
        drives.apply()
        self.tell_state()

    def come_to_rest(self) -> None:
        """Hold, when the set-points are on their way."""
        if self.active or self._verbs.setpoints.velocity.any():
            self._stop()

    def check_playable(self) -> None:
        """Refuse a table of set-points while the arm takes no commands.

        Raises:
            InputError: why it takes none
        """
        why = self._states.why_not_ready()
        if why:
            raise InputError(f"play: {self.name}: {why}")

    def prepare_to_play(self) -> None:
        """Take joints back from effort control, for a table of set-points."""
        self._end_laws()
        self._verbs.under_position(slice(0, len(self.joint_names)))

    def take_over(self, q: Array, v: Array, effort: Array) -> None:
        """Take over set-points that a played trajectory has written, (n,) each."""
        if self._states.powered:
            self._verbs.setpoints.put(q)
            self._verbs.setpoints.velocity = v.copy()
            self._verbs.setpoints.effort = effort.copy()

    # ------------------------------------------------------------------ inside

    def _ended(self, accepted: bool) -> bool:
        """End laws after a position command that was accepted."""
        if accepted:
            self._end_laws()
            self.tell_state()
        return accepted

    def _pushed(self, accepted: bool) -> bool:
        """End laws after an effort command that was accepted."""
        if accepted:
            self._end_laws()
            self._push = self._verbs.setpoints.effort[self._own].copy()
            self.tell_state()
        return accepted

    def _begun(self, motion: Motion) -> Motion:
        self._ended(not motion.done)
        return motion

    def _end_laws(self) -> None:
        self._laws.clear()
        self._forget_lock()
