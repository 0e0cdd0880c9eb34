"""What an arm reads out, computed from a sample outside of the loop's thread.

The numbers are those of `Arm.measured_cp` and its like; each pose is computed once per sample and
only when it is asked for.
"""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import CART, DISPLAY, ArmDescription, RigArm
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.interfaces.crtk.plan import Plan, own_base
from trocar.interfaces.crtk.sample import Sample
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.jacobian import jacobian_body, jacobian_spatial

Array = NDArray[np.float64]
#: A position x, y, z [m] and a unit quaternion w, x, y, z.
Row = tuple[list[float], list[float]]


@lru_cache(maxsize=64)
def joints_of(arm: ArmDescription) -> tuple[slice, tuple[str, ...]]:
    """Return which joints are the arm's own, and the names of all."""
    return slice(0, arm.own_joints), arm.mechanism.joint_names


def _inverse(T: Array) -> Array:
    """Invert one pose, (4, 4)."""
    found = T.T.copy()
    found[3, :3] = 0.0
    found[:3, 3] = -(found[:3, :3] @ T[:3, 3])
    return found


class RigFigures:
    """Figures of every arm of a sample.

    Args:
        sample: a world at one moment
        plan: of the sample's rig; made anew when omitted
    """

    def __init__(self, sample: Sample, plan: Plan | None = None) -> None:
        self.sample, self.plan = sample, plan or Plan(sample.rig)
        self._arms: dict[str, ArmFigures] = {}
        self._world_in_tips: dict[str, Array] = {}

    def arm(self, name: str) -> ArmFigures:
        """Return an arm's figures."""
        found = self._arms.get(name)
        if found is None:
            found = self._arms[name] = ArmFigures(self.sample.rig.arm(name), self)
        return found

    def let_go(self) -> None:
        """Forget the arms, which hold this: what holds nobody goes without a search for garbage."""
        self._arms.clear()

    @cached_property
    def poses(self) -> tuple[Array, Array]:
        """Tips and bases that the plan names, (k, 4, 4) each."""
        return self.plan.poses(self.sample.arms)

    @cached_property
    def tip_places(self) -> tuple[Array, Array]:
        """Positions (k, 3) and quaternions wxyz (k, 4) of the plan's tips.

        In their own bases first, then in the frames of their poses.
        """
        tips = self.poses[0]
        at = np.repeat(np.array([self.arm(name).base[0] for name in self.plan.tips]), 2, axis=0)
        every = np.concatenate([tips, at @ tips])
        return every[:, :3, 3], quaternion_from_matrix(every[:, :3, :3])

    @cached_property
    def object_rows(self) -> list[Row] | None:
        """Where objects are in the world; None where they were not looked at."""
        scene = self.sample.scene
        if scene is None or scene.objects is None:
            return None
        told = scene.objects
        return list(zip(told.positions.tolist(), told.quaternions.tolist(), strict=True))

    def world_in_tip(self, name: str) -> Array:
        """Return the pose of the world in the tip frame of an arm, (4, 4)."""
        found = self._world_in_tips.get(name)
        if found is None:
            arm = self.arm(name)
            found = _inverse(arm.reference_in_world @ arm.local_measured)
            self._world_in_tips[name] = found
        return found


