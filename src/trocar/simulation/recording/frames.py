"""Poses of tips as `Arm.measured_cp` tells them, from recorded positions of the joints."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import CART, RigDescription
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import pose
from trocar.simulation.drives import Drives

Array = NDArray[np.float64]
#: A body of the model and the pose of something that it carries, (4, 4).
Carrier = tuple[int, Array]


@dataclass(frozen=True, eq=False)
class Tips:
    """Tips and the frames that their poses are told in, one each per arm.

    Attributes:
        bodies: what carries tips, then frames, (2 a,)
        offsets: poses of tips, then frames, on these bodies, (2 a, 4, 4)
        frame_ids: names of the frames, (a,)
    """

    bodies: NDArray[np.intp]
    offsets: Array
    frame_ids: tuple[str, ...]

    def poses(self, model: mujoco.MjModel, data: mujoco.MjData, qpos: Array) -> Array:
        """Return position and quaternion xyzw of every tip, (m, a, 7) [m].

        Args:
            model: whose bodies these are
            data: scratch; what is in it is overwritten
            qpos: positions of the hinges, (m, nq)
        """
        at = np.zeros((len(qpos), len(self.bodies), 4, 4))
        at[:, :, 3, 3] = 1.0
        for row, place in enumerate(qpos):
            data.qpos[:] = place
            mujoco.mj_kinematics(model, data)
            at[row, :, :3, 3] = data.xpos[self.bodies]
            at[row, :, :3, :3] = data.xmat[self.bodies].reshape(-1, 3, 3)
        at = at @ self.offsets
        count = len(self.frame_ids)
        seen = inverse(at[:, count:]) @ at[:, :count]
        turned = quaternion_from_matrix(seen[..., :3, :3])
        return np.concatenate([seen[..., :3, 3], turned[..., 1:], turned[..., :1]], axis=-1)


def tips_of(
    rig: RigDescription,
    drives: Mapping[str, Drives],
    bases: Mapping[str, tuple[Array, str]],
    chosen: Collection[str],
) -> Tips:
    """Return the tips of a rig's arms.

    Args:
        rig: the arms
        drives: of each arm
        bases: {arm: (its reference frame in the frame of its public poses, that one's name)} now
        chosen: arms whose user said what that pose is: it does not change then
    """
    carriers = _Carriers(rig, drives)
    tips = [carriers.of(a.name, a.arm.mechanism.tip) for a in rig.arms]
    frames = [
        carriers.fixed(a.name, bases[a.name][0])
        if a.name in chosen
        else carriers.base(a.name, *bases[a.name])
        for a in rig.arms
    ]
    return Tips(
        np.array([body for body, _ in tips + frames], np.intp),
        np.stack([offset for _, offset in tips + frames]),
        tuple(bases[a.name][1] for a in rig.arms),
    )


class _Carriers:
    """Finds the body that carries a frame, down the arm and what it is mounted on."""

    def __init__(self, rig: RigDescription, drives: Mapping[str, Drives]) -> None:
        self._rig, self._drives = rig, drives

    def of(self, name: str, frame: str) -> Carrier:
        """Return what carries a frame of an arm."""
        rig_arm = self._rig.arm(name)
        mechanism, drives = rig_arm.arm.mechanism, self._drives[name]
        bodies = {} if drives.welded else drives.binding.frame_bodies
        for above in reversed([mechanism.frames[i].name for i in mechanism.chain(frame)]):
            if above in bodies:
                return bodies[above], pose(mechanism, self._still(name), frame, above)
        fixed = pose(mechanism, self._still(name), frame, rig_arm.arm.root)
        if not rig_arm.on:
            return 0, rig_arm.pose @ fixed
        body, offset = self.of(rig_arm.on, rig_arm.frame)
        return body, offset @ rig_arm.pose @ fixed

    def base(self, name: str, base: Array, frame_id: str) -> Carrier:
        """Return what carries the frame that an arm's poses are told in."""
        if frame_id in self._drives:
            return self.of(frame_id, self._rig.arm(frame_id).arm.mechanism.tip)
        rig_arm = self._rig.arm(name)
        if frame_id == CART and rig_arm.on:
            return self.of(rig_arm.on, self._rig.arm(rig_arm.on).arm.mechanism.reference)
        return self.fixed(name, base)

    def fixed(self, name: str, base: Array) -> Carrier:
        """Return what carries a frame in which an arm's reference frame stays where it is."""
        body, reference = self.of(name, self._rig.arm(name).arm.mechanism.reference)
        return body, reference @ inverse(base)

    def _still(self, name: str) -> Array:
        """Return positions that a fixed offset does not depend on, or where a welded arm is."""
        drives = self._drives[name]
        if drives.welded:
            return self._rig.poses["start"][name]
        return np.zeros(len(self._rig.arm(name).arm.joints))
