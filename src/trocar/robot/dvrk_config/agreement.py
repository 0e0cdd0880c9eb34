"""Compare an imported rig with the files that it came from.

The files' side is computed from their rows alone, the rig's side from the TOML that was written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.records import bend
from trocar.descriptions import RigDescription
from trocar.descriptions.rig_frames import Places
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import pose
from trocar.robot.dvrk_config.arms import largest_gap, last_row
from trocar.robot.dvrk_config.setup_joints import CART
from trocar.robot.dvrk_config.system import DhRows, Lab, LabArm, SetupArm

Array = NDArray[np.float64]

#: Rotation from the tip of an endoscope (x left, y up, z ahead) to its image (x right, y down, z
#: ahead).
T_TIP_IMAGE = transform(rotation_z(np.pi), np.zeros(3))


@dataclass(frozen=True)
class Gap:
    """Largest differences of one kind of pose or limit over random joint positions.

    Attributes:
        count: of how many arms the files have it
        metres, radians: the largest differences
    """

    count: int
    metres: float
    radians: float


def agreement(lab: Lab, rig: RigDescription, count: int = 20) -> dict[str, Gap]:
    """Compare a rig with the files, at random positions of all joints.

    Returns:
        "bases" of arms on the cart or in their base_frame; "chains" in the arms' bases; "tips",
        measured with endoscope or instrument, likewise; "cameras" against the endoscopes' tips;
        "setup_joints", their measured_cp and local/measured_cp; "limits" of joints
    """
    rng = np.random.default_rng(0)
    placed = {arm.name: arm.arm for arm in rig.arms}
    arms = [arm for arm in lab.arms if arm.name in placed]
    setups = {setup.name: setup for setup in lab.setup}
    found: dict[str, dict[str, list[Array]]] = {
        kind: {} for kind in ("bases", "chains", "tips", "cameras", "setup_joints", "limits")
    }

    def note(kind: str, name: str, gap: Array) -> None:
        found[kind].setdefault(name, []).append(gap)

    for arm in arms:
        if arm.chain is not None:
            note("limits", arm.name, _limit_gap(arm.chain, rig, arm.name))
    cameras = {camera.arm: camera for camera in rig.cameras if camera.kind == "endoscope"}
    for arm in arms:
        if arm.endoscope is not None:
            image = cameras[arm.name].pose @ bend(cameras[arm.name].angle)
            expected = arm.endoscope.T_row_tip @ T_TIP_IMAGE
            note("cameras", arm.name, largest_gap(image, expected))
    for _ in range(count):
        q = {
            name: rng.uniform(arm.mechanism.lower, arm.mechanism.upper)
            for name, arm in placed.items()
        }
        places = Places(rig, q.__getitem__)
        for arm in arms:
            own, at = placed[arm.name], q[arm.name]
            if arm.carrier or arm.frame:
                note("bases", arm.name, _base_gap(arm, setups, places, rig.reference_arm, q))
            if arm.chain is not None:
                end = arm.chain.tip(at[: arm.chain.moving])
                note("chains", arm.name, largest_gap(last_row(own, at), end))
            if arm.endoscope is not None or arm.instrument is not None:
                gap = largest_gap(pose(own.mechanism, at), _tip(arm, rig, at))
                note("tips", arm.name, gap)
        for setup in lab.setup:
            if setup.chain is None:
                continue
            name = f"SUJ_{setup.name}"
            local = pose(placed[name].mechanism, q[name])
            frame, _ = places.base_pose(name, rig.reference_arm)
            note("setup_joints", name, largest_gap(local, setup.base(q[name])))
            published = _published(setup, lab, rig, q)
            note("setup_joints", name, largest_gap(frame @ local, published))
    return {kind: _largest(by_name) for kind, by_name in found.items()}


def _largest(by_name: Mapping[str, list[Array]]) -> Gap:
    gaps = [gap for each in by_name.values() for gap in each]
    metres, radians = np.max([np.zeros(2), *gaps], axis=0).tolist()
    return Gap(len(by_name), metres, radians)


def _limit_gap(chain: DhRows, rig: RigDescription, name: str) -> Array:
    """Compute the largest differences of joint limits from those of the rows, (2,) [m, rad]."""
    gap, rows = np.zeros(2), [row for row in chain.rows if row.moves]
    for row, joint in zip(rows, rig.arm(name).arm.joints, strict=False):
        for given, own in ((row.qmin, joint.lower), (row.qmax, joint.upper)):
            turns = int(row.type == "revolute")
            gap[turns] = max(gap[turns], 0.0 if given is None else abs(given - own))
    return gap


def _tip(arm: LabArm, rig: RigDescription, q: Array) -> Array:
    """Return the tip of an arm in its base as its files have it, (4, 4).

    What no file has is the rig's own: the rows of an arm, and an instrument.
    """
    own = rig.arm(arm.name).arm
    row = last_row(own, q) if arm.chain is None else arm.chain.tip(q[: arm.chain.moving])
    if arm.endoscope is not None:
        return row @ arm.endoscope.T_row_tip
    if arm.instrument is not None:
        tool = DhRows("modified", arm.instrument.rows[:3])
        return row @ tool.tip(q[own.own_joints - 3 : own.own_joints]) @ arm.instrument.tip
    return pose(own.mechanism, q)


def _base_gap(
    arm: LabArm,
    setups: Mapping[str, SetupArm],
    places: Places,
    reference_arm: str,
    q: Mapping[str, Array],
) -> Array:
    """Compute the difference of an arm's base from the file's, (2,) [m, rad]."""
    if arm.pose is not None:
        return largest_gap(places.base_pose(arm.name, reference_arm)[0], arm.pose)
    setup = setups.get(arm.carrier)
    if setup is None or (setup.chain is None and setup.fixed is None):
        return np.zeros(2)
    on_cart = inverse(
        transform(np.eye(3), np.array(CART[setup.generation]))
    ) @ places.reference_pose(arm.name)
    return largest_gap(on_cart, setup.base(q.get(f"SUJ_{setup.name}", np.zeros(0))))


def _published(setup: SetupArm, lab: Lab, rig: RigDescription, q: Mapping[str, Array]) -> Array:
    """Return measured_cp of setup joints as the dVRK computes it from its files, (4, 4).

    It is the carried arm's base, in the tip frame of the arm on the setup joints of the reference
    arm but for these setup joints themselves. Source: mtsIntuitiveResearchKitSUJ.cpp and
    mtsIntuitiveResearchKitSUJSi.cpp, update_forward_kinematics.
    """
    held = setup.base(q[f"SUJ_{setup.name}"])
    on = {arm.carrier: arm for arm in lab.arms if arm.carrier}
    if lab.reference_arm not in on or setup.name == lab.reference_arm:
        return held
    holder = on[lab.reference_arm]
    reference = next(suj for suj in lab.setup if suj.name == lab.reference_arm)
    at = q[f"SUJ_{reference.name}"]
    own = rig.arm(f"SUJ_{reference.name}").arm.mechanism
    base = pose(own, at) if reference.chain is None else reference.base(at)
    return inverse(base @ _tip(holder, rig, q[holder.name])) @ held
