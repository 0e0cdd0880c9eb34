"""Which poses of a rig are computed together: one product for all takes as long as two alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription, RigArm, RigDescription
from trocar.kinematics.chain_pose import ChainPose, ChainPoses, chain_pose, standing_pose
from trocar.simulation.records import ArmSample

Array = NDArray[np.float64]


def own_base(arm: ArmDescription) -> Array:
    """Return the pose of an arm's reference frame in its root, (4, 4)."""
    return standing_pose(arm.mechanism, arm.mechanism.reference, arm.root)


class Plan:
    """The tips of all arms but setup joints, and the bases of arms that stand on others.

    Arms whose loops close by no ratio are left out, and what stands on them.

    Args:
        rig: the rig

    Attributes:
        rig: as given
        tips: {arm: index among poses of its tip; that at its set-points follows}
        bases: {arm: index among bases}
        standing: {arm that stands on no other: its own base in the world, (4, 4)}
    """

    def __init__(self, rig: RigDescription) -> None:
        self.rig = rig
        self._frames: dict[tuple[str, str], str] = {}
        self._told: list[tuple[str, bool]] = []
        chains: list[ChainPose] = []
        self.tips: dict[str, int] = {}
        for rig_arm in rig.arms:
            tip = chain_pose(rig_arm.arm.mechanism)
            if tip.linear and rig_arm.arm.type != "SUJ":
                self.tips[rig_arm.name] = len(chains)
                self._told += [(rig_arm.name, False), (rig_arm.name, True)]
                chains += [tip, tip]
        self._first = len(chains)
        mounts = {arm: mount for arm in rig.arms if (mount := _mount(rig, arm)) is not None}
        self.bases = {arm.name: index for index, arm in enumerate(mounts)}
        alone = (arm for arm in rig.arms if not arm.on)
        self.standing = {arm.name: arm.pose @ own_base(arm.arm) for arm in alone}
        self._told += [(arm.on, False) for arm in mounts]
        none = np.zeros((0, 4, 4))
        self._before = np.array([rig.arm(arm.on).pose for arm in mounts] or none)
        self._after = np.array([arm.pose @ own_base(arm.arm) for arm in mounts] or none)
        self._chains = ChainPoses([*chains, *mounts.values()])

    def pose_frame(self, name: str, reference_arm: str) -> str:
        """Return what the rig's `pose_frame` does, looked up once."""
        found = self._frames.get((name, reference_arm))
        if found is None:
            found = self.rig.pose_frame(name, reference_arm)
            self._frames[name, reference_arm] = found
        return found

    def poses(self, arms: Mapping[str, ArmSample]) -> tuple[Array, Array]:
        """Return tips in their arms' own bases, and own bases in the world, (k, 4, 4) each."""
        if not self._told:
            return np.zeros((0, 4, 4)), np.zeros((0, 4, 4))
        joints = [arms[arm].told_q if setpoint else arms[arm].q for arm, setpoint in self._told]
        found = self._chains(np.concatenate(joints))
        return found[: self._first], self._before @ found[self._first :] @ self._after


def _mount(rig: RigDescription, arm: RigArm) -> ChainPose | None:
    """Return where an arm stands on one that stands itself, or None."""
    if not arm.on or rig.arm(arm.on).on:
        return None
    carrier = rig.arm(arm.on).arm
    chain = chain_pose(carrier.mechanism, arm.frame, carrier.root)
    return chain if chain.linear else None
