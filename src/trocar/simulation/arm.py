"""An arm in time: the dVRK's verbs and readings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import RigArm
from trocar.errors import InputError, UnknownNameError
from trocar.kinematics.forward import pose
from trocar.simulation.drives import Drives
from trocar.simulation.health import arm_health
from trocar.simulation.jaw import Jaw
from trocar.simulation.journal import command
from trocar.simulation.motion import Motion
from trocar.simulation.records import ArmHealth, ArmSnapshot, JointState, Mode, Pose
from trocar.simulation.verbs import Clock, Verbs

Array = NDArray[np.float64]

MODES: tuple[Mode, ...] = ("position", "effort", "set")


class Arm:
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
        self._drives = drives
        self._clock = clock
        self.journal = self._journal = clock.journal
        self._source, self._prefix = rig_arm.name, ""
        self._verbs = Verbs(self.name, self.description, drives, clock)
        jaw = rig_arm.arm.has_jaw
        count, last = len(self.joint_names) - jaw, len(self.joint_names) - 1
        self._own = slice(0, count)
        self._parts = [self._own, slice(last, last + 1)] if jaw else [self._own]
        self.jaw = Jaw(self, self._verbs, last) if jaw else None

    # ------------------------------------------------------------------ readings

    @property
    def effort_limit(self) -> Array:
        """Largest effort of each motor, (n,) [N m or N]."""
        return self._drives.effort_limit.copy()

    @property
    def busy(self) -> bool:
        """Whether a move is under way."""
        return self._verbs.setpoints.moving

    @property
    def warnings(self) -> int:
        """How many commands were refused or clipped."""
        return self._verbs.refusals.count

    @property
    def last_warning(self) -> str:
        """Why the last of them was."""
        return self._verbs.refusals.last

    def measured_js(self) -> JointState:
        """Return measured positions, velocities and efforts, the jaw not included."""
        return self._verbs.state(self._own, setpoint=False)

    def setpoint_js(self) -> JointState:
        """Return the set-points that the servos follow, the jaw not included."""
        return self._verbs.state(self._own, setpoint=True)

    def measured_cp(self) -> Pose:
        """Return the tip's pose, a PSM's in the ECM's frame where there is one."""
        base, frame = self._clock.base_pose(self.name)
        return Pose(base @ self.local_measured_cp().T, frame, self._clock.time)

    def setpoint_cp(self) -> Pose:
        """Return the pose of the tip at the set-points, in the frame of `measured_cp`."""
        base, frame = self._clock.base_pose(self.name)
        tip = pose(self.description.mechanism, self._verbs.setpoints.position)
        return Pose(base @ tip, frame, self._clock.time)

    def local_measured_cp(self) -> Pose:
        """Return the tip's pose in the arm's own reference frame (the remote centre's)."""
        mechanism = self.description.mechanism
        return Pose(pose(mechanism, self.readings()[0]), mechanism.reference, self._clock.time)

    def readings(self) -> tuple[Array, Array, Array]:
        """Return (positions, velocities, efforts) of every joint, the jaw included, (n,) each."""
        return self._verbs.readings()

    def health(self) -> ArmHealth:
        """Return how well the arm's loops hold now."""
        return arm_health(self.description, self._drives.frame_coordinates())

    def snapshot(self, remote_centre: Array | None) -> ArmSnapshot:
        """Return a frozen copy of everything about this arm."""
        q, qd, effort = self.readings()
        return ArmSnapshot(
            self.joint_names,
            q,
            qd,
            effort,
            self._verbs.setpoints.position.copy(),
            tuple(self._drives.modes),
            tuple(bool(v) for v in self._drives.locked),
            self.busy,
            remote_centre,
            self.warnings,
            self.last_warning,
        )

    # ------------------------------------------------------------------ commands

    @command
    def servo_jp(self, q: ArrayLike, v: ArrayLike | None = None) -> bool:
        """Set the servos' positions now, the jaw not included.

        Args:
            q: (n,) [rad or m]; beyond a limit it is clipped with a warning
            v: (n,) [rad/s or m/s], zero when omitted

        Returns:
            whether the command was accepted
        """
        return self._verbs.servo(q, v, self._own, "servo_jp")

    @command
    def servo_jf(self, effort: ArrayLike) -> bool:
        """Set the efforts of the joints that are in mode "effort"; they persist.

        Args:
            effort: (n,) [N m or N], the jaw not included; joints in other modes ignore theirs

        Returns:
            whether the command was accepted
        """
        return self._verbs.servo_effort(effort, self._own, "servo_jf")

    @command
    def move_jp(self, q: ArrayLike) -> Motion:
        """Move the set-points to a goal within velocity and acceleration limits.

        Args:
            q: (n,) [rad or m], the jaw not included; beyond a limit it is clipped with a warning
        """
        return self._verbs.move(q, self._own, "move_jp")

    @command
    def move_to(self, name: str) -> Motion:
        """Move every joint, the jaw too, to a named pose.

        Raises:
            UnknownNameError: no such pose; the known ones are listed
        """
        if name not in self.poses:
            raise UnknownNameError("pose", name, self.poses, self.name)
        return self._verbs.move_parts(self.poses[name], self._parts, "move_to")

    @command
    def hold(self) -> None:
        """End every move and stay at the set-points."""
        setpoints = self._verbs.setpoints
        setpoints.end(slice(0, len(self.joint_names)))
        setpoints.velocity[:] = 0.0
        self._verbs.write()

    # ------------------------------------------------------------------ control

    def mode(self, joint: str) -> Mode:
        """Return a joint's control mode."""
        return self._drives.modes[self._index(joint)]

    @command
    def set_mode(self, mode: Mode, joints: Sequence[str] | None = None) -> None:
        """Switch joints (all when omitted) to "position", "effort" or "set", from where they are.

        Moves end; joints that change hold where they are, or exert nothing in mode "effort".

        Raises:
            InputError: no such mode, or an arm that is welded into the model
            UnknownNameError: no such joint
        """
        if mode not in MODES:
            raise InputError(f"{self.name}: got mode {mode!r}; allowed: {', '.join(MODES)}")
        self._check_movable("change its mode")
        which = self._which(joints)
        self._verbs.stay(which)
        self._verbs.setpoints.effort[which] = 0.0
        self._drives.set_mode(mode, which, self._verbs.setpoints.position)

    def gains(self, joint: str) -> tuple[float, float, float]:
        """Return (P, I, D) of a joint."""
        p, i, d = self._drives.gains[self._index(joint)]
        return float(p), float(i), float(d)

    @command
    def set_gains(
        self, joint: str, p: float | None = None, i: float | None = None, d: float | None = None
    ) -> None:
        """Change gains of a joint; those omitted stay.

        Raises:
            InputError: a gain that is negative or not finite
            UnknownNameError: no such joint
        """
        row = self._drives.gains[self._index(joint)].copy()
        for column, value in enumerate((p, i, d)):
            if value is None:
                continue
            if not isinstance(value, (int, float, np.number)) or not 0.0 <= value < np.inf:
                raise InputError(f"{self.name}: {joint}: got gain {value!r}; allowed: 0 or more")
            row[column] = value
        self._drives.gains[self._index(joint)] = row
        self._drives.apply()

    @property
    def gravity_compensation(self) -> bool:
        """Whether gravity compensation is on."""
        return self._drives.gravity_compensated

    @command
    def use_gravity_compensation(self, on: bool) -> None:
        """Switch gravity compensation; setup joints are counterbalanced and always have it."""
        self._drives.compensate_gravity(on)

    # ------------------------------------------------------------------ brakes of setup joints

    @property
    def brakes(self) -> dict[str, bool]:
        """{joint: whether its brake is locked}; empty for arms without brakes."""
        if not self._drives.brakes:
            return {}
        return {
            name: bool(v) for name, v in zip(self.joint_names, self._drives.locked, strict=True)
        }

    @command
    def release_brakes(self, joints: Sequence[str] | None = None) -> None:
        """Release brakes (all when omitted); the joints then follow their servos from here.

        Raises:
            InputError: an arm without brakes, or one that is welded into the model
            UnknownNameError: no such joint
        """
        self._set_brakes(False, joints)

    @command
    def lock_brakes(self, joints: Sequence[str] | None = None) -> None:
        """Lock brakes (all when omitted) where the joints are.

        Raises:
            InputError: an arm without brakes, or one that is welded into the model
            UnknownNameError: no such joint
        """
        self._set_brakes(True, joints)

    def potentiometers(
        self,
        noise: float = 0.0,
        offset: ArrayLike = 0.0,
        rng: np.random.Generator | None = None,
    ) -> Array:
        """Return what the setup joints' potentiometers read, (n,) [rad or m].

        Args:
            noise: standard deviation on request [rad or m]
            offset: of each reading, () or (n,) [rad or m]
            rng: generator of the noise, needed when there is some

        Raises:
            InputError: noise that is no number from 0 on or has no generator, a wrong offset
        """
        clean = self.readings()[0]
        shift = np.asarray(offset, dtype=np.float64)
        if shift.shape not in ((), clean.shape):
            raise InputError(
                f"{self.name}: got offsets of shape {shift.shape}; allowed: () or {clean.shape}"
            )
        if not 0.0 <= noise < np.inf:
            raise InputError(f"{self.name}: got noise {noise!r}; allowed: 0 or more")
        if noise == 0.0:
            return clean + shift
        if rng is None:
            raise InputError(f"{self.name}: potentiometer noise needs a random generator")
        return clean + shift + noise * rng.standard_normal(len(clean))

    # ------------------------------------------------------------------ used by the world

    def follow(self, time: float) -> None:
        """Advance the set-points of moves to a time."""
        self._verbs.setpoints.follow(time)
        self._verbs.write()

    def start_at(self, q: Array) -> None:
        """Forget every command and start at joint positions, (n,)."""
        self._verbs.refusals.forget()
        self._verbs.setpoints.put(q)
        self._drives.place(q, np.zeros(len(q)))
        self._drives.apply()

    def come_to_rest(self) -> None:
        """Hold, when the set-points are on their way."""
        if self.busy or self._verbs.setpoints.velocity.any():
            self.hold()

    def take_over(self, q: Array, v: Array, effort: Array) -> None:
        """Take over set-points that a played trajectory has written, (n,) each."""
        self._verbs.setpoints.put(q)
        self._verbs.setpoints.velocity = v.copy()
        self._verbs.setpoints.effort = effort.copy()

    # ------------------------------------------------------------------ inside

    def _set_brakes(self, locked: bool, joints: Sequence[str] | None) -> None:
        if not self._drives.brakes:
            raise InputError(f"{self.name}: has no brakes; only setup joints do")
        self._check_movable("release its brakes")
        which = self._which(joints)
        self._verbs.stay(which)
        self._drives.set_brakes(locked, which)
        self._verbs.write()

    def _check_movable(self, wish: str) -> None:
        if self._drives.welded:
            raise InputError(
                f"{self.name}: is welded into the model; build the world with"
                f' setup_joints="braked" to {wish}'
            )

    def _which(self, joints: Iterable[str] | None) -> list[int]:
        return [self._index(name) for name in (self.joint_names if joints is None else joints)]

    def _index(self, joint: str) -> int:
        if joint not in self.joint_names:
            raise UnknownNameError("joint", joint, self.joint_names, self.name)
        return self.joint_names.index(joint)
