"""What an arm reads out: joints, poses, twists, wrenches, Jacobians."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry.se3 import adjoint, check_transform, inverse
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import inverse_kinematics
from trocar.kinematics.jacobian import jacobian_body, jacobian_spatial
from trocar.simulation.controllers import TipState, WrenchFrame
from trocar.simulation.drives import Drives
from trocar.simulation.health import arm_health
from trocar.simulation.homing import Homing
from trocar.simulation.records import ArmHealth, ArmSnapshot, JointState, Pose, Twist, Wrench
from trocar.simulation.states import OperatingState, States
from trocar.simulation.verbs import Clock, Verbs

Array = NDArray[np.float64]
#: Index of the wrist platform of a gimbal arm: its angle is free and stays where it is.
PLATFORM = 3
FRAMES: tuple[WrenchFrame, ...] = ("body", "spatial")


class Readings:
    """The part of an arm that only looks; `Arm` adds the verbs.

    Attributes:
        name: "PSM1", ...
        description: the arm with its tool
        joint_names: every joint, the jaw last where there is one
    """

    name: str
    description: ArmDescription
    joint_names: tuple[str, ...]
    _clock: Clock
    _verbs: Verbs
    _drives: Drives
    _own: slice
    _base: tuple[Array, str] | None
    _states: States
    _homing: Homing | None
    _told: OperatingState | None

    # ------------------------------------------------------------------ state

    def operating_state(self) -> OperatingState:
        """Return the state as CRTK has it."""
        busy = self.busy or self._homing is not None
        return OperatingState(self._states.state, self._states.homed, busy, self._clock.time)

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

    @property
    def tool(self) -> str:
        """Name of the mounted tool, "" without one."""
        return self.description.tool

    # ------------------------------------------------------------------ joints

    def measured_js(self) -> JointState:
        """Return measured positions, velocities and efforts, jaw or gripper not included."""
        return self._verbs.state(self._own, setpoint=False)

    def setpoint_js(self) -> JointState:
        """Return the set-points that the servos follow, the jaw not included."""
        return self._verbs.state(self._own, setpoint=True)

    def positions(self) -> Array:
        """Return measured positions of every joint, the jaw included, (n,) [rad or m]."""
        return self._verbs.positions()

    def readings(self) -> tuple[Array, Array, Array]:
        """Return (positions, velocities, efforts) of every joint, the jaw included, (n,) each."""
        return self._verbs.readings()

    def frame_coordinates(self) -> Array:
        """Return every frame's own coordinate, with the loops as they gape, (n_frames,)."""
        return self._drives.frame_coordinates()

    def health(self) -> ArmHealth:
        """Return how well the arm's loops hold now."""
        return arm_health(self.description, self._drives.frame_coordinates())

    def snapshot(self, remote_centre: Array | None) -> ArmSnapshot:
        """Return a frozen copy of everything about this arm."""
        q, qd, effort = self.readings()
        told = self._verbs.setpoints.position.copy()
        if self.description.has_gripper and self._drives.modes[-1] == "effort":
            told[-1] = q[-1]  # nothing holds its levers
        return ArmSnapshot(
            self.joint_names,
            q,
            qd,
            effort,
            told,
            tuple(self._drives.modes),
            tuple(bool(v) for v in self._drives.locked),
            self.busy,
            remote_centre,
            self.warnings,
            self.last_warning,
            self._states.state,
            self._states.homed,
            self.tool,
        )

    # ------------------------------------------------------------------ tip

    def base_frame(self) -> tuple[Array, str]:
        """Return T (4, 4) of the arm's reference frame in the frame of its poses, and its name.

        It is the one of `RigDescription.pose_frame`, unless `set_base_frame` set another.
        """
        return self._base or self._clock.base_pose(self.name)

    def measured_cp(self) -> Pose:
        """Return the tip's pose, a PSM's in the ECM's frame where there is one."""
        base, frame = self.base_frame()
        return Pose(base @ self.local_measured_cp().T, frame, self._clock.time)

    def setpoint_cp(self) -> Pose:
        """Return the pose of the tip at the set-points, in the frame of `measured_cp`."""
        base, frame = self.base_frame()
        return Pose(base @ self.local_setpoint_cp().T, frame, self._clock.time)

    def local_measured_cp(self) -> Pose:
        """Return the tip's pose in the arm's own reference frame (the remote centre's)."""
        return self._local_pose(self.positions())

    def local_setpoint_cp(self) -> Pose:
        """Return the pose of the tip at the set-points in the arm's own reference frame."""
        return self._local_pose(self._verbs.setpoints.position)

    def measured_cv(self) -> Twist:
        """Return the velocity of the tip's origin and its rotation, in axes of `measured_cp`."""
        base, frame = self.base_frame()
        own = self.local_measured_cv()
        R = base[:3, :3]
        return Twist(R @ own.linear, R @ own.angular, frame, own.time)

    def local_measured_cv(self) -> Twist:
        """Return the same in axes of the arm's own reference frame [m/s, rad/s]."""
        q, qd, _ = self.readings()
        mechanism = self.description.mechanism
        twist = jacobian_body(mechanism, q) @ qd
        R = chain_pose(mechanism)(q)[:3, :3]
        return Twist(R @ twist[:3], R @ twist[3:], mechanism.reference, self._clock.time)

    def measured_cf(self, frame: WrenchFrame = "body") -> Wrench:
        """Return the wrench that the motors exert at the tip, what carries the links not counted.

        The least-squares solution of tau = J^T w: exact for six joints, the smallest for fewer.

        Args:
            frame: "body": at the tip in its axes; "spatial": about the reference frame's origin

        Raises:
            InputError: no such frame
        """
        J = self.jacobian(frame)
        effort = (self.readings()[2] - self._drives.load())[self._own]
        wrench = np.asarray(np.linalg.lstsq(J.T, effort, rcond=1e-9)[0], dtype=np.float64)
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
        of = jacobian_body if frame == "body" else jacobian_spatial
        return of(self.description.mechanism, self.positions())[:, self._own]

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
        wanted = check_transform(T)
        if wanted.shape != (4, 4):
            raise InputError(f"{self.name}: got a pose of shape {wanted.shape}; allowed: (4, 4)")
        start = self._verbs.told(self._own) if seed is None else self._whole(seed)[self._own]
        found = inverse_kinematics(
            self.description.mechanism,
            structure,
            inverse(self.base_frame()[0]) @ wanted,
            start,
            platform_angle=float(start[PLATFORM]) if structure == "gimbal_arm" else None,
        )
        return found[0]

    def _nearest(self, T: ArrayLike, verb: str) -> Array | None:
        """Solve for a pose, or warn and return None."""
        try:
            return self.inverse_kinematics(T)
        except (InputError, UnreachableError, SingularError) as problem:
            self._verbs.refusals.warn(f"{verb} pose", f"{verb}: {problem}")
            return None

    def _tip_state(self) -> TipState:
        """Return where the arm is, for periodic laws."""
        q, qd, _ = self.readings()
        mechanism = self.description.mechanism
        base, tip = self.base_frame()[0], chain_pose(mechanism)(q)
        spatial = jacobian_spatial(mechanism, q)[:, self._own]
        return TipState(
            q[self._own],
            qd[self._own],
            base @ tip,
            base,
            adjoint(inverse(tip)) @ spatial,
            spatial,
        )

    def _local_pose(self, q: Array) -> Pose:
        mechanism = self.description.mechanism
        return Pose(chain_pose(mechanism)(q), mechanism.reference, self._clock.time)

    def _whole(self, q: ArrayLike) -> Array:
        """Return joint positions with the jaw's set-point behind them, (n,)."""
        whole = self._verbs.setpoints.position.copy()
        try:
            own = np.asarray(q, dtype=np.float64)
        except (TypeError, ValueError):
            own = np.full(0, np.nan)
        if own.shape != whole[self._own].shape or not np.isfinite(own).all():
            count = len(whole[self._own])
            raise InputError(f"{self.name}: got {q!r}; allowed: {count} finite numbers")
        whole[self._own] = own
        return whole
