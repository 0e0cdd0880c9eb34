"""An arm in time: the dVRK's states, verbs and readings."""

from __future__ import annotations

import copy
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.plugins import load_registered
from trocar.descriptions.records import RigArm
from trocar.errors import InputError, SingularError, TrocarError, UnknownNameError, UnreachableError
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.closed_form import fit_chain
from trocar.kinematics.inverse import POSE_TOLERANCE, nearest_solution, nearest_start
from trocar.kinematics.inverse_gimbal_arm import PLATFORM
from trocar.kinematics.inverse_rcm import DIRECTION_TOLERANCE
from trocar.kinematics.jacobian import jacobian_body, jacobian_spatial
from trocar.kinematics.solutions import LIMIT_TOLERANCE
from trocar.simulation.control import (
    LARGEST,
    ArmWorld,
    ControlState,
    Homing,
    JointControl,
    OperatingState,
    State,
)
from trocar.simulation.controllers import (
    CartesianForce,
    CartesianImpedance,
    Controller,
    ControllerError,
    RegisteredController,
    TipState,
    WrenchFrame,
)
from trocar.simulation.health import arm_health
from trocar.simulation.jaw import Gripper, Jaw
from trocar.simulation.journal import command
from trocar.simulation.masters import (
    GIMBAL,
    GimbalLimits,
    PlatformEffort,
    check_orientation,
    orientation_lock,
)
from trocar.simulation.motors import MODES, Motors
from trocar.simulation.moves import RATIO_MIN, Motion
from trocar.simulation.objects import checked_pose
from trocar.simulation.readout import least_wrench, turned
from trocar.simulation.records import (
    ArmHealth,
    ArmSample,
    ArmSnapshot,
    ArmStatus,
    JointState,
    Mode,
    Pose,
    Twist,
    Wrench,
)
from trocar.simulation.servos import EFFORT

Array = NDArray[np.float64]
Share = Literal["both", "velocity", "acceleration"]
log = logging.getLogger("trocar")

SHARES: tuple[Share, ...] = ("both", "velocity", "acceleration")
FRAMES: tuple[WrenchFrame, ...] = ("body", "spatial")
STATE_COMMANDS = ("enable", "disable", "home", "unhome", "pause", "resume")
#: Cartesian commands need the first wrist joint this far past the remote centre. Source:
#: mtsIntuitiveResearchKit.h, SafeDistanceFromRCM. [m]
SAFE_DEPTH_M = 0.045
#: The closed form of masters, whose wrist platform is free and whose gimbal can be locked.
GIMBAL_ARM = "gimbal_arm"


@dataclass(frozen=True)
class Expiry:
    """When an effort or velocity set-point ends, unless another command comes before.

    Attributes:
        verb: that set it
        timeout: given with it [s]
        time: simulation time of the end [s]
    """

    verb: str
    timeout: float
    time: float


@dataclass(frozen=True, eq=False)
class ArmState:
    """What an arm keeps beside the physics and the servos, as `Arm.save` returns it.

    The names of its fields are in pickled states and in recordings.
    """

    state: State
    homed: bool
    told: tuple[State, bool, bool] | None
    control: ControlState
    laws: dict[str, Controller]
    lock: Array | None
    absolute: bool
    push: Array
    base: tuple[Array, str] | None
    homing: tuple[Array, Array, bool, bool] | None
    gripper: tuple[bool, int, float | None] | None
    expiry: Expiry | None = None


