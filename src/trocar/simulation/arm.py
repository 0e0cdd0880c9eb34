"""An arm in time: the dVRK's states, verbs and readings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import ArmDescription, RigArm
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.se3 import transform
from trocar.simulation.control import ArmWorld, Rejections
from trocar.simulation.forces import Expiry, TipForces
from trocar.simulation.jaw import Gripper, Jaw
from trocar.simulation.joints import ArmJoints, Brakes
from trocar.simulation.journal import command
from trocar.simulation.motors import Motors
from trocar.simulation.moves import Motion
from trocar.simulation.operating_state import STATE_COMMANDS, OperatingState
from trocar.simulation.records import JointState, Pose, Twist, checked_pose
from trocar.simulation.runtime import ArmRuntime, ArmState
from trocar.simulation.tip import SAFE_DEPTH_M, LocalTip

__all__ = ["SAFE_DEPTH_M", "STATE_COMMANDS", "Arm", "ArmState", "Expiry"]

Array = NDArray[np.float64]


#: {verb in the journal: path of its method from the arm}, of those that parts of the arm have.
VERBS: Mapping[str, str] = {
    **{
        name: f"runtime.states.{name}"
        for name in ("state_command", "enable", "disable", "home", "unhome", "pause", "resume")
    },
    **{
        name: f"forces.{name}"
        for name in (
            "servo_cf",
            "servo_ci",
            "set_cf_orientation_absolute",
            "use_controller",
            "lock_orientation",
            "unlock_orientation",
        )
    },
    **{
        name: f"joints.{name}"
        for name in (
            "set_mode",
            "set_gains",
            "use_gravity_compensation",
            "use_computed_torque",
            "use_strict_limits",
            "move_again",
            "set_trajectory_ratio",
        )
    },
    "release_brakes": "brakes.release",
    "lock_brakes": "brakes.lock",
    "set_base_frame": "local.set_base_frame",
    "set_tool_type": "runtime.set_tool_type",
}


class Arm:
    """One arm of a rig. Commands that cannot be used are rejected with a warning; nothing moves.

    Where the world's `on_reject` is "raise" they raise a `RejectedError` instead.

    Attributes:
        name: "PSM1", ...
        joints: limits, readings of every joint and settings of the servos
        local: the tip in the arm's own reference frame (of a PSM the remote centre's)
        body, spatial: wrenches and Jacobian at the tip, and about the reference frame's origin
        forces: controllers that exert efforts; the lock of a master's gimbal
        brakes: {joint: whether its brake is locked}, empty without brakes
        rejections: number of rejected and clipped commands, and the last reason
        runtime: the parts behind it, which its world steps
    """

    _verbs = VERBS

    def __init__(self, rig_arm: RigArm, motors: Motors, clock: ArmWorld) -> None:
        self.name = self._source = rig_arm.name
        self._journal, self._prefix = clock.journal, ""
        run = self.runtime = ArmRuntime(rig_arm, motors, clock)
        self.rejections: Rejections = run.control.rejections
        self.joints, self.brakes = ArmJoints(run), Brakes(run)
        self.local = LocalTip(self.name, run.tip, clock)
        self.forces = run.forces
        self.body = TipForces(run.forces, run.tip, "body")
        self.spatial = TipForces(run.forces, run.tip, "spatial")

    def __repr__(self) -> str:
        """Name the arm and its tool, with its operating state and measured joint positions."""
        described = self.description
        tool = f" with {described.tool}" if described.tool else ""
        q = ", ".join(
            f"{joint} {value + 0.0:.4g}"
            for joint, value in zip(
                self.joints.names, self.joints.positions().round(5), strict=True
            )
        )
        return f"<Arm {self.name!r}: {described.type}{tool}, {self.operating_state().state}; {q}>"

    @property
    def description(self) -> ArmDescription:
        """The arm with its tool."""
        return self.runtime.description

    @property
    def jaw(self) -> Jaw | None:
        """The jaw's own verbs, None without one."""
        return self.runtime.jaw

    @property
    def gripper(self) -> Gripper | None:
        """A master's gripper, None without one."""
        return self.runtime.gripper

    # ------------------------------------------------------------------ joint commands

    @command
    def servo_jp(self, q: ArrayLike, v: ArrayLike | None = None) -> bool:
        """Set the servos' positions now, the jaw not included.

        Args:
            q: (n,) [rad or m]; beyond a limit it is clipped with a warning
            v: (n,) [rad/s or m/s], zero when omitted

        Returns:
            whether the command was accepted
        """
        run = self.runtime
        return run.ended(run.control.servo(q, v, run.own, "servo_jp"))

    @command
    def servo_jr(self, dq: ArrayLike) -> bool:
        """Add to the set-points now, (n,) [rad or m]; return whether it was accepted."""
        run = self.runtime
        return run.ended(run.control.servo_relative(dq, run.own, "servo_jr"))

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
        run = self.runtime
        if not run.forces.may_expire("servo_jv", timeout_s):
            return False
        accepted = run.ended(run.control.servo_velocity(v, run.own, "servo_jv"))
        return run.forces.expiring(accepted, "servo_jv", timeout_s)

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
        run = self.runtime
        if not run.forces.may_expire("servo_jf", timeout_s):
            return False
        accepted = run.control.servo_effort(effort, run.own, "servo_jf")
        return run.forces.expiring(run.forces.accept(accepted), "servo_jf", timeout_s)

    @command
    def move_jp(self, q: ArrayLike) -> Motion:
        """Move the set-points to a goal within velocity and acceleration limits.

        Args:
            q: (n,) [rad or m], the jaw not included; beyond a limit it is clipped with a warning
        """
        run = self.runtime
        return run.begun(run.control.move(q, run.own, "move_jp"))

    @command
    def move_jr(self, dq: ArrayLike) -> Motion:
        """Move on by (n,) [rad or m] from the goal of the move under way, or the set-points."""
        run = self.runtime
        return run.begun(run.control.move_relative(dq, run.own, "move_jr"))

    @command
    def move_to(self, name: str) -> Motion:
        """Move every joint, the jaw too, to a named pose.

        Raises:
            UnknownNameError: no such pose; the known ones are listed
        """
        run = self.runtime
        if name not in run.poses:
            raise UnknownNameError("pose", name, run.poses, self.name)
        moved = run.control.moves.joints
        return run.begun(run.control.move(run.poses[name][moved], moved, "move_to"))

    @command
    def hold(self) -> None:
        """End every move and controller, and stay at the set-points."""
        if self.runtime.control.ready("hold"):
            self.runtime.states.stop()

    @command
    def free(self) -> bool:
        """Exert nothing but gravity compensation, until the next command; the jaw holds."""
        run = self.runtime
        zero = np.zeros(run.description.own_joints)
        return run.forces.accept(run.control.servo_effort(zero, run.own, "free"))

    # ------------------------------------------------------------------ tip commands

    @command
    def servo_cp(self, T: ArrayLike, frame: str = "") -> bool:
        """Bring the tip to a pose (4, 4) now, as near as the joints' limits let it.

        Streamed, it slides along them. A goal that is missed is a warning, by how much, or a
        rejected command with strict limits.

        Args:
            T: pose, in the frame of `measured_cp` when none is named
            frame: as for `measured_cp`, at its present pose

        Returns:
            whether the command was accepted

        Raises:
            UnknownNameError: no such frame; the known ones are listed
        """
        run = self.runtime
        q = run.tip.solved(T, "servo_cp", frame)
        accepted = q is not None and run.control.servo(q, None, run.own, "servo_cp")
        return run.tip.commanded(run.ended(accepted))

    @command
    def servo_cr(self, T: ArrayLike) -> bool:
        """Move the tip from its set-point by a translation and a rotation, (4, 4), now.

        Both in axes of the frame of `measured_cp`: p + dp, dR @ R.
        """
        run = self.runtime
        try:
            change = checked_pose(self.name, T)
        except InputError as problem:
            run.control.rejections.reject("servo_cr", "pose", str(problem))
            return False
        goal = run.tip.setpoint().matrix
        goal = transform(change[:3, :3] @ goal[:3, :3], goal[:3, 3] + change[:3, 3])
        q = run.tip.solved(goal, "servo_cr")
        accepted = q is not None and run.control.servo(q, None, run.own, "servo_cr")
        return run.tip.commanded(run.ended(accepted))

    @command
    def move_cp(self, T: ArrayLike, frame: str = "") -> Motion:
        """Move to a pose (4, 4), as near as limits let it: solved once, then joint by joint.

        Args:
            T: pose, in the frame of `measured_cp` when none is named
            frame: as for `measured_cp`, at its present pose

        Raises:
            UnknownNameError: no such frame; the known ones are listed
        """
        run = self.runtime
        q = run.tip.solved(T, "move_cp", frame)
        if q is None:
            if run.control.states.ready:
                run.control.report("goal_reached", reached=False)
            return run.control.rejected(run.own)
        motion = run.begun(run.control.move(q, run.own, "move_cp"))
        run.tip.commanded(not motion.reason)
        return motion

    # ------------------------------------------------------------------ states

    def enable(self) -> bool:
        """Switch the motors of a DISABLED arm on; it holds its position until it is homed.

        A fault is left by `disable`, as on the robot: `enable` changes nothing there.
        """
        return self.runtime.states.enable()

    def disable(self) -> bool:
        """End everything and switch the motors off; the arm is held in its position."""
        return self.runtime.states.disable()

    def home(self) -> Motion:
        """Bring an arm that was enabled to its home pose, with its jaw.

        The motion is over when the joints are measured there; if they are not within two seconds,
        the arm is in FAULT. An arm that is home already stays as it is, moving or not; so does one
        that was unhomed, which has to be disabled and enabled first.
        """
        return self.runtime.states.home()

    def state_command(self, name: str) -> bool:
        """Execute "enable", "disable", "home", "unhome", "pause" or "resume".

        The robot's states decide whether it is accepted, and `desired_state` follows.

        Returns:
            whether it was accepted
        """
        return self.runtime.states.state_command(name)

    def operating_state(self) -> OperatingState:
        """Return the state as CRTK has it."""
        return self.runtime.states.operating_state()

    # ------------------------------------------------------------------ readings

    def measured_js(self) -> JointState:
        """Return measured positions, velocities and efforts, jaw or gripper not included."""
        return self.runtime.control.measured(self.runtime.own)

    def setpoint_js(self) -> JointState:
        """Return the set-points that the servos follow, the jaw not included."""
        return self.runtime.control.setpoint(self.runtime.own)

    def measured_jp(self) -> Array:
        """Return the positions of `measured_js`, (n,) [rad or m]."""
        return self.measured_js().position

    def measured_jv(self) -> Array:
        """Return the velocities of `measured_js`, (n,) [rad/s or m/s]."""
        return self.measured_js().velocity

    def measured_jf(self) -> Array:
        """Return the efforts of `measured_js`, (n,) [N m or N]."""
        return self.measured_js().effort

    def setpoint_jp(self) -> Array:
        """Return the positions of `setpoint_js`, (n,) [rad or m]."""
        return self.setpoint_js().position

    def measured_cp(self, frame: str = "") -> Pose:
        """Return the tip's pose, a PSM's in the ECM's frame where there is one.

        Args:
            frame: another frame: "world"; "camera", the optical frame of the endoscope on the
                reference arm, else of the rig's first, as `World.camera` has it; or the name of an
                arm, for its measured tip

        Raises:
            UnknownNameError: no such frame; the known ones are listed
        """
        return self.runtime.tip.measured(frame)

    def setpoint_cp(self, frame: str = "") -> Pose:
        """Return the pose of the tip at the set-points, in a frame as `measured_cp`.

        Raises:
            UnknownNameError: no such frame; the known ones are listed
        """
        return self.runtime.tip.setpoint(frame)

    def measured_cv(self) -> Twist:
        """Return the velocity of the tip's origin and its rotation, in axes of `measured_cp`."""
        return self.runtime.tip.twist()

    # ------------------------------------------------------------------ kinematics

    def forward_kinematics(self, q: ArrayLike) -> Pose:
        """Compute the tip's pose at joint positions, (n,) without the jaw, as `measured_cp`.

        Raises:
            InputError: no (n,) finite numbers
        """
        base, frame = self.local.base_frame()
        pose = self.local.forward_kinematics(q)
        return Pose(base @ pose.matrix, frame, pose.time)

    def inverse_kinematics(
        self, T: ArrayLike, seed: ArrayLike | None = None, frame: str = ""
    ) -> Array:
        """Compute the joint positions that the robot takes for a pose, whatever the limits, (n,).

        Args:
            T: pose, (4, 4)
            seed: where the search starts, (n,) without the jaw [rad or m]; the set-points when
                omitted
            frame: that T is in: the arm's own reference frame (`Arm.local`'s) when omitted, as on
                the dVRK; the `frame_id` of `measured_cp`, or another as for `measured_cp`

        Raises:
            InputError: no pose, or an arm without a closed form
            UnknownNameError: no such frame
            UnreachableError: no solution
        """
        return self.runtime.tip.inverse_kinematics(T, seed, frame)
