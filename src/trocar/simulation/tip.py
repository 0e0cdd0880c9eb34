"""An arm's tip as the present state has it: poses, velocity, wrench and inverse kinematics."""

from __future__ import annotations

from copy import copy
from math import degrees
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, SingularError, UnknownNameError, UnreachableError
from trocar.geometry.se3 import inverse, pose_difference
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import POSE_TOLERANCE, is_chain, nearest_solution, nearest_start
from trocar.kinematics.inverse_rcm import DIRECTION_TOLERANCE
from trocar.kinematics.jacobian import jacobian_body, jacobian_spatial
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.robot_inverse import SAFE_DEPTH_M, kept_depth, robot_solution
from trocar.kinematics.solutions import LIMIT_TOLERANCE
from trocar.simulation.control import ArmWorld, JointControl
from trocar.simulation.controllers import TipState, WrenchFrame
from trocar.simulation.journal import command
from trocar.simulation.readout import least_wrench, turned
from trocar.simulation.records import Pose, Twist, Wrench, checked_pose

Array = NDArray[np.float64]

FRAMES: tuple[WrenchFrame, ...] = ("body", "spatial")
#: Names of frames beside those of arms: the rig's own, and the endoscope's optical frame.
WORLD_FRAME, CAMERA_FRAME = "world", "camera"
#: Cartesian commands begin with the wrist this far past the remote centre [m]; no command brings it
#: nearer than `SAFE_DEPTH_M`. Source: mtsIntuitiveResearchKit.h, SafeDistanceFromRCMBuffer.
ENTRY_DEPTH_M = SAFE_DEPTH_M - 0.002
#: A goal missed by more is a warning. Source: our choice. [m or rad]
MISSED = 1e-5


class Refusal(NamedTuple):
    """The arguments of the last inverse kinematics that failed in closed form, and its error."""

    mechanism: Mechanism
    pose: bytes
    seed: bytes
    problem: UnreachableError | SingularError


