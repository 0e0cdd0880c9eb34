"""Gravity compensation by coefficients: the chains of an arm's controller, as a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigArm, RigDescription
from trocar.descriptions.rig_frames import Places
from trocar.geometry.dh import modified_dh
from trocar.geometry.rotations import quaternion_from_matrix, rotation_x

Array = NDArray[np.float64]

#: Mass and inertia of links without, since MuJoCo needs some of what moves. [kg, kg m^2]
LEAST = 1e-12


@dataclass(frozen=True, eq=False)
class GravityModel:
    """The chains that controllers compute gravity compensation from, each on a base at rest.

    Attributes:
        mj: compiled, with nothing but hinges, slides and masses
        couple: coordinates = couple @ q, (nv, J)
        rows: joints whose compensation it is, (J,) bool
    """

    mj: mujoco.MjModel
    couple: Array
    rows: NDArray[np.bool_]

    @property
    def digested(self) -> bytes:
        """All numbers that efforts depend on."""
        mj = self.mj
        fields = mj.body_mass, mj.body_ipos, mj.body_pos, mj.body_quat, self.couple
        return b"".join(np.ascontiguousarray(field).tobytes() for field in fields)


def gravity_model(
    rig: RigDescription, names: tuple[str, ...], rows: Mapping[str, slice]
) -> GravityModel | None:
    """Compile the chains of a rig's controllers, None where none has one.

    Args:
        rig: its description
        names: joints in the order of its table, "PSM1/yaw", ...
        rows: {arm: its joints among them}
    """
    moving = {name for name, own in rows.items() if own.start != own.stop}
    arms = [arm for arm in rig.arms if arm.arm.gravity_links and arm.name in moving]
    if not arms:
        return None
    spec = mujoco.MjSpec()
    spec.compiler.boundmass = spec.compiler.boundinertia = LEAST
    couple: list[Array] = []
    own = np.zeros(len(names), np.bool_)
    for arm in arms:
        own[rows[arm.name]] = True
        body = spec.worldbody.add_body(quat=quaternion_from_matrix(_upright(rig, arm)))
        for link in arm.arm.gravity_links:
            at = modified_dh(link.a, link.alpha, link.d, link.theta)
            body = body.add_body(pos=at[:3, 3], quat=quaternion_from_matrix(at[:3, :3]))
            body.explicitinertial = True
            body.mass, body.ipos, body.inertia = link.mass, link.com, [LEAST] * 3
            if link.motion == "fixed":
                continue
            slides = link.motion == "prismatic"
            body.add_joint(
                type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
                axis=[0.0, 0.0, 1.0],
            )
            ratios = {f"{arm.name}/{joint}": ratio for joint, ratio in link.q.items()}
            couple.append(np.array([ratios.get(name, 0.0) for name in names]))
    return GravityModel(spec.compile(), np.array(couple), own)


def _upright(rig: RigDescription, arm: RigArm) -> Array:
    """Return the turn of an arm's root from upright as its controller has it, (3, 3).

    Source: SAW, mtsIntuitiveResearchKitArm.cpp:942: gravity is 9.81 (0, sin p, cos p) with the
    mounting pitch p.
    """
    if arm.mounting_pitch is not None:
        return rotation_x(arm.mounting_pitch)
    return Places(rig, lambda name: rig.poses["start"][name]).root_pose(arm.name)[:3, :3]
