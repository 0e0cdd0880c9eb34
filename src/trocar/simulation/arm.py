"""An arm in time: the dVRK's verbs and readings."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import RigArm
from trocar.errors import InputError, UnknownNameError
from trocar.kinematics.forward import pose
from trocar.simulation.drives import Drives
from trocar.simulation.health import arm_health
from trocar.simulation.motion import Motion, Profile
from trocar.simulation.records import ArmHealth, ArmSnapshot, JointState, Mode, Pose

Array = NDArray[np.float64]

MODES: tuple[Mode, ...] = ("position", "effort", "set")
#: The same warning comes once in this much simulated time. Source: our own choice. [s]
WARNING_PERIOD_S = 2.0

log = logging.getLogger("trocar")


class Clock(Protocol):
    """What an arm needs of its world."""

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


class Arm:
    """One arm of a rig. Commands that cannot be used are refused with a warning; nothing moves.

    Attributes:
        name: "PSM1", ...
        type: PSM, ECM, SUJ or MTM
        joint_names: every joint, the jaw last where there is one
        lower, upper: limits, (n,) [rad or m]
        effort_limit: largest efforts, (n,) [N m or N]
        poses: {name: q (n,)}
        jaw: the jaw's own verbs, None without one
        warnings, last_warning: how many commands were refused or clipped, and the last reason
    """

    def __init__(self, rig_arm: RigArm, drives: Drives, clock: Clock) -> None:
        self.name = rig_arm.name
        self.description = rig_arm.arm
        self.type = rig_arm.arm.type
        self.joint_names = rig_arm.arm.mechanism.joint_names
        self.lower, self.upper = rig_arm.arm.mechanism.lower, rig_arm.arm.mechanism.upper
        self.poses = dict(rig_arm.arm.poses)
        self.warnings = 0
        self.last_warning = ""
        self._drives = drives
        self._clock = clock
        self._count = len(self.joint_names) - rig_arm.arm.has_jaw
        self._limits = (
            np.array([j.velocity_max for j in rig_arm.arm.joints]),
            np.array([j.acceleration_max for j in rig_arm.arm.joints]),
        )
        self._setpoint = np.zeros(len(self.joint_names))
        self._velocity = np.zeros(len(self.joint_names))
        self._acceleration = np.zeros(len(self.joint_names))
        self._effort = np.zeros(len(self.joint_names))
        self._moves: list[tuple[Motion, Profile, slice]] = []
        self._warned: dict[str, float] = {}
        self.jaw = Jaw(self) if rig_arm.arm.has_jaw else None

    # ------------------------------------------------------------------ readings

    @property
    def effort_limit(self) -> Array:
        """Largest effort of each motor, (n,) [N m or N]."""
        return self._drives.effort_limit.copy()

    @property
    def busy(self) -> bool:
        """Whether a move is under way."""
        return bool(self._moves)

    def measured_js(self) -> JointState:
        """Return measured positions, velocities and efforts, the jaw not included."""
        q, qd, effort = self.readings()
        return self._joint_state(q, qd, effort)

    def setpoint_js(self) -> JointState:
        """Return the set-points that the servos follow, the jaw not included."""
        return self._joint_state(self._setpoint, self._velocity, self._effort)

    def measured_cp(self) -> Pose:
        """Return the tip's pose, a PSM's in the ECM's frame where there is one."""
        base, frame = self._clock.base_pose(self.name)
        return Pose(base @ self.local_measured_cp().T, frame, self._clock.time)

    def setpoint_cp(self) -> Pose:
        """Return the pose of the tip at the set-points, in the frame of `measured_cp`."""
        base, frame = self._clock.base_pose(self.name)
        tip = pose(self.description.mechanism, self._setpoint)
        return Pose(base @ tip, frame, self._clock.time)

    def local_measured_cp(self) -> Pose:
        """Return the tip's pose in the arm's own reference frame (the remote centre's)."""
        mechanism = self.description.mechanism
        return Pose(pose(mechanism, self.readings()[0]), mechanism.reference, self._clock.time)

    def readings(self) -> tuple[Array, Array, Array]:
        """Return (positions, velocities, efforts) of every joint, the jaw included, (n,) each."""
        if self._drives.welded:
            still = np.zeros(len(self.joint_names))
            return self._setpoint.copy(), still, still.copy()
        return self._drives.positions(), self._drives.velocities(), self._drives.efforts()

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
            self._setpoint.copy(),
            tuple(self._drives.modes),
            tuple(bool(v) for v in self._drives.locked),
            self.busy,
            remote_centre,
            self.warnings,
            self.last_warning,
        )

    # ------------------------------------------------------------------ commands

    def servo_jp(self, q: ArrayLike, v: ArrayLike | None = None) -> bool:
        """Set the servos' positions now, the jaw not included.

        Args:
            q: (n,) [rad or m]; beyond a limit it is clipped with a warning
            v: (n,) [rad/s or m/s], zero when omitted

        Returns:
            whether the command was accepted
        """
        return self._servo(q, v, slice(0, self._count), "servo_jp")

    def servo_jf(self, effort: ArrayLike) -> bool:
        """Set the efforts of the joints that are in mode "effort"; they persist."""
        return self._servo_effort(effort, slice(0, self._count), "servo_jf")

    def move_jp(self, q: ArrayLike) -> Motion:
        """Move the set-points to a goal within velocity and acceleration limits."""
        return self._move(q, slice(0, self._count), "move_jp")

    def move_to(self, name: str) -> Motion:
        """Move every joint, the jaw too, to a named pose.

        Raises:
            UnknownNameError: no such pose; the known ones are listed
        """
        if name not in self.poses:
            raise UnknownNameError("pose", name, self.poses, self.name)
        return self._move(self.poses[name], slice(0, len(self.joint_names)), "move_jp")

    def hold(self) -> None:
        """End a move and stay at the set-point."""
        self._end_moves(slice(0, len(self.joint_names)))
        self._velocity[:] = 0.0
        self._drives.command(self._setpoint, self._velocity)

    # ------------------------------------------------------------------ control

    def mode(self, joint: str) -> Mode:
        """Return a joint's control mode."""
        return self._drives.modes[self._index(joint)]

    def set_mode(self, mode: Mode, joints: Sequence[str] | None = None) -> None:
        """Switch joints (all when omitted) to "position", "effort" or "set", from where they are.

        Raises:
            InputError: no such mode
            UnknownNameError: no such joint
        """
        if mode not in MODES:
            raise InputError(f"{self.name}: got mode {mode!r}; allowed: {', '.join(MODES)}")
        if self._drives.welded:
            raise InputError(
                f"{self.name}: is welded into the model; build the world with"
                ' setup_joints="braked" to move it'
            )
        which = self._which(joints)
        self._end_moves(slice(0, len(self.joint_names)))
        self._setpoint[which] = np.clip(self.readings()[0], self.lower, self.upper)[which]
        self._velocity[:] = 0.0
        self._effort[which] = 0.0
        self._drives.set_mode(mode, which, self._setpoint)

    def gains(self, joint: str) -> tuple[float, float, float]:
        """Return (P, I, D) of a joint."""
        p, i, d = self._drives.gains[self._index(joint)]
        return float(p), float(i), float(d)

    def set_gains(
        self, joint: str, p: float | None = None, i: float | None = None, d: float | None = None
    ) -> None:
        """Change gains of a joint; those omitted stay.

        Raises:
            InputError: a gain that is negative or not finite
        """
        row = self._drives.gains[self._index(joint)].copy()
        for column, value in enumerate((p, i, d)):
            if value is not None:
                if not np.isfinite(value) or value < 0.0:
                    raise InputError(
                        f"{self.name}: {joint}: got gain {value!r}; allowed: 0 or more"
                    )
                row[column] = value
        self._drives.gains[self._index(joint)] = row
        self._drives.apply()

    @property
    def gravity_compensation(self) -> bool:
        """Whether gravity compensation is on."""
        return self._drives.gravity_compensated

    def use_gravity_compensation(self, on: bool) -> None:
        """Switch gravity compensation."""
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

    def release_brakes(self, joints: Sequence[str] | None = None) -> None:
        """Release brakes (all when omitted); the joints then follow their servos from here.

        Raises:
            InputError: an arm without brakes, or one that is welded into the model
        """
        self._set_brakes(False, joints)

    def lock_brakes(self, joints: Sequence[str] | None = None) -> None:
        """Lock brakes (all when omitted) where the joints are."""
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
        """
        clean = self.readings()[0] + np.asarray(offset, dtype=np.float64)
        if noise == 0.0:
            return clean
        if rng is None:
            raise InputError(f"{self.name}: potentiometer noise needs a random generator")
        return clean + noise * rng.standard_normal(len(clean))

    # ------------------------------------------------------------------ used by the world

    def follow(self, time: float) -> None:
        """Advance the set-points of moves to a time."""
        for motion, profile, part in list(self._moves):
            q, v, a = profile.at(time)
            self._setpoint[part], self._velocity[part], self._acceleration[part] = q, v, a
            if profile.over(time):
                self._setpoint[part] = motion.goal
                self._velocity[part] = self._acceleration[part] = 0.0
                self._moves = [m for m in self._moves if m[0] is not motion]
                motion.finish(True)
        self._drives.command(self._setpoint, self._velocity)

    def start_at(self, q: Array) -> None:
        """Forget every command and start at joint positions, (n,)."""
        self._end_moves(slice(0, len(self.joint_names)))
        self._warned.clear()
        self._setpoint = q.copy()
        self._velocity = np.zeros(len(q))
        self._acceleration = np.zeros(len(q))
        self._effort = np.zeros(len(q))
        self._drives.place(q, self._velocity)
        self._drives.apply()

    def note_setpoint(self, q: Array, v: Array) -> None:
        """Take over set-points that a played trajectory has written, (n,) each."""
        self._end_moves(slice(0, len(self.joint_names)))
        self._setpoint, self._velocity = q.copy(), v.copy()

    def last_target(self, joint: int) -> float:
        """Return the set-point of a joint."""
        return float(self._setpoint[joint])

    # ------------------------------------------------------------------ inside

    def _servo(self, q: ArrayLike, v: ArrayLike | None, part: slice, verb: str) -> bool:
        target = self._checked(q, part, verb, "positions")
        speed = (
            np.zeros(part.stop - part.start)
            if v is None
            else self._checked(v, part, verb, "velocities")
        )
        if target is None or speed is None or self._refused_by_brakes(verb):
            return False
        self._end_moves(part)
        self._setpoint[part] = self._clipped(target, part, verb)
        self._velocity[part] = speed
        self._acceleration[part] = 0.0
        self._drives.command(self._setpoint, self._velocity)
        return True

    def _servo_effort(self, effort: ArrayLike, part: slice, verb: str) -> bool:
        wanted = self._checked(effort, part, verb, "efforts")
        if wanted is None:
            return False
        if not any(m == "effort" for m in self._drives.modes[part]):
            self._warn(f'{verb}: no joint is in mode "effort"; nothing is applied')
            return False
        limit = self._drives.effort_limit[part]
        if (np.abs(wanted) > limit).any():
            self._warn(f"{verb}: effort clipped to the limits")
        self._end_moves(part)
        self._effort[part] = np.clip(wanted, -limit, limit)
        self._drives.command_effort(self._effort)
        return True

    def _move(self, q: ArrayLike, part: slice, verb: str) -> Motion:
        target = self._checked(q, part, verb, "positions")
        if target is None or self._refused_by_brakes(verb):
            refused = Motion(self._setpoint[part].copy(), self._clock.wait)
            refused.finish(False)
            return refused
        goal = self._clipped(target, part, verb)
        self._end_moves(part)
        motion = Motion(goal, self._clock.wait)
        start = (self._setpoint[part], self._velocity[part], self._acceleration[part])
        limits = (self._limits[0][part], self._limits[1][part])
        profile = Profile(start, goal, limits, self._clock.time)
        self._moves.append((motion, profile, part))
        return motion

    def _checked(self, values: ArrayLike, part: slice, verb: str, what: str) -> Array | None:
        """Return values as (n,) float64, or warn and return None."""
        names = self.joint_names[part]
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            self._warn(f"{verb}: got {what} that are no numbers; allowed: {len(names)} numbers")
            return None
        if array.shape != (len(names),):
            self._warn(
                f"{verb}: got {what} of shape {array.shape}; allowed: ({len(names)},) for"
                f" {', '.join(names)}"
            )
            return None
        if not np.isfinite(array).all():
            self._warn(f"{verb}: got {what} {array.tolist()}; allowed: finite numbers")
            return None
        return array.copy()

    def _clipped(self, target: Array, part: slice, verb: str) -> Array:
        inside = np.clip(target, self.lower[part], self.upper[part])
        if (inside != target).any():
            beyond = [n for n, c in zip(self.joint_names[part], inside != target, strict=True) if c]
            self._warn(f"{verb}: {', '.join(beyond)} clipped to the limit")
        return inside

    def _refused_by_brakes(self, verb: str) -> bool:
        if self._drives.welded:
            self._warn(f"{verb}: the setup joints are welded into the model")
            return True
        if self._drives.brakes and self._drives.locked.all():
            self._warn(f"{verb}: the brakes are locked; release them first")
            return True
        return False

    def _end_moves(self, part: slice) -> None:
        """End the moves that share joints with `part`."""
        for motion, _, other in self._moves:
            if other.start < part.stop and part.start < other.stop:
                motion.finish(False)
        self._moves = [m for m in self._moves if not m[0].done]

    def _set_brakes(self, locked: bool, joints: Sequence[str] | None) -> None:
        if not self._drives.brakes:
            raise InputError(f"{self.name}: has no brakes; only setup joints do")
        if self._drives.welded:
            raise InputError(
                f"{self.name}: is welded into the model; build the world with"
                ' setup_joints="braked" to release its brakes'
            )
        which = self._which(joints)
        self._end_moves(slice(0, len(self.joint_names)))
        self._drives.set_brakes(locked, which)
        self._setpoint[which] = np.clip(self.readings()[0], self.lower, self.upper)[which]
        self._velocity[:] = 0.0
        self._drives.command(self._setpoint, self._velocity)

    def _which(self, joints: Iterable[str] | None) -> list[int]:
        return [self._index(name) for name in (self.joint_names if joints is None else joints)]

    def _index(self, joint: str) -> int:
        if joint not in self.joint_names:
            raise UnknownNameError("joint", joint, self.joint_names, self.name)
        return self.joint_names.index(joint)

    def _joint_state(self, q: Array, qd: Array, effort: Array) -> JointState:
        end = self._count
        return JointState(
            self.joint_names[:end],
            q[:end].copy(),
            qd[:end].copy(),
            effort[:end].copy(),
            self._clock.time,
        )

    def _warn(self, reason: str) -> None:
        self.warnings += 1
        self.last_warning = reason
        now = self._clock.time
        if now - self._warned.get(reason, -np.inf) >= WARNING_PERIOD_S:
            self._warned[reason] = now
            log.warning("%s: %s", self.name, reason)


class Jaw:
    """The verbs of an arm's jaw; positions are the full opening angle [rad]."""

    #: Source: dvrk_python psm.py, close and open of the jaw. [rad]
    CLOSED = float(np.deg2rad(-20.0))
    OPEN = float(np.deg2rad(60.0))

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        count = len(arm.joint_names)
        self._part = slice(count - 1, count)

    def measured_js(self) -> JointState:
        """Return the measured opening, its velocity and effort."""
        return self._state(self._arm.readings())

    def setpoint_js(self) -> JointState:
        """Return the opening that the servo follows; below 0 it is grip."""
        arm = self._arm
        return self._state((arm._setpoint, arm._velocity, arm._effort))

    def servo_jp(self, q: ArrayLike, v: ArrayLike | None = None) -> bool:
        """Set the opening now, (1,) [rad]."""
        return self._arm._servo(q, v, self._part, "jaw.servo_jp")

    def servo_jf(self, effort: ArrayLike) -> bool:
        """Set the effort of a jaw in mode "effort", (1,) [N m]."""
        return self._arm._servo_effort(effort, self._part, "jaw.servo_jf")

    def move_jp(self, q: ArrayLike) -> Motion:
        """Move the opening to a goal, (1,) [rad]."""
        return self._arm._move(q, self._part, "jaw.move_jp")

    def close(self) -> Motion:
        """Close with grip (-20 deg)."""
        return self.move_jp([max(self.CLOSED, float(self._arm.lower[-1]))])

    def open(self) -> Motion:
        """Open to 60 deg."""
        return self.move_jp([self.OPEN])

    def _state(self, values: tuple[Array, Array, Array]) -> JointState:
        q, qd, effort = (v[self._part].copy() for v in values)
        return JointState(("jaw",), q, qd, effort, self._arm._clock.time)