class Arm:
    """One arm of a rig. Commands that cannot be used are rejected with a warning; nothing moves.

    Attributes:
        name: "PSM1", ...
        type: PSM, ECM, SUJ or MTM
        description: the arm with its tool
        joint_names: every joint, the jaw last where there is one
        lower, upper: limits, (n,) [rad or m]
        poses: {name: q (n,)}
        jaw: the jaw's own verbs, None without one
        gripper: a master's gripper, None without one
        motors: set-points, modes, gains and brakes of its joints
        control: joint commands for any part of its joints
        journal: receives its commands and events
    """

    def __init__(self, rig_arm: RigArm, motors: Motors, clock: ArmWorld) -> None:
        self.name, self.type = rig_arm.name, rig_arm.arm.type
        self.journal = self._journal = clock.journal
        self._source, self._prefix = rig_arm.name, ""
        self._clock = clock
        self._base: tuple[Array, str] | None = None
        self._homing: Homing | None = None
        #: Active controllers by name; the efforts that were commanded, which theirs are added to.
        self._controllers: dict[str, Controller] = {}
        self._expiry: Expiry | None = None
        self._lock: Array | None = None
        self._absolute = False
        self._reported: tuple[State, bool, bool] | None = None
        self._status: ArmStatus | None = None
        self._status_revision = -1
        #: The one jaw that is ever handed out; `jaw` is None while a tool has none.
        self._jaw = Jaw(self.name, self.journal, self.report_state)
        self._fit(rig_arm, motors, None)

    def __repr__(self) -> str:
        """Name the arm and its tool, with its operating state and measured joint positions."""
        tool = f" with {self.tool}" if self.tool else ""
        q = ", ".join(
            f"{joint} {value + 0.0:.4g}"
            for joint, value in zip(self.joint_names, self.positions().round(5), strict=True)
        )
        return f"<Arm {self.name!r}: {self.type}{tool}, {self.operating_state().state}; {q}>"

    def _fit(self, rig_arm: RigArm, motors: Motors, before: JointControl | None) -> None:
        """Set what the mounted tool determines."""
        self.description = rig_arm.arm
        self.joint_names = rig_arm.arm.mechanism.joint_names
        self.lower, self.upper = rig_arm.arm.mechanism.lower, rig_arm.arm.mechanism.upper
        self.poses = dict(rig_arm.arm.poses)
        self.motors = motors
        self.control = JointControl(self.name, motors, self._clock, before)
        self._states = self.control.states
        self._effort = np.zeros(rig_arm.arm.own_joints)
        jaw, last = rig_arm.arm.has_jaw, len(self.joint_names) - 1
        self._own = slice(0, rig_arm.arm.own_joints)
        self._all = slice(0, len(self.joint_names))
        self._parts = [self._own, slice(last, last + 1)] if jaw else [self._own]
        self._jaw.fit(self.control if jaw else None)
        self.jaw = self._jaw if jaw else None
        grips = rig_arm.arm.has_gripper
        now = lambda: self._clock.time  # noqa: E731
        self.gripper = Gripper(self.name, self.control, self.journal, now) if grips else None

    @command
    def set_tool_type(self, name: str) -> None:
        """Mount another tool; see the world's `exchange_tool` for what becomes of the arm.

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
        return self._ended(self.control.servo(q, v, self._own, "servo_jp"))

    @command
    def servo_jr(self, dq: ArrayLike) -> bool:
        """Add to the set-points now, (n,) [rad or m]; return whether it was accepted."""
        return self._ended(self.control.servo_relative(dq, self._own, "servo_jr"))

    @command
    def servo_jv(self, v: ArrayLike, timeout_s: float | None = None) -> bool:
        """Let the set-points go on at velocities until the next command, each up to its limit.

        Args:
            v: (n,) [rad/s or m/s], the jaw not included; beyond a joint's velocity limit it is
                clipped with a warning; zeros stop
            timeout_s: as for `servo_jf`

        Returns:
            whether the command was accepted
        """
        if not self._may_expire("servo_jv", timeout_s):
            return False
        accepted = self._ended(self.control.servo_velocity(v, self._own, "servo_jv"))
        return self._expiring(accepted, "servo_jv", timeout_s)

    @command
    def servo_jf(self, effort: ArrayLike, timeout_s: float | None = None) -> bool:
        """Set the joints' efforts; they persist until the next command or the time-out.

        Args:
            effort: (n,) [N m or N], the jaw not included. Joints in mode "effort" take theirs;
                where none is, all joints are under effort control until the next position command
            timeout_s: simulated time after which the arm holds where it is, with a warning, unless
                another command of its motion was accepted before [s]; None: never, as on the dVRK

        Returns:
            whether the command was accepted
        """
        if not self._may_expire("servo_jf", timeout_s):
            return False
        accepted = self.control.servo_effort(effort, self._own, "servo_jf")
        return self._expiring(self._accept_effort(accepted), "servo_jf", timeout_s)

    @command
    def move_jp(self, q: ArrayLike) -> Motion:
        """Move the set-points to a goal within velocity and acceleration limits.

        Args:
            q: (n,) [rad or m], the jaw not included; beyond a limit it is clipped with a warning
        """
        return self._begun(self.control.move(q, [self._own], "move_jp"))

    @command
    def move_jr(self, dq: ArrayLike) -> Motion:
        """Move on by (n,) [rad or m] from the goal of the move under way, or the set-points."""
        return self._begun(self.control.move_relative(dq, self._own, "move_jr"))

    @command
    def move_to(self, name: str) -> Motion:
        """Move every joint, the jaw too, to a named pose.

        Raises:
            UnknownNameError: no such pose; the known ones are listed
        """
        if name not in self.poses:
            raise UnknownNameError("pose", name, self.poses, self.name)
        goal = self.poses[name][: self._parts[-1].stop]
        return self._begun(self.control.move(goal, self._parts, "move_to"))

    @command
    def hold(self) -> None:
        """End every move and controller, and stay at the set-points."""
        if self.control.ready("hold"):
            self._stop()

    @command
    def free(self) -> bool:
        """Exert nothing but gravity compensation, until the next command; the jaw holds."""
        zero = np.zeros(len(self._effort))
        return self._accept_effort(self.control.servo_effort(zero, self._own, "free"))

    # ------------------------------------------------------------------ tip

    @command
    def servo_cp(self, T: ArrayLike) -> bool:
        """Bring the tip to a pose (4, 4) in the frame of `measured_cp` now."""
        q = self._solved(T, "servo_cp")
        return q is not None and self._ended(self.control.servo(q, None, self._own, "servo_cp"))

    @command
    def servo_cr(self, T: ArrayLike) -> bool:
        """Move the tip from its set-point by a translation and a rotation, (4, 4), now.

        Both in axes of the frame of `measured_cp`: p + dp, dR @ R.
        """
        try:
            change = checked_pose(self.name, T)
        except InputError as problem:
            self.control.rejections.warn("servo_cr pose", f"servo_cr: {problem}")
            return False
        goal = self.setpoint_cp().T
        goal = transform(change[:3, :3] @ goal[:3, :3], goal[:3, 3] + change[:3, 3])
        q = self._solved(goal, "servo_cr")
        return q is not None and self._ended(self.control.servo(q, None, self._own, "servo_cr"))

    @command
    def move_cp(self, T: ArrayLike) -> Motion:
        """Move to a pose (4, 4) in the frame of `measured_cp`: solved once, then joint by joint."""
        q = self._solved(T, "move_cp")
        if q is None:
            return self.control.rejected(self._own)
        return self._begun(self.control.move(q, [self._own], "move_cp"))

    @command
    def servo_cf(
        self, wrench: ArrayLike, frame: WrenchFrame = "body", timeout_s: float | None = None
    ) -> bool:
        """Exert a wrench (force; torque), (6,) [N, N m], until the next command or the time-out.

        Args:
            wrench: what the arm exerts on its surroundings
            frame: "body": at the tip in its axes; "spatial": about the reference frame's origin
            timeout_s: as for `servo_jf`
        """
        names = ("fx", "fy", "fz", "tx", "ty", "tz")
        components = self.control.rejections.vector(wrench, names, "servo_cf", "forces")
        if components is None:
            return False
        if frame not in FRAMES:
            self.control.rejections.warn(
                "servo_cf frame", f"servo_cf: got frame {frame!r}; allowed: {', '.join(FRAMES)}"
            )
            return False
        if not self._may_expire("servo_cf", timeout_s):
            return False
        force = CartesianForce(components, frame, self._absolute)
        return self._expiring(self._run_controller(force, "servo_cf"), "servo_cf", timeout_s)

    @command
    def set_cf_orientation_absolute(self, on: bool) -> None:
        """Take the wrenches of `servo_cf` in the axes of `measured_cp`'s frame, at the tip."""
        self._absolute = bool(on)

    @command
    def servo_ci(self, impedance: CartesianImpedance) -> bool:
        """Be a spring and damper about a pose, until the next command."""
        try:
            if not isinstance(impedance, CartesianImpedance):
                raise InputError(f"got {impedance!r}; allowed: a CartesianImpedance")
            impedance.check(LARGEST)
        except InputError as problem:
            self.control.rejections.warn("servo_ci values", f"servo_ci: {problem}")
            return False
        return self._run_controller(impedance, "servo_ci")

    @command
    def use_controller(self, name: str, settings: Mapping[str, Any] | None = None) -> bool:
        """Exert what a controller of an installed package computes, until the next command.

        A controller that raises puts the arm into FAULT.

        Args:
            name: as the package registers it, see docs/extending.md
            settings: keyword arguments of its class

        Raises:
            UnknownNameError: no package registers it; the known names are listed
            InputError: it cannot be made with these settings
        """
        made = load_registered("controllers", str(name))
        try:
            controller: Controller = made(**(settings or {}))
        except Exception as problem:
            what = f"{type(problem).__name__}: {problem}"
            raise InputError(f"controller {name}: got {settings!r}: {what}") from problem
        if not callable(getattr(controller, "act", None)):
            raise InputError(f"controller {name}: got {controller!r}; allowed: with act(now)")
        return self._run_controller(RegisteredController(str(name), controller), "use_controller")

    # ------------------------------------------------------------------ states

    @command
    def state_command(self, name: str) -> bool:
        """Execute "enable", "disable", "home", "unhome", "pause" or "resume".

        As on the hardware, "home" lets an arm that is on and home already stay where it is.

        Returns:
            whether it was accepted
        """
        if name not in STATE_COMMANDS:
            self.control.rejections.warn(
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
            self.motors.switch(True)
            self.motors.follow()
            self.report_state()
        return True

    @command
    def disable(self) -> bool:
        """End everything and switch the motors off; the arm is held where it is."""
        self._switch_off()
        self._states.state = "DISABLED"
        self.report_state()
        return True

    @command
    def pause(self) -> bool:
        """End moves and hold; no command moves the arm until `resume`."""
        if not self._may("pause"):
            return False
        self._stop()
        self._states.state = "PAUSED"
        self.report_state()
        return True

    @command
    def resume(self) -> bool:
        """Accept commands again after `pause`."""
        if not self._may("resume"):
            return False
        self._states.state = "ENABLED"
        self.report_state()
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
        own = self.motors.position[self._own]
        if not self._may("home"):
            return self.control.rejected(self._own)
        if self._states.homed and self._states.powered and not anew:
            self.report_state()
            return self._over(own)
        self._states.homed = False
        self.enable()
        self._stop()
        goal = self.poses["home"][self._own] if "home" in self.poses else own
        motion = Motion(goal.copy(), self._clock.wait)
        moves = "home" in self.poses and not self.motors.welded and not self.motors.brakes
        way = (
            self.control.moves.begin(goal, [self._own], self._clock.time)
            if moves
            else self._over(own)
        )
        kinds = [j.kind == "prismatic" for j in self.description.joints[self._own]]
        self._homing = Homing(motion, way, np.array(kinds))
        self.report_state()
        return motion

    @command
    def unhome(self) -> bool:
        """Forget that the arm was homed; it holds where it is."""
        if self._states.state == "ENABLED":
            self._stop()
        self._states.homed = False
        self.report_state()
        return True

    def fault(self, reason: str) -> None:
        """Switch the motors off after a fault (the world calls this)."""
        self._switch_off()
        self._states.state = "FAULT"
        log.error("%s: FAULT: %s", self.name, reason)
        self.control.rejections.last = f"FAULT: {reason}"
        self.control.report("error", text=reason)
        self.report_state()

    # ------------------------------------------------------------------ servos

    def mode(self, joint: str) -> Mode:
        """Return a joint's control mode."""
        return self.motors.mode(self._index(joint))

    @command
    def set_mode(self, mode: Mode, joints: Sequence[str] | None = None) -> None:
        """Switch joints (all when omitted) to "position", "effort" or "set", from where they are.

        Moves end; joints that change hold where they are, or exert nothing in mode "effort".
        Rejected with a warning while the arm has power but may not move (PAUSED, not homed).

        Raises:
            InputError: no such mode, or an arm that is welded into the model
            UnknownNameError: no such joint
        """
        if mode not in MODES:
            raise InputError(f"{self.name}: got mode {mode!r}; allowed: {', '.join(MODES)}")
        self._check_movable("change its mode")
        which = self._which(joints)
        if self._states.powered and not self.control.ready("set_mode"):
            return
        self._end_controllers()
        self.control.under_position(self._all)
        self.control.stay(which)
        self.motors.effort[which] = 0.0
        self.motors.set_mode(MODES.index(mode), which)

    def gains(self, joint: str) -> tuple[float, float, float]:
        """Return (P, I, D) of a joint."""
        p, i, d = self.motors.gains[self._index(joint)]
        return float(p), float(i), float(d)

    @command
    def set_gains(
        self, joint: str, p: float | None = None, i: float | None = None, d: float | None = None
    ) -> None:
        """Change gains of a joint; those omitted stay.

        Raises:
            InputError: a gain that is negative, not finite or larger than 1e6
            UnknownNameError: no such joint
        """
        row = self.motors.gains[self._index(joint)].copy()
        for column, value in enumerate((p, i, d)):
            if value is None:
                continue
            if not isinstance(value, (int, float, np.number)) or not 0.0 <= value <= LARGEST:
                raise InputError(
                    f"{self.name}: {joint}: got gain {value!r}; allowed: 0 to {LARGEST:g}"
                )
            row[column] = value
        self.motors.set_gains(self._index(joint), row)

    @property
    def gravity_compensation(self) -> bool:
        """Whether gravity compensation is on."""
        return self.motors.gravity_compensated

    @command
    def use_gravity_compensation(self, on: bool) -> None:
        """Switch gravity compensation; setup joints are counterbalanced and always have it.

        Raises:
            InputError: the arm is welded into the model
        """
        self._check_movable("switch its gravity compensation")
        self.motors.compensate_gravity(bool(on))

    @property
    def computed_torque(self) -> bool:
        """Whether joints in mode "position" have computed torque."""
        return self.motors.torque_computed

    @command
    def use_computed_torque(self, on: bool) -> None:
        """Switch computed torque: the model's inverse dynamics beside the servos' P and D.

        Joints in mode "position" then follow their set-points without the errors that weight,
        inertia, friction and the other joints' motion cause; a physics step takes longer.

        Raises:
            InputError: the arm is welded into the model
        """
        self._check_movable("switch its computed torque")
        self.motors.compute_torque(bool(on))

    # ------------------------------------------------------------------ moves

    @property
    def strict_limits(self) -> bool:
        """Whether targets beyond a limit are rejected; else they are clipped, as on the dVRK."""
        return self.control.strict_limits

    @command
    def use_strict_limits(self, on: bool) -> None:
        """Reject targets beyond a limit, or clip them."""
        self.control.strict_limits = bool(on)

    @property
    def trajectory_ratio(self) -> tuple[float, float]:
        """Shares of the velocity and acceleration limits that moves keep to, RATIO_MIN to 1."""
        return self.control.moves.velocity_ratio, self.control.moves.acceleration_ratio

    @command
    def set_trajectory_ratio(self, ratio: float, of: Share = "both") -> None:
        """Slow down the moves that begin from now on.

        Args:
            ratio: share of the limits, RATIO_MIN to 1
            of: "both", "velocity" or "acceleration"

        Raises:
            InputError: another ratio or limit
        """
        if of not in SHARES:
            raise InputError(f"{self.name}: got ratio of {of!r}; allowed: {', '.join(SHARES)}")
        if not isinstance(ratio, (int, float, np.number)) or not RATIO_MIN <= ratio <= 1.0:
            raise InputError(f"{self.name}: got ratio {ratio!r}; allowed: {RATIO_MIN:g} to 1")
        if of != "acceleration":
            self.control.moves.velocity_ratio = float(ratio)
        if of != "velocity":
            self.control.moves.acceleration_ratio = float(ratio)
        velocity, acceleration = self.trajectory_ratio
        self.control.report("trajectory_ratio", velocity=velocity, acceleration=acceleration)

    @command
    def set_base_frame(self, T: ArrayLike | None, frame_id: str = "") -> None:
        """Set the pose of the arm's reference frame in the frame of `measured_cp`.

        Args:
            T: (4, 4); None: where the rig has it, by the measured joints of what carries it
            frame_id: name of the frame that T is in; "<ARM>_base" when omitted

        Raises:
            InputError: T is no pose
        """
        if T is None:
            self._base = None
            return
        self._base = checked_pose(self.name, T).copy(), frame_id or f"{self.name}_base"

    # ------------------------------------------------------------------ brakes of setup joints

    @property
    def brakes(self) -> dict[str, bool]:
        """{joint: whether its brake is locked}; empty for arms without brakes."""
        if not self.motors.brakes:
            return {}
        return {name: bool(v) for name, v in zip(self.joint_names, self.motors.locked, strict=True)}

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
        clean = self.motors.positions()
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

    # ------------------------------------------------------------------ orientation of a master

    @property
    def orientation_locked(self) -> bool:
        """Whether the gimbal holds an orientation, or will under the next force command."""
        return self._lock is not None

    @command
    def lock_orientation(self, R: ArrayLike | None = None) -> bool:
        """Let the gimbal hold an orientation while the tip is under force control.

        It does so under `servo_cf` and `servo_ci`, at once or when one of them comes; the first
        three joints stay free. `unlock_orientation`, `free` and every other command end it.

        Args:
            R: (3, 3) or a quaternion wxyz, in the frame of `measured_cp`; as it is when omitted

        Returns:
            whether the command was accepted
        """
        if not self.control.ready("lock_orientation"):
            return False
        if self.description.inverse_kinematics != GIMBAL_ARM:
            self._reject("only masters can")
            return False
        try:
            orientation = self.measured_cp().T[:3, :3] if R is None else check_orientation(R)
        except TrocarError as problem:
            self._reject(str(problem))
            return False
        self._lock = orientation.copy()
        if "wrench" in self._controllers:
            self._begin_lock()
        self.control.report("orientation_locked", locked=True)
        return True

    @command
    def unlock_orientation(self) -> bool:
        """Let the gimbal go; under force control it floats again."""
        if "lock" in self._controllers:
            del self._controllers["lock"]
            self.control.to_effort(list(range(GIMBAL.start, GIMBAL.stop)), self._own)
        self._forget_lock()
        return True

    # ------------------------------------------------------------------ state

    def operating_state(self) -> OperatingState:
        """Return the state as CRTK has it."""
        busy = self.busy or self._homing is not None
        return OperatingState(self._states.state, self._states.homed, busy, self._clock.time)

    def report_state(self) -> None:
        """Enter the operating state into the journal, when it changed."""
        states = self._states
        busy = bool(self.control.moves.legs) or self._homing is not None
        now = states.state, states.homed, busy
        if now != self._reported:
            self._reported = now
            self.control.report("operating_state", state=now[0], is_homed=now[1], is_busy=now[2])

    @property
    def effort_limit(self) -> Array:
        """Largest effort of each motor, (n,) [N m or N]."""
        return self.motors.limit.copy()

    @property
    def busy(self) -> bool:
        """Whether a move is under way."""
        return bool(self.control.moves.legs)

    @property
    def warnings(self) -> int:
        """How many commands were rejected or clipped."""
        return self.control.rejections.count

    @property
    def last_warning(self) -> str:
        """Why the last of them was."""
        return self.control.rejections.last

    @property
    def tool(self) -> str:
        """Name of the mounted tool, "" without one."""
        return self.description.tool

    # ------------------------------------------------------------------ joints

    def measured_js(self) -> JointState:
        """Return measured positions, velocities and efforts, jaw or gripper not included."""
        return self.control.measured(self._own)

    def setpoint_js(self) -> JointState:
        """Return the set-points that the servos follow, the jaw not included."""
        return self.control.setpoint(self._own)

    def positions(self) -> Array:
        """Return measured positions of every joint, the jaw included, (n,) [rad or m]."""
        return self.motors.positions()

    def readings(self) -> tuple[Array, Array, Array]:
        """Return (positions, velocities, efforts) of every joint, the jaw included, (n,) each."""
        q, qd, effort = self.motors.read()
        return q, qd, effort

    def frame_coordinates(self) -> Array:
        """Return every frame's own coordinate, with the loops' errors, (n_frames,)."""
        return self.motors.frame_coordinates()

    def health(self) -> ArmHealth:
        """Return how well the arm's loops hold now."""
        return arm_health(self.description, self.motors.frame_coordinates())

    def snapshot(self, remote_centre: Array | None, read: Array | None = None) -> ArmSnapshot:
        """Return a frozen copy of everything about this arm.

        Args:
            remote_centre: in the world, (3,) [m]
            read: positions, velocities and efforts (3, n), where they were read already
        """
        motors, control, states = self.motors, self.control, self._states
        q, qd, effort = motors.read() if read is None else read
        setpoint = motors.position.copy()
        if self.gripper is not None and motors.modes[-1] == EFFORT:
            setpoint[-1] = q[-1]  # nothing holds its levers
        modes, locked = motors.labels()
        return ArmSnapshot(
            self.joint_names,
            q,
            qd,
            effort,
            setpoint,
            modes,
            locked,
            bool(control.moves.legs),
            remote_centre,
            control.rejections.count,
            control.rejections.last,
            states.state,
            states.homed,
            self.description.tool,
        )

    # ------------------------------------------------------------------ tip

    @property
    def placed(self) -> tuple[Array, str] | None:
        """Base frame and its name as `set_base_frame` set them, None where it did not."""
        return self._base

    def base_frame(self) -> tuple[Array, str]:
        """Return T (4, 4) of the arm's reference frame in the frame of its poses, and its name.

        It is the one of `RigDescription.pose_frame`, unless `set_base_frame` set another.
        """
        return self._base or self._clock.base_pose(self.name)

    def pose_view(self) -> tuple[int, Array, str]:
        """Return where `measured_cp` is seen from, as `Frames.view` does."""
        frames = self._clock.frames
        if self._base is not None:
            return frames.own_view(self.name), *self._base
        return frames.view(self.name, self._clock.reference_arm)

    def measured_cp(self) -> Pose:
        """Return the tip's pose, a PSM's in the ECM's frame where there is one."""
        if self._base is not None or not self._clock.frames.follows(self.name):
            base, frame = self.base_frame()
            return Pose(base @ self.local_measured_cp().T, frame, self._clock.time)
        T, frame = self._clock.frames.public(self.name, self._clock.reference_arm)
        return Pose(T, frame, self._clock.time)

    def tip_in_world(self) -> Pose:
        """Return the tip's pose in the frame of the rig, whatever `measured_cp` is relative to."""
        frames = self._clock.frames
        if frames.follows(self.name):
            return Pose(frames.tip_pose(self.name), "world", self._clock.time)
        T = frames.reference_pose(self.name) @ self.local_measured_cp().T
        return Pose(T, "world", self._clock.time)

    def setpoint_cp(self) -> Pose:
        """Return the pose of the tip at the set-points, in the frame of `measured_cp`."""
        if self._base is not None or not self._clock.frames.follows(self.name):
            base, frame = self.base_frame()
            return Pose(base @ self.local_setpoint_cp().T, frame, self._clock.time)
        clock, setpoint = self._clock, self.motors.position
        T, frame = clock.frames.public_at(self.name, setpoint, clock.reference_arm)
        return Pose(T, frame, clock.time)

    def local_measured_cp(self) -> Pose:
        """Return the tip's pose in the arm's own reference frame (the remote centre's)."""
        if not self._clock.frames.follows(self.name):
            return self._local_pose(self.positions())
        T, frame = self._clock.frames.measured(self.name), self.description.mechanism.reference
        return Pose(T, frame, self._clock.time)

    def local_setpoint_cp(self) -> Pose:
        """Return the pose of the tip at the set-points in the arm's own reference frame."""
        if not self._clock.frames.follows(self.name):
            return self._local_pose(self.motors.position)
        T = self._clock.frames.local_at(self.name, self.motors.position)
        return Pose(T, self.description.mechanism.reference, self._clock.time)

    def measured_cv(self) -> Twist:
        """Return the velocity of the tip's origin and its rotation, in axes of `measured_cp`."""
        base, frame = self.base_frame()
        own = self._local_twist()
        twist = turned(base[:3, :3], own)
        return Twist(twist[:3], twist[3:], frame, self._clock.time)

    def local_measured_cv(self) -> Twist:
        """Return the same in axes of the arm's own reference frame [m/s, rad/s]."""
        twist, frame = self._local_twist(), self.description.mechanism.reference
        return Twist(twist[:3], twist[3:], frame, self._clock.time)

    def _local_twist(self) -> Array:
        """Return the tip's velocity in axes of the arm's own reference frame, (6,)."""
        R, qd = self.local_measured_cp().T[:3, :3], self.motors.read()[1]
        return turned(R, self._jacobian("body").dot(qd))

    def measured_cf(self, frame: WrenchFrame = "body") -> Wrench:
        """Return the wrench that the motors exert at the tip, what carries the links not counted.

        The least-squares solution of tau = J^T w: exact for six joints, the smallest for fewer.

        Args:
            frame: "body": at the tip in its axes; "spatial": about the reference frame's origin

        Raises:
            InputError: no such frame
        """
        J = self.jacobian(frame)
        effort = (self.motors.read()[2] - self.motors.load())[self._own]
        wrench = least_wrench(J, effort)
        mechanism = self.description.mechanism
        named = f"{self.name}_{mechanism.tip}" if frame == "body" else mechanism.reference
        return Wrench(wrench[:3], wrench[3:], named, self._clock.time)

    def jacobian(self, frame: WrenchFrame = "body") -> Array:
        """Return J with (linear; angular) = J @ qd where the arm is, jaw left out, (6, n).

        Raises:
            InputError: no such frame
        """
        if frame not in FRAMES:
            raise InputError(f"{self.name}: got frame {frame!r}; allowed: {', '.join(FRAMES)}")
        return self._jacobian(frame)[:, self._own]

    # ------------------------------------------------------------------ kinematics

    def forward_kinematics(self, q: ArrayLike) -> Pose:
        """Return the tip's pose at joint positions, (n,) without the jaw, as `measured_cp`.

        Raises:
            InputError: no (n,) finite numbers
        """
        base, frame = self.base_frame()
        return Pose(base @ self._local_pose(self._whole(q)).T, frame, self._clock.time)

    def inverse_kinematics(self, T: ArrayLike, seed: ArrayLike | None = None) -> Array:
        """Return the joint positions nearest to a seed that bring the tip to a pose, (n,).

        Args:
            T: pose in the frame of `measured_cp`, (4, 4)
            seed: (n,) without the jaw [rad or m]; the set-points when omitted

        Raises:
            InputError: no pose, or an arm without a closed form
            UnreachableError, SingularError: no solution
        """
        structure = self.description.inverse_kinematics
        if not structure:
            raise InputError(f"{self.name}: has no inverse kinematics")
        pose = checked_pose(self.name, T)
        start = self.control.setpoints(self._own) if seed is None else self._whole(seed)[self._own]
        return self.local_inverse_kinematics(self._in_own_frame(pose), start)

    def local_inverse_kinematics(self, local: Array, start: Array) -> Array:
        """Return the joint positions nearest to others that bring the tip to a pose, (n,).

        Args:
            local: pose in the arm's own reference frame, (4, 4), not checked
            start: (n,) without the jaw [rad or m]

        Raises:
            UnreachableError, SingularError: no solution
        """
        structure, mechanism = self.description.inverse_kinematics, self.description.mechanism
        if self._clock.frames.follows(self.name):
            near = nearest_start(mechanism, structure, local, start)
            tolerance = DIRECTION_TOLERANCE if structure == "rcm_scope" else POSE_TOLERANCE
            frames = self._clock.frames
            found = None if near is None else frames.reach(self.name, local, near, tolerance)
            if found is not None:
                inside = np.clip(found, self.lower[self._own], self.upper[self._own])
                if (np.abs(found - inside) <= LIMIT_TOLERANCE).all():
                    return inside
        return nearest_solution(mechanism, structure, local, start)

    def status(self) -> ArmStatus:
        """Return what changes with commands and events only; the same object until then."""
        revision = self.journal.revision
        if self._status is None or self._status_revision != revision:
            motors, moves = self.motors, self.control.moves
            self._status_revision = revision
            self._status = ArmStatus(
                not motors.welded and motors.gravity_compensated,
                self._states.state,
                self._states.homed,
                self.busy or self._homing is not None,
                self._base,
                self.description.tool,
                (moves.velocity_ratio, moves.acceleration_ratio),
                self.gripper is not None and self.gripper.closed,
                self._lock is not None,
                motors.brakes and np.count_nonzero(motors.locked) == len(motors.locked),
            )
        return self._status

    def sample(self, joints: Array | None = None) -> ArmSample:
        """Return copies of what every reading of this arm is computed from.

        Args:
            joints: of `ArmSample`, where somebody has copied them, (7, n)
        """
        if joints is None:
            motors = self.motors
            setpoint = motors.position, motors.velocity, motors.effort
            joints = np.array([*self.readings(), motors.load(), *setpoint])
        return ArmSample(self.status(), joints)

    # ------------------------------------------------------------------ used by the world

    @property
    def active(self) -> bool:
        """Whether set-points or efforts change from step to step."""
        return (
            self.control.moves.active
            or self._homing is not None
            or bool(self._controllers)
            or self._expiry is not None
        )

    def follow(self, time: float) -> None:
        """Advance the set-points of moves to a time, and renew the efforts of controllers."""
        if self._expiry is not None and self._clock.time >= self._expiry.time - 1e-9:
            self._expire(self._expiry)
        self.control.moves.follow(time)
        self.motors.follow()
        if self._controllers:
            self._apply_controllers()
        if self._homing is not None:
            self._watch(self._homing)
        self.report_state()

    def start_at(self, q: Array) -> None:
        """Forget every command; set-points rest at joint positions, (n,)."""
        self._end_controllers()
        self.control.rejections.forget()
        self.control.put(q)

    def begin(self, q: Array, ready: bool) -> None:
        """Start anew with set-points at rest, (n,): ENABLED and homed, or DISABLED.

        The world puts motors and physics back.
        """
        self._abandon_homing()
        self._base, self._absolute, self._reported = None, False, None
        self._effort[:] = 0.0
        self.control.begin()
        if self.gripper is not None:
            self.gripper.forget()
        self._states.begin(ready)
        self.start_at(q)

    def save(self) -> ArmState:
        """Return copies of everything that the arm keeps beside the physics and the servos."""
        control, gripper = self.control, self.gripper
        homing = None
        if self._homing is not None:
            way = self._homing.way
            homing = self._homing.motion.goal.copy(), way.goal.copy(), way.done, way.goal_reached
        return ArmState(
            self._states.state,
            self._states.homed,
            self._reported,
            control.save(),
            copy.deepcopy(self._controllers),
            None if self._lock is None else self._lock.copy(),
            self._absolute,
            self._effort.copy(),
            None if self._base is None else (self._base[0].copy(), self._base[1]),
            homing,
            None if gripper is None else (gripper.closed, gripper.pinches, gripper.since),
            self._expiry,
        )

    def load(self, saved: ArmState) -> None:
        """Restore everything that `save` returned; handles of moves until now are over."""
        self._abandon_homing()
        self._states.state, self._states.homed = saved.state, saved.homed
        motions = self.control.load(saved.control)
        self._controllers = copy.deepcopy(saved.laws)
        self._lock = None if saved.lock is None else saved.lock.copy()
        self._absolute, self._effort = saved.absolute, saved.push.copy()
        self._base = None if saved.base is None else (saved.base[0].copy(), saved.base[1])
        if saved.homing is not None:
            goal, way_goal, done, reached = saved.homing
            way = motions[0] if motions and not done else self._over(way_goal, reached)
            kinds = [j.kind == "prismatic" for j in self.description.joints[self._own]]
            motion = Motion(goal.copy(), self._clock.wait)
            self._homing = Homing(motion, way, np.array(kinds))
        if self.gripper is not None and saved.gripper is not None:
            self.gripper.closed, self.gripper.pinches, self.gripper.since = saved.gripper
        self._reported, self._expiry = saved.told, saved.expiry

    def come_off(self) -> None:
        """End every move, controller and effort, before another tool is mounted."""
        self._stop()

    def setpoints(self) -> Array:
        """Return the set-points of every joint, the jaw included, (n,) [rad or m]."""
        return self.motors.position.copy()

    def reattach(self, motors: Motors) -> None:
        """Go on in a model that was compiled anew, with everything as it was."""
        self.motors = motors
        self.control.reattach(motors)

    def refit(self, rig_arm: RigArm, motors: Motors, q: Array, setpoint: Array) -> None:
        """Mount another tool with its motors; settings stay.

        The arm is at rest at joint positions q; its set-points are others, (n,) each.
        """
        self._fit(rig_arm, motors, self.control)
        motors.place(q, np.zeros(len(q)))
        motors.command(setpoint, np.zeros(len(q)))
        motors.apply()
        self.report_state()

    def come_to_rest(self) -> None:
        """Hold, when the set-points are on their way."""
        if self.active or self.motors.velocity.any():
            self._stop()

    def check_playable(self) -> None:
        """Reject a table of set-points while the arm accepts no commands.

        Raises:
            InputError: why it accepts none
        """
        why = self._states.why_not_ready()
        if why:
            raise InputError(f"play: {self.name}: {why}")

    def prepare_to_play(self) -> None:
        """Switch joints back from effort control, for a table of set-points."""
        self._end_controllers()
        self.control.under_position(self._all)

    def take_over(self, q: Array, v: Array, effort: Array) -> None:
        """Take over set-points that a played trajectory has written, (n,) each."""
        if self._states.powered:
            effort = effort.copy()  # it may be a view of what is put to rest
            self.control.put(q)
            self.motors.velocity[:], self.motors.effort[:] = v, effort

    # ------------------------------------------------------------------ inside

    def _ended(self, accepted: bool) -> bool:
        """End controllers after a position command that was accepted."""
        if accepted:
            if self._controllers or self._lock is not None or self._expiry is not None:
                self._end_controllers()
            self.report_state()
        return accepted

    def _accept_effort(self, accepted: bool) -> bool:
        """End controllers after an effort command that was accepted."""
        if accepted:
            self._end_controllers()
            self._effort = self.motors.effort[self._own].copy()
            self.report_state()
        return accepted

    def _begun(self, motion: Motion) -> Motion:
        self._ended(not motion.done)
        return motion

    def _may_expire(self, verb: str, timeout_s: float | None) -> bool:
        """Return whether a time-out is usable, with a warning when not."""
        number = isinstance(timeout_s, (int, float, np.number)) and not isinstance(timeout_s, bool)
        usable = timeout_s is None or (number and 0.0 < timeout_s <= LARGEST)
        if not usable:
            self.control.rejections.warn(
                f"{verb} timeout", f"{verb}: got timeout_s {timeout_s!r}; allowed: above 0, or None"
            )
        return usable

    def _expiring(self, accepted: bool, verb: str, timeout_s: float | None) -> bool:
        """Note when a set-point that was accepted ends."""
        if accepted:
            self._expiry = None
            if timeout_s is not None:
                timeout = float(timeout_s)
                self._expiry = Expiry(verb, timeout, self._clock.time + timeout)
        return accepted

    def _expire(self, expiry: Expiry) -> None:
        """End an effort or velocity set-point that nobody renewed; the jaw goes on."""
        self._stop(self._own)
        self.control.rejections.warn(
            f"{expiry.verb} timeout",
            f"{expiry.verb}: no set-point for {expiry.timeout:g} s; the arm holds where it is",
        )

    def _end_controllers(self) -> None:
        self._expiry = None
        if self._controllers:
            self._controllers.clear()
        if self._lock is not None:
            self._forget_lock()

    def _may(self, verb: str) -> bool:
        why = self._states.why_not(verb)
        if why:
            self.control.rejections.warn(f"{verb} state", f"{verb}: {why}")
        return not why

    def _over(self, q: Array, reached: bool = True) -> Motion:
        """Return the handle of a move that is over."""
        motion = Motion(q.copy(), self._clock.wait)
        motion.finish(reached)
        return motion

    def _stop(self, part: slice | None = None) -> None:
        """End what some joints (all when omitted) do; stay at the set-points, or where they were.

        Joints that were under effort control stay where they are measured.
        """
        part = self._all if part is None else part
        self._abandon_homing()
        self._end_controllers()
        self.control.under_position(part)
        self.control.moves.end(part)
        self.motors.velocity[part] = 0.0
        self.motors.follow()
        self.control.exert(np.zeros(part.stop - part.start), part, "hold")
        self.report_state()

    def _settle(self) -> None:
        """Put the set-points where the joints are measured."""
        if not self.motors.welded:
            self.control.stay(list(range(len(self.joint_names))))
            self.motors.effort[:] = 0.0

    def _switch_off(self) -> None:
        if not self._states.powered:
            return
        self._abandon_homing()
        self._end_controllers()
        self.control.under_position(self._all)
        self._settle()
        self.motors.switch(False)
        self.motors.follow()

    def _abandon_homing(self) -> None:
        homing, self._homing = self._homing, None
        if homing is not None:
            homing.motion.finish(False)
            self.control.report("goal_reached", reached=False)

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

    def _set_brakes(self, locked: bool, joints: Sequence[str] | None) -> None:
        if not self.motors.brakes:
            raise InputError(f"{self.name}: has no brakes; only setup joints do")
        self._check_movable("release its brakes")
        which = self._which(joints)
        self.control.stay(which)
        self.motors.set_brakes(locked, which)
        self.motors.follow()

    def _check_movable(self, wish: str) -> None:
        if self.motors.welded:
            raise InputError(
                f"{self.name}: is welded into the model; build the world without that to {wish}"
            )

    def _which(self, joints: Iterable[str] | None) -> list[int]:
        arm = self.motors.arm
        motors = self.joint_names[: arm.own_joints] if arm.has_gripper else self.joint_names
        which = [self._index(name) for name in (motors if joints is None else joints)]
        if any(k >= len(motors) for k in which):
            raise InputError(f"{self.name}: {self.joint_names[-1]} has no motor; squeeze it")
        return which

    def _index(self, joint: str) -> int:
        if joint not in self.joint_names:
            raise UnknownNameError("joint", joint, self.joint_names, self.name)
        return self.joint_names.index(joint)

    def _nearest(self, T: ArrayLike, verb: str) -> Array | None:
        """Solve for a pose, or warn and return None."""
        try:
            return self.inverse_kinematics(T)
        except (InputError, UnreachableError, SingularError) as problem:
            self.control.rejections.warn(f"{verb} pose", f"{verb}: {problem}")
            return None

    def _tip_state(self) -> TipState:
        """Return where the arm is, for controllers."""
        q, qd, _ = self.readings()
        return TipState(
            q[self._own],
            qd[self._own],
            self.measured_cp().T,
            self.base_frame()[0],
            self.jacobian("body"),
            self.jacobian("spatial"),
            self._clock.time,
        )

    def _in_own_frame(self, T: Array) -> Array:
        """Return a pose in the frame of `measured_cp` in the arm's reference frame, (4, 4)."""
        if self._base is not None:
            return inverse(self._base[0]).dot(T)
        return self._clock.frames.own(self.name, T, self._clock.reference_arm)

    def _jacobian(self, frame: WrenchFrame) -> Array:
        """Return J with (linear; angular) = J @ qd where the arm is, (6, n)."""
        if self._clock.frames.follows(self.name):
            return self._clock.frames.jacobian(self.name, frame)
        of = jacobian_body if frame == "body" else jacobian_spatial
        return of(self.description.mechanism, self.positions())

    def _local_pose(self, q: Array) -> Pose:
        mechanism = self.description.mechanism
        return Pose(chain_pose(mechanism)(q), mechanism.reference, self._clock.time)

    def _whole(self, q: ArrayLike) -> Array:
        """Return joint positions with the jaw's set-point behind them, (n,)."""
        whole = self.motors.position.copy()
        try:
            own = np.asarray(q, dtype=np.float64)
        except (TypeError, ValueError):
            own = np.full(0, np.nan)
        if own.shape != whole[self._own].shape or not np.isfinite(own).all():
            count = len(whole[self._own])
            raise InputError(f"{self.name}: got {q!r}; allowed: {count} finite numbers")
        whole[self._own] = own
        return whole

    def _solved(self, T: ArrayLike, verb: str) -> Array | None:
        """Return the joints of a pose, when Cartesian commands are allowed now."""
        if not self.control.ready(verb) or not self._deep_enough(verb):
            return None
        return self._nearest(T, verb)

    def _deep_enough(self, verb: str) -> bool:
        """Warn and return False while an instrument's wrist is too near its remote centre."""
        mechanism = self.description.mechanism
        if self.type != "PSM" or "wrist_pitch" not in mechanism.frame_index:
            return True
        if self._clock.frames.follows(self.name):
            depth = self._clock.frames.depth(self.name)
        else:
            q = self.positions()
            wrist = chain_pose(mechanism, "wrist_pitch")(q)[:3, 3]
            depth = float(chain_pose(mechanism, "roll")(q)[:3, 2] @ wrist)
        if depth >= SAFE_DEPTH_M:
            return True
        self.control.rejections.warn(
            f"{verb} depth",
            f"{verb}: the wrist is {1e3 * depth:.1f} mm past the remote centre; allowed from "
            f"{1e3 * SAFE_DEPTH_M:.0f} mm on; insert the instrument first",
        )
        return False

    def _run_controller(self, controller: Controller, verb: str) -> bool:
        if not self.control.ready(verb) or not self._deep_enough(verb):
            return False
        locked = (
            "lock" in self._controllers
        )  # then it is under force control, and the gimbal goes on
        self._effort = np.zeros_like(self._effort)
        if not locked and not self.control.servo_effort(self._effort, self._own, verb):
            return False
        self._expiry = None
        self._controllers["wrench"] = controller
        self._begin_master_controllers(controller)
        self._apply_controllers()
        self.report_state()
        return True

    def _apply_controllers(self) -> None:
        """Sum the efforts of all controllers and hand them to the motors."""
        now = self._tip_state()
        effort = self._effort.copy()
        for controller in tuple(self._controllers.values()):
            try:
                action = controller.act(now)
            except ControllerError as problem:
                self.fault(str(problem))
                return
            effort += action.effort
            if action.position is not None:
                self.control.steer(action.position, action.velocity, self._own)
        self.control.exert(effort, self._own, "efforts")

    def _begin_master_controllers(self, controller: Controller) -> None:
        """Let a master's platform give way and its gimbal be locked under force control.

        Under a wrench in the reference frame the platform stays, as on the dVRK.
        """
        if self.description.inverse_kinematics != GIMBAL_ARM:
            return
        self._controllers.pop("platform", None)
        if not (isinstance(controller, CartesianForce) and controller.frame == "spatial"):
            platform = self.description.joints[PLATFORM]
            self._controllers["platform"] = PlatformEffort(platform.lower, platform.upper)
        if self._lock is not None and "lock" not in self._controllers:
            self._begin_lock()

    def _begin_lock(self) -> None:
        if self._lock is None:
            return
        if "lock" not in self._controllers:
            self.control.to_position(list(range(GIMBAL.start, GIMBAL.stop)), self._own)
        joints = self.description.joints[self._own]
        limits = GimbalLimits(
            np.array([j.lower for j in joints]),
            np.array([j.upper for j in joints]),
            np.array([j.velocity_max for j in joints]),
        )
        self._controllers["lock"] = orientation_lock(
            fit_chain(self.description.mechanism, GIMBAL_ARM),
            self.base_frame()[0][:3, :3].T @ self._lock,
            self.positions()[self._own],
            limits,
            self._clock.time,
        )

    def _forget_lock(self) -> None:
        if self._lock is not None:
            self._lock = None
            self.control.report("orientation_locked", locked=False)

    def _reject(self, why: str) -> None:
        self.control.rejections.warn("lock_orientation", f"lock_orientation: {why}")