class Tip:
    """Readings of an arm's tip from the present state, and the joints that bring it to a pose.

    Args:
        name: of the arm
        clock: its world

    Attributes:
        placed: base frame and its name as `set_base_frame` set them, None where it did not
        own: the arm's joints without its jaw
        reference: name of the arm's own reference frame
    """

    def __init__(self, name: str, clock: ArmWorld) -> None:
        self._name, self._clock = name, clock
        self.placed: tuple[Array, str] | None = None
        self._refused: Refusal | None = None
        self._deep = False

    def fit(self, control: JointControl) -> None:
        """Set the joints of the mounted tool."""
        self._control, self._arm = control, control.motors.arm
        self.own = slice(0, self._arm.own_joints)
        self.reference = self._arm.mechanism.reference

    # ------------------------------------------------------------------ poses

    def base_frame(self) -> tuple[Array, str]:
        """Return T (4, 4) of the arm's reference frame in the frame of its poses, and its name.

        It is the one of `RigDescription.pose_frame`, unless `set_base_frame` set another.
        """
        return self.placed or self._clock.base_pose(self._name)

    def view(self) -> tuple[int, Array, str]:
        """Return the site that public poses are seen from, its pose (4, 4) and frame.

        As `Frames.view` does.
        """
        frames = self._clock.frames
        if self.placed is not None:
            return frames.own_view(self._name), *self.placed
        return frames.view(self._name, self._clock.reference_arm)

    def measured(self, frame: str = "") -> Pose:
        """Return the measured pose, in the frame of the arm's public poses when none is named.

        Raises:
            UnknownNameError: no such frame; the known ones are listed
        """
        frames, time = self._clock.frames, self._clock.time
        if frame:
            own = self._world() if frames.follows(self._name) else self._placed_world()
            return Pose(self._seen(own, frame), frame, time)
        if self.placed is not None or not frames.follows(self._name):
            base, named = self.base_frame()
            return Pose(base @ self.local_measured().matrix, named, time)
        T, named = frames.public(self._name, self._clock.reference_arm)
        return Pose(T, named, time)

    def in_world(self) -> Pose:
        """Return the measured pose in the rig's own frame."""
        return self.measured(WORLD_FRAME)

    def setpoint(self, frame: str = "") -> Pose:
        """Return the pose at the set-points, otherwise as `measured`."""
        frames, time = self._clock.frames, self._clock.time
        if frame:
            there = frames.reference_pose(self._name) @ self.local_setpoint().matrix
            return Pose(self._seen(there, frame), frame, time)
        if self.placed is not None or not frames.follows(self._name):
            base, named = self.base_frame()
            return Pose(base @ self.local_setpoint().matrix, named, time)
        setpoint = self._control.motors.position
        T, named = frames.public_at(self._name, setpoint, self._clock.reference_arm)
        return Pose(T, named, time)

    def local_measured(self) -> Pose:
        """Return the measured pose in the arm's own reference frame (the remote centre's)."""
        frames = self._clock.frames
        if not frames.follows(self._name):
            return self.local_at(self._control.motors.positions())
        T = frames.measured(self._name)
        return Pose(T, self.reference, self._clock.time)

    def local_setpoint(self) -> Pose:
        """Return the pose at the set-points in the arm's own reference frame."""
        frames, setpoint = self._clock.frames, self._control.motors.position
        if not frames.follows(self._name):
            return self.local_at(setpoint)
        T = frames.local_at(self._name, setpoint)
        return Pose(T, self.reference, self._clock.time)

    def local_at(self, q: Array) -> Pose:
        """Return the pose at positions of every joint (n,) in the arm's own reference frame."""
        return Pose(chain_pose(self._arm.mechanism)(q), self.reference, self._clock.time)

    def whole(self, q: ArrayLike) -> Array:
        """Return joint positions with the jaw's set-point behind them, (n,).

        Raises:
            InputError: q is not one finite number for each joint without the jaw
        """
        whole = self._control.motors.position.copy()
        try:
            own = np.asarray(q, dtype=np.float64)
        except (TypeError, ValueError):
            own = np.full(0, np.nan)
        if own.shape != whole[self.own].shape or not np.isfinite(own).all():
            count = len(whole[self.own])
            raise InputError(f"{self._name}: got {q!r}; allowed: {count} finite numbers")
        whole[self.own] = own
        return whole

    # ------------------------------------------------------------------ velocities and forces

    def local_twist(self) -> Array:
        """Return (linear; angular) of the tip in axes of its own reference frame, (6,)."""
        R, qd = self.local_measured().matrix[:3, :3], self._control.motors.read()[1]
        return turned(R, self._jacobian("body").dot(qd))

    def twist(self) -> Twist:
        """Return the velocity of the tip's origin and its rotation, in axes of public poses."""
        base, frame = self.base_frame()
        found = turned(base[:3, :3], self.local_twist())
        return Twist(found[:3], found[3:], frame, self._clock.time)

    def wrench(self, frame: WrenchFrame = "body") -> Wrench:
        """Return the wrench that the motors exert at the tip, what carries the links not counted.

        The least-squares solution of tau = J^T w: exact for six joints, the smallest for fewer.

        Raises:
            InputError: no such frame
        """
        J, motors, mechanism = self.jacobian(frame), self._control.motors, self._arm.mechanism
        wrench = least_wrench(J, (motors.read()[2] - motors.load())[self.own])
        named = f"{self._name}_{mechanism.tip}" if frame == "body" else mechanism.reference
        return Wrench(wrench[:3], wrench[3:], named, self._clock.time)

    def jacobian(self, frame: WrenchFrame = "body") -> Array:
        """Return J with (linear; angular) = J @ qd where the arm is, jaw left out, (6, n).

        Raises:
            InputError: no such frame
        """
        if frame not in FRAMES:
            raise InputError(f"{self._name}: got frame {frame!r}; allowed: {', '.join(FRAMES)}")
        return self._jacobian(frame)[:, self.own]

    def state(self) -> TipState:
        """Return the present state, for controllers."""
        q, qd, _ = self._control.motors.read()
        return TipState(
            q[self.own],
            qd[self.own],
            self.measured().matrix,
            self.base_frame()[0],
            self.jacobian("body"),
            self.jacobian("spatial"),
            self._clock.time,
        )

    # ------------------------------------------------------------------ inverse kinematics

    def inverse_kinematics(
        self, T: ArrayLike, seed: ArrayLike | None = None, frame: str = ""
    ) -> Array:
        """Compute the joint positions that the robot takes for a pose, whatever the limits, (n,).

        Args:
            T: pose, (4, 4)
            seed: where the search starts, (n,) without the jaw [rad or m]; the set-points when
                omitted
            frame: that T is in: the arm's own reference frame when omitted, else that of public
                poses by its name, or another as for `measured`

        Raises:
            InputError: no pose, or an arm without a closed form
            UnknownNameError: no such frame
            UnreachableError: no solution
        """
        if not self._arm.inverse_kinematics:
            raise InputError(f"{self._name}: has no inverse kinematics")
        pose = checked_pose(self._name, T)
        start = self._control.setpoints(self.own) if seed is None else self.whole(seed)[self.own]
        if frame:
            pose = self._in_own_frame(pose, "" if frame == self.base_frame()[1] else frame)
        return self._robot_solution(pose, start)[0]

    def _robot_solution(self, local: Array, start: Array) -> tuple[Array, bool]:
        """Return `robot_solution` of a pose in the arm's own reference frame, (n,)."""
        structure, frames = self._arm.inverse_kinematics, self._clock.frames
        tolerance = DIRECTION_TOLERANCE if structure == "rcm_scope" else POSE_TOLERANCE

        def refine(q: Array) -> Array | None:
            return frames.reach(self._name, local, q, tolerance)

        follows = len(start) <= 6 and frames.follows(self._name)
        return robot_solution(
            self._arm.mechanism,
            structure,
            local,
            start,
            self._control.motors.positions(),
            refine if follows else None,
        )

    def local_inverse_kinematics(self, local: Array, start: Array) -> Array:
        """Compute the joint positions inside the limits, nearest to others, for a pose, (n,).

        Args:
            local: pose in the arm's own reference frame, (4, 4), not checked
            start: (n,) without the jaw [rad or m]

        Raises:
            UnreachableError, SingularError: no solution
        """
        structure, mechanism = self._arm.inverse_kinematics, self._arm.mechanism
        frames = self._clock.frames
        if not is_chain(mechanism, structure) and frames.follows(self._name):
            near = nearest_start(mechanism, structure, local, start)
            tolerance = DIRECTION_TOLERANCE if structure == "rcm_scope" else POSE_TOLERANCE
            found = None if near is None else frames.reach(self._name, local, near, tolerance)
            if found is not None:
                lower, upper = self._control.lower[self.own], self._control.upper[self.own]
                inside = np.clip(found, lower, upper)
                if (np.abs(found - inside) <= LIMIT_TOLERANCE).all():
                    return inside
        last = self._refused  # a policy that pushes against a limit asks again and again
        if last is not None and last.mechanism is mechanism:
            if last.pose == local.tobytes() and last.seed == start.tobytes():
                raise copy(last.problem)
            self._refused = None
        try:
            return nearest_solution(mechanism, structure, local, start)
        except (UnreachableError, SingularError) as problem:
            # a copy has no traceback, which would keep its callers' variables
            self._refused = Refusal(mechanism, local.tobytes(), start.tobytes(), copy(problem))
            raise

    def solved(self, T: ArrayLike, verb: str, frame: str = "") -> Array | None:
        """Compute the joints of a commanded pose, clipped to their limits, (n,).

        A goal that they miss is a warning, or a rejected command where limits are strict or the
        world raises. Without a solution the command is rejected with an error.

        Args:
            T: pose, (4, 4)
            verb: of the command
            frame: that T is in; that of public poses when omitted

        Returns:
            (n,) [rad or m], or None where the command is rejected

        Raises:
            UnknownNameError: no such frame
        """
        if frame:
            self.frame_pose(frame)
        control = self._control
        if not control.ready(verb) or not self.deep_enough(verb):
            return None
        try:
            if not self._arm.inverse_kinematics:
                raise InputError(f"{self._name}: has no inverse kinematics")
            local = self._in_own_frame(checked_pose(self._name, T), frame)
        except InputError as problem:
            control.rejections.reject(verb, "pose", str(problem))
            return None
        try:
            q, exact = self._robot_solution(local, control.setpoints(self.own))
        except (UnreachableError, InputError) as problem:  # none, or an arm without its tool
            control.rejections.reject(verb, "pose", str(problem), "error")
            return None
        inside = np.minimum(np.maximum(q, control.lower[self.own]), control.upper[self.own])
        if exact and inside.tolist() == q.tolist():
            return inside
        missed = self._missed(local, q, inside)
        if not missed:
            return inside
        if control.strict_limits or self._clock.on_reject == "raise":
            control.rejections.reject(verb, "strict", f"{missed}; nothing moves")
            return None
        control.rejections.warn(f"{verb} missed", f"{verb}: {missed}")
        return inside

    def _missed(self, local: Array, q: Array, inside: Array) -> str:
        """Return by how much joints, clipped from q, miss a pose in the arm's own frame, or ""."""
        whole, frames = self._control.motors.position.copy(), self._clock.frames
        whole[self.own] = inside
        follows = frames.follows(self._name)
        tip = frames.local_at(self._name, whole) if follows else self.local_at(whole).matrix
        metres, radians = (float(by) for by in pose_difference(tip, local))
        if max(metres, radians) <= MISSED:
            return ""
        names = self._control.joint_names[self.own]
        beyond = [n for n, a, b in zip(names, q.tolist(), inside.tolist(), strict=True) if a != b]
        why = f"; {', '.join(beyond)} beyond the limit" if beyond else ""
        kept = kept_depth(self._arm.mechanism, self._arm.inverse_kinematics, q)
        if kept:
            depth = f"{1e3 * kept:.0f} mm"
            why += (
                f"; the insertion stays at {depth}"
                if self._arm.type == "ECM"
                else f"; the wrist stays {depth} past the remote centre"
            )
        return f"the goal is missed by {1e3 * metres:.2f} mm and {degrees(radians):.2f} deg{why}"

    def deep_enough(self, verb: str) -> bool:
        """Reject a command while an instrument's wrist is too near its remote centre.

        Of successive commands of the tip the first counts. A move_cp that follows a move is made
        all the same, with a warning: the robot's software leaves the arm in joint space there,
        whose trajectory goes to the goal of the pose.

        Source: sawIntuitiveResearchKit 9e535e6, mtsIntuitiveResearchKitArm.cpp:1760 and :2238.
        """
        mechanism, moves = self._arm.mechanism, self._control.moves
        self._deep = True
        if moves.cartesian or self._arm.type != "PSM" or "wrist_pitch" not in mechanism.frame_index:
            return True
        if self._clock.frames.follows(self._name):
            depth = self._clock.frames.depth(self._name)
        else:
            q = self._control.motors.positions()
            wrist = chain_pose(mechanism, "wrist_pitch")(q)[:3, 3]
            depth = float(chain_pose(mechanism, "roll")(q)[:3, 2] @ wrist)
        if depth >= ENTRY_DEPTH_M:
            return True
        why = (
            f"the wrist is {1e3 * depth:.1f} mm past the remote centre; allowed from "
            f"{1e3 * ENTRY_DEPTH_M:.0f} mm on; insert the instrument first"
        )
        self._deep = False
        if verb == "move_cp" and moves.tracking and not moves.silent:
            note = "; made all the same, as on the robot, because the command before was a move"
            self._control.rejections.warn(f"{verb} depth", f"{verb}: {why}{note}")
            return True
        self._control.rejections.reject(verb, "depth", why)
        return False

    def commanded(self, accepted: bool) -> bool:
        """Note a command of the tip that was deep enough; return whether it was accepted."""
        if accepted:
            self._control.moves.cartesian = self._deep
        return accepted

    # ------------------------------------------------------------------ frames by name

    def frame_pose(self, frame: str) -> Array:
        """Return the pose of a named frame in the world, (4, 4).

        Args:
            frame: "world"; "camera": the optical frame of the endoscope on the reference arm, else
                of the rig's first; or the name of an arm: its measured tip

        Raises:
            UnknownNameError: no such frame; the known ones are listed
        """
        clock = self._clock
        if frame == WORLD_FRAME:
            return np.eye(4)
        if frame == CAMERA_FRAME:
            scopes = [c for c in clock.cameras().values() if c.kind == "endoscope"]
            scopes.sort(key=lambda scope: scope.arm != clock.reference_arm)
            if scopes:
                return scopes[0].T_world_camera
        if frame in clock.frames.arms:
            return clock.frames.tip_pose(frame)
        known = [WORLD_FRAME, *clock.frames.arms]
        if any(c.kind == "endoscope" for c in clock.cameras().values()):
            known.insert(1, CAMERA_FRAME)
        raise UnknownNameError("frame", frame, known, self._name)

    # ------------------------------------------------------------------ inside

    def _world(self) -> Array:
        return self._clock.frames.tip_pose(self._name)

    def _placed_world(self) -> Array:
        return self._clock.frames.reference_pose(self._name) @ self.local_measured().matrix

    def _seen(self, T: Array, frame: str) -> Array:
        """Return a pose in the world (4, 4) in a named frame."""
        return T if frame == WORLD_FRAME else inverse(self.frame_pose(frame)) @ T

    def _in_own_frame(self, T: Array, frame: str) -> Array:
        """Return a pose (4, 4), in a named or the public frame, in the arm's reference frame."""
        frames = self._clock.frames
        if frame:
            return inverse(frames.reference_pose(self._name)) @ self.frame_pose(frame) @ T
        if self.placed is not None:
            return inverse(self.placed[0]).dot(T)
        return frames.own(self._name, T, self._clock.reference_arm)

    def _jacobian(self, frame: WrenchFrame) -> Array:
        """Return J with (linear; angular) = J @ qd of every joint, (6, n)."""
        if self._clock.frames.follows(self._name):
            return self._clock.frames.jacobian(self._name, frame)
        of = jacobian_body if frame == "body" else jacobian_spatial
        return of(self._arm.mechanism, self._control.motors.positions())


