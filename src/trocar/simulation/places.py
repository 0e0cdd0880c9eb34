"""Where the arms of a rig stand, by the measured joints of what carries them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import DISPLAY, RigDescription
from trocar.geometry.se3 import inverse
from trocar.kinematics.chain_pose import chain_pose, standing_pose
from trocar.simulation.arm import Arm

Array = NDArray[np.float64]


class Places:
    """Poses of arms in the world and in each other, as they are measured now."""

    def __init__(self, rig: RigDescription, arms: Mapping[str, Arm]) -> None:
        self._rig = rig
        self._arms = arms

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
        """Return the pose of an arm's root in the world, by its carrier's measured joints."""
        rig_arm = self._rig.arm(name)
        if not rig_arm.on:
            return rig_arm.pose
        carrier = self._rig.arm(rig_arm.on).arm
        q = self._arms[rig_arm.on].positions()
        mount = chain_pose(carrier.mechanism, rig_arm.frame, carrier.root)(q)
        return self.root_pose(rig_arm.on) @ mount @ rig_arm.pose

    def base_pose(self, name: str) -> tuple[Array, str]:
        """Return an arm's reference frame in the frame of its public poses, and that one's name.

        It is what the rig says, else: a PSM's is the ECM's tip where the rig has an ECM, an ECM's
        the cart where setup joints carry it, a master's the stereo display where the rig has one;
        else the arm's own, which is the cart for setup joints.
        """
        arm = self._rig.arm(name)
        if arm.base_frame is not None:
            return arm.base_frame.pose.copy(), arm.base_frame.name
        scope = next((a.name for a in self._rig.arms if a.arm.type == "ECM"), None)
        if arm.arm.type == "PSM" and scope is not None:
            tip = self.reference_pose(scope) @ self._arms[scope].local_measured_cp().T
            return inverse(tip) @ self.reference_pose(name), scope
        if arm.arm.type == "ECM" and arm.on:
            cart = self._rig.arm(arm.on).arm.mechanism.reference
            seen = inverse(self.reference_pose(arm.on)) @ self.reference_pose(name)
            return seen, cart
        if arm.arm.type == "MTM" and self._rig.display is not None:
            return inverse(self._rig.display) @ self.reference_pose(name), DISPLAY
        own = arm.arm.mechanism.reference if arm.arm.type == "SUJ" else f"{name}_base"
        return np.eye(4), own