class ArmFigures:
    """Figures of one arm at one moment."""

    def __init__(self, rig_arm: RigArm, rig: RigFigures) -> None:
        self.rig_arm, self.arm, self._rig = rig_arm, rig_arm.arm, rig
        self.name = rig_arm.name
        self.sample = rig.sample.arms[rig_arm.name]
        self.own, self.names = joints_of(rig_arm.arm)

    @property
    def own_frame(self) -> str:
        """Name of the arm's own base frame: that of local/measured_cp."""
        return self.rig_arm.own_frame

    @property
    def local_measured(self) -> Array:
        """The tip in the arm's own base frame, (4, 4)."""
        return self._tips[0]

    @cached_property
    def _tips(self) -> Array:
        """Both, which together take little longer than one, (2, 4, 4)."""
        index = self._rig.plan.tips.get(self.name)
        if index is not None:
            return self._rig.poses[0][index : index + 2]
        return chain_pose(self.arm.mechanism)(np.stack([self.sample.q, self.sample.told_q]))

    @cached_property
    def base(self) -> tuple[Array, str]:
        """The arm's own base in the frame of its poses, (4, 4), and that one's name."""
        return self.sample.base or self._placed()

    @cached_property
    def root_in_world(self) -> Array:
        """The arm's root in the world, by what carries it, (4, 4)."""
        if not self.rig_arm.on:
            return self.rig_arm.pose
        carrier = self._rig.arm(self.rig_arm.on)
        to_mount = chain_pose(carrier.arm.mechanism, self.rig_arm.frame, carrier.arm.root)
        mount = to_mount(carrier.sample.q)
        return carrier.root_in_world @ mount @ self.rig_arm.pose

    @cached_property
    def reference_in_world(self) -> Array:
        """The arm's own base in the world, (4, 4)."""
        index = self._rig.plan.bases.get(self.name)
        if index is not None:
            return self._rig.poses[1][index]
        standing = self._rig.plan.standing.get(self.name)
        return self.root_in_world @ own_base(self.arm) if standing is None else standing

    def tip_row(self, *, setpoint: bool, local: bool) -> Row:
        """Where the tip is, measured or at the set-points, in its own base or as poses are told."""
        index = self._rig.plan.tips.get(self.name)
        if index is not None:
            places, turns = self._rig.tip_places
            index += setpoint + (0 if local else len(places) // 2)
            return places[index].tolist(), turns[index].tolist()
        T = self._tips[int(setpoint)] if local else self.base[0] @ self._tips[int(setpoint)]
        return T[:3, 3].tolist(), quaternion_from_matrix(T[:3, :3]).tolist()

    @property
    def measured(self) -> Array:
        """The tip in the frame of `base`, (4, 4)."""
        return self.base[0] @ self.local_measured

    @cached_property
    def body_jacobian(self) -> Array:
        """At the tip in its axes, jaw or gripper left out, (6, n)."""
        return jacobian_body(self.arm.mechanism, self.sample.q)[:, self.own]

    @cached_property
    def spatial_jacobian(self) -> Array:
        """About the origin of the arm's own base, in its axes, (6, n)."""
        return jacobian_spatial(self.arm.mechanism, self.sample.q)[:, self.own]

    @cached_property
    def local_velocity(self) -> Array:
        """Of the tip in axes of the arm's own base: (linear; angular), (6,) [m/s, rad/s]."""
        R = self.local_measured[:3, :3]
        twist = jacobian_body(self.arm.mechanism, self.sample.q) @ self.sample.qd
        return np.concatenate([R @ twist[:3], R @ twist[3:]])

    @property
    def velocity(self) -> Array:
        """Of the tip in axes of the frame of `base`: (linear; angular), (6,) [m/s, rad/s]."""
        R = self.base[0][:3, :3]
        own = self.local_velocity
        return np.concatenate([R @ own[:3], R @ own[3:]])

    def wrench(self, jacobian: Array) -> Array:
        """Return what the motors exert beside carrying the links: (force; torque), (6,)."""
        effort = (self.sample.effort - self.sample.load)[self.own]
        return np.asarray(np.linalg.lstsq(jacobian.T, effort, rcond=1e-9)[0], dtype=np.float64)

    def _placed(self) -> tuple[Array, str]:
        """As `Places.base_pose` says."""
        rig, display = self._rig, self._rig.sample.rig.display
        if (told := self.rig_arm.base_frame) is not None:
            return told.pose, told.name
        frame = rig.plan.pose_frame(self.name, rig.sample.reference_arm)
        if frame == self.own_frame:
            return np.eye(4), frame
        if frame == DISPLAY and display is not None:
            return _inverse(display) @ self.reference_in_world, frame
        if frame == CART:
            cart = rig.arm(self.rig_arm.on).reference_in_world
            return _inverse(cart) @ self.reference_in_world, frame
        return rig.world_in_tip(frame) @ self.reference_in_world, frame