class LocalTip:
    """An arm's tip in the arm's own reference frame, of a PSM the remote centre's: `arm.local`.

    Args:
        name: of the arm
        tip: its tip
        clock: its world
    """

    def __init__(self, name: str, tip: Tip, clock: ArmWorld) -> None:
        self._journal, self._source, self._prefix = clock.journal, name, ""
        self._tip, self._clock = tip, clock

    def measured_cp(self) -> Pose:
        """Return the tip's measured pose."""
        return self._tip.local_measured()

    def setpoint_cp(self) -> Pose:
        """Return the tip's pose at the set-points."""
        return self._tip.local_setpoint()

    def measured_cv(self) -> Twist:
        """Return the velocity of the tip's origin and its rotation [m/s, rad/s]."""
        twist = self._tip.local_twist()
        return Twist(twist[:3], twist[3:], self._tip.reference, self._clock.time)

    def forward_kinematics(self, q: ArrayLike) -> Pose:
        """Compute the tip's pose at joint positions, (n,) without the jaw [rad or m].

        Raises:
            InputError: q is not one finite number for each joint
        """
        return self._tip.local_at(self._tip.whole(q))

    def inverse_kinematics(self, T: Array, seed: Array) -> Array:
        """Compute the joint positions inside the limits, nearest to a seed, for a pose, (n,).

        Args:
            T: pose, (4, 4), not checked
            seed: (n,) without the jaw [rad or m]

        Raises:
            UnreachableError, SingularError: no solution
        """
        return self._tip.local_inverse_kinematics(T, seed)

    def base_frame(self) -> tuple[Array, str]:
        """Return T (4, 4) of this frame in the frame of `Arm.measured_cp`, and that one's name.

        It is the one of `RigDescription.pose_frame`, unless `set_base_frame` set another.
        """
        return self._tip.base_frame()

    @command
    def set_base_frame(self, T: ArrayLike | None, frame_id: str = "") -> None:
        """Set the pose of this frame in the frame of `Arm.measured_cp`.

        Args:
            T: (4, 4); None: where the rig has it, by the measured joints of what carries it
            frame_id: name of the frame that T is in; "<ARM>_base" when omitted

        Raises:
            InputError: T is no pose
        """
        placed = None
        if T is not None:
            pose = checked_pose(self._source, T).copy()
            placed = pose, frame_id or f"{self._source}_base"
        self._tip.placed = placed
