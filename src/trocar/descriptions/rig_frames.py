"""Poses of a rig's arms, by the measured joints of the arms that carry them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import CART, DISPLAY, RigDescription
from trocar.geometry.se3 import inverse
from trocar.kinematics.chain_pose import chain_pose, standing_pose

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PoseOrigin:
    """The frame that the public poses of an arm are seen from.

    Attributes:
        frame: name of the frame that the poses are in
        arm: whose frame they are seen from; "": the world
        tip: whether it is that arm's tip, else its reference frame
        before: pose of what they are seen from in `frame`, (4, 4); None: it is that frame
    """

    frame: str
    arm: str = ""
    tip: bool = False
    before: Array | None = None

    def placed(self, T: Array) -> Array:
        """Return a pose (..., 4, 4) in `frame` that is given in what poses are seen from."""
        return T if self.before is None else self.before @ T

    def base_pose(
        self, name: str, reference: Callable[[str], Array], tip: Callable[[str], Array]
    ) -> Array:
        """Return an arm's reference frame in `frame`, (..., 4, 4).

        Args:
            name: of the arm
            reference: returns the pose of an arm's reference frame in the world, (4, 4)
            tip: returns the pose of an arm's tip in the world, (..., 4, 4)
        """
        if self.arm == name and not self.tip:
            return np.eye(4) if self.before is None else self.before.copy()
        own = reference(name)
        if self.arm:
            own = inverse((tip if self.tip else reference)(self.arm)) @ own
        return self.placed(own)


def pose_origin(rig: RigDescription, name: str, reference_arm: str) -> PoseOrigin:
    """Find the frame that the public poses of an arm are seen from.

    Args:
        rig: the arms
        name: of the arm
        reference_arm: as for `RigDescription.pose_frame`, which determines the frame
    """
    arm = rig.arm(name)
    if arm.base_frame is not None:
        return PoseOrigin(arm.base_frame.name, name, before=arm.base_frame.pose)
    frame = rig.pose_frame(name, reference_arm)
    if frame == DISPLAY and rig.display is not None:
        return PoseOrigin(frame, before=inverse(rig.display))
    if frame == arm.own_frame:
        return PoseOrigin(frame, name)
    if frame == CART:
        return PoseOrigin(frame, arm.on)
    return PoseOrigin(frame, frame, tip=True)


class Places:
    """Poses of arms in the world and in each other.

    Args:
        rig: the arms
        positions: returns the joint positions of an arm, the jaw included, (n,) [rad or m]
    """

    def __init__(self, rig: RigDescription, positions: Callable[[str], Array]) -> None:
        self._rig, self._positions = rig, positions

    def remote_centres(self) -> dict[str, Array]:
        """Return the remote centre of every arm that has one, in the world, (3,) [m]."""
        return {
            a.name: self.reference_pose(a.name)[:3, 3]
            for a in self._rig.arms
            if "rcm" in a.arm.mechanism.frame_index
        }

    def reference_pose(self, name: str) -> Array:
        """Return the pose of an arm's reference frame in the world, (4, 4)."""
        arm = self._rig.arm(name).arm
        own = standing_pose(arm.mechanism, arm.mechanism.reference, arm.root)
        return self.root_pose(name) @ own

    def root_pose(self, name: str) -> Array:
        """Return the pose of an arm's root in the world, by its carrier's joints."""
        rig_arm = self._rig.arm(name)
        if not rig_arm.on:
            return rig_arm.pose
        carrier = self._rig.arm(rig_arm.on).arm
        to_mount = chain_pose(carrier.mechanism, rig_arm.frame, carrier.root)
        mount = to_mount(self._positions(rig_arm.on))
        return self.root_pose(rig_arm.on) @ mount @ rig_arm.pose

    def base_pose(self, name: str, reference_arm: str) -> tuple[Array, str]:
        """Return an arm's reference frame in the frame of its poses, and that frame's name.

        Args:
            name: of the arm
            reference_arm: as for `RigDescription.pose_frame`
        """
        origin = pose_origin(self._rig, name, reference_arm)
        return origin.base_pose(name, self.reference_pose, self._tip), origin.frame

    def _tip(self, name: str) -> Array:
        """Return the pose of an arm's tip in the world, (4, 4)."""
        tip = chain_pose(self._rig.arm(name).arm.mechanism)(self._positions(name))
        return self.reference_pose(name) @ tip
