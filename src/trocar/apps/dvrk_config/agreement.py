"""How far an imported rig is from the files that it came from.

The files' side is computed from their rows alone, the rig's side from the TOML that was written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.dvrk_config.arms import largest_gap, last_row
from trocar.apps.dvrk_config.setup_joints import CART
from trocar.apps.dvrk_config.system import Lab, LabArm, SetupArm
from trocar.descriptions import RigDescription
from trocar.descriptions.places import Places
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Agreement:
    """Largest differences over random joint positions.

    Attributes:
        bases, chains: of how many arms the file says where they stand, and has the chain
        setups: of how many setup joints the file has the chain
        base_m, base_rad: of the arms' bases in the frame that the file gives them in
        chain_m, chain_rad: of the end of the arms' chains in their bases
        setup_m, setup_rad: of measured_cp and local/measured_cp of setup joints
    """

    bases: int
    chains: int
    setups: int
    base_m: float
    base_rad: float
    chain_m: float
    chain_rad: float
    setup_m: float
    setup_rad: float


def agreement(lab: Lab, rig: RigDescription, count: int = 20) -> Agreement:
    """Compare a rig with the files, at random positions of all joints."""
    rng = np.random.default_rng(0)
    placed = {arm.name: arm.arm for arm in rig.arms}
    arms = [arm for arm in lab.arms if arm.name in placed]
    setups = {setup.name: setup for setup in lab.setup}
    chained = [setup for setup in lab.setup if setup.chain is not None]
    bases, chains, poses = [np.zeros(2)], [np.zeros(2)], [np.zeros(2)]
    for _ in range(count):
        q = {
            name: rng.uniform(arm.mechanism.lower, arm.mechanism.upper)
            for name, arm in placed.items()
        }
        places = Places(rig, q.__getitem__)
        for arm in arms:
            bases.append(_base_gap(arm, setups, places, rig.reference_arm, q))
            if arm.chain is not None:
                end = arm.chain.tip(q[arm.name][: arm.chain.moving])
                chains.append(largest_gap(last_row(placed[arm.name], q[arm.name]), end))
        for setup in chained:
            name = f"SUJ_{setup.name}"
            local = pose(placed[name].mechanism, q[name])
            frame, _ = places.base_pose(name, rig.reference_arm)
            poses.append(largest_gap(local, setup.base(q[name])))
            poses.append(largest_gap(frame @ local, _published(setup, lab, rig, q)))
    gaps = [float(v) for found in (bases, chains, poses) for v in np.max(found, axis=0)]
    stand = sum(bool(arm.carrier or arm.frame) for arm in arms)
    return Agreement(stand, sum(arm.chain is not None for arm in arms), len(chained), *gaps)


def _base_gap(
    arm: LabArm,
    setups: Mapping[str, SetupArm],
    places: Places,
    reference_arm: str,
    q: Mapping[str, Array],
) -> Array:
    """Return how far an arm's base is from where the file has it, (2,) [m, rad]."""
    if arm.pose is not None:
        return largest_gap(places.base_pose(arm.name, reference_arm)[0], arm.pose)
    setup = setups.get(arm.carrier)
    if setup is None or (setup.chain is None and setup.fixed is None):
        return np.zeros(2)
    on_cart = inverse(transform(np.eye(3), np.array(CART))) @ places.reference_pose(arm.name)
    return largest_gap(on_cart, setup.base(q.get(f"SUJ_{setup.name}", np.zeros(0))))


def _published(setup: SetupArm, lab: Lab, rig: RigDescription, q: Mapping[str, Array]) -> Array:
    """Return measured_cp of setup joints as the dVRK computes it from its files, (4, 4).

    It is the carried arm's base, in the tip frame of the arm on the setup joints of the reference
    arm but for these setup joints themselves. Source: mtsIntuitiveResearchKitSUJ.cpp and
    mtsIntuitiveResearchKitSUJSi.cpp, update_forward_kinematics.
    """
    held = setup.base(q[f"SUJ_{setup.name}"])
    on = {arm.carrier: arm.name for arm in lab.arms if arm.carrier}
    if lab.reference_arm not in on or setup.name == lab.reference_arm:
        return held
    holder = on[lab.reference_arm]
    reference = next(suj for suj in lab.setup if suj.name == lab.reference_arm)
    at = q[f"SUJ_{reference.name}"]
    own = rig.arm(f"SUJ_{reference.name}").arm.mechanism
    base = pose(own, at) if reference.chain is None else reference.base(at)
    return inverse(base @ pose(rig.arm(holder).arm.mechanism, q[holder])) @ held
