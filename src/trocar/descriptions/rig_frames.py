"""Where the arms of a rig stand, by the measured joints of what carries them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import CART, DISPLAY, RigDescription
from trocar.geometry.se3 import inverse
from trocar.kinematics.chain_pose import chain_pose, standing_pose

Array = NDArray[np.float64]


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
            reference_arm: as for `RigDescription.pose_frame`, which says which frame it is
        """
        arm = self._rig.arm(name)
        if arm.base_frame is not None:
            return arm.base_frame.pose.copy(), arm.base_frame.name
        frame = self._rig.pose_frame(name, reference_arm)
        if frame == arm.own_frame:
            return np.eye(4), frame
        if frame == DISPLAY and self._rig.display is not None:
            seen_from = self._rig.display
        elif frame == CART:
            seen_from = self.reference_pose(arm.on)
        else:
            tip = chain_pose(self._rig.arm(frame).arm.mechanism)(self._positions(frame))
            seen_from = self.reference_pose(frame) @ tip
        return inverse(seen_from) @ self.reference_pose(name), frame
