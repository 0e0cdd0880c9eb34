"""How far an imported rig is from the file that it came from.

The file's side is computed from its rows alone, the rig's side from the TOML that was written.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.labs.numbers import chain_tip, last_row
from trocar.apps.labs.records import Chain, Lab, LabArm, SetupArm
from trocar.apps.labs.rig_file import CART
from trocar.apps.labs.setup_arms import setup_base
from trocar.descriptions import RigDescription
from trocar.descriptions.places import Places
from trocar.descriptions.records import ArmDescription, RigArm
from trocar.geometry.se3 import inverse, pose_difference
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
    """Compare a rig with the file, at random positions of all joints."""
    rng = np.random.default_rng(0)
    bases, chains, setups = [np.zeros(2)], [np.zeros(2)], [np.zeros(2)]
    placed = {arm.name: arm for arm in rig.arms}
    told = [arm for arm in lab.arms if arm.name in placed]
    for arm in told:
        for _ in range(count):
            bases.append(_base_gap(arm, lab, rig, rng))
            if arm.chain is not None:
                chains.append(_chain_gap(arm.chain, placed[arm.name].arm, rng))
    chained = [setup for setup in lab.setup if setup.chain is not None]
    setups += [_setup_pose_gap(setup, lab, rig, rng) for setup in chained for _ in range(count)]
    stand = sum(1 for arm in told if arm.base.on != "nothing")
    have = sum(1 for arm in told if arm.chain is not None)
    gaps = [float(v) for found in (bases, chains, setups) for v in np.max(found, axis=0)]
    return Agreement(stand, have, len(chained), *gaps)


def _random(arm: ArmDescription, rng: np.random.Generator) -> Array:
    return rng.uniform(arm.mechanism.lower, arm.mechanism.upper)


def _gap(one: Array, other: Array) -> Array:
    moved, turned = pose_difference(one, other)
    return np.array([float(np.max(moved)), float(np.max(turned))])


def _reference(arm: RigArm) -> Array:
    """Return an arm's reference frame in its root, (4, 4)."""
    mechanism = arm.arm.mechanism
    return pose(mechanism, np.zeros(len(mechanism.joints)), mechanism.reference, arm.arm.root)


def _base_gap(arm: LabArm, lab: Lab, rig: RigDescription, rng: np.random.Generator) -> Array:
    """Return how far an arm's base is from where the file has it, (2,) [m, rad]."""
    here = rig.arm(arm.name)
    if arm.base.on == "setup":
        setup = next(suj for suj in lab.setup if suj.name == arm.base.name)
        return _setup_gap(setup, here, rig, rng)
    if arm.base.pose is None:
        return np.zeros(2)
    if here.base_frame is not None:
        return _gap(here.base_frame.pose, arm.base.pose)
    if rig.display is None:
        return np.zeros(2)
    return _gap(inverse(rig.display) @ here.pose @ _reference(here), arm.base.pose)


def _setup_gap(
    setup: SetupArm, here: RigArm, rig: RigDescription, rng: np.random.Generator
) -> Array:
    if setup.fixed is not None:
        seen = here.pose @ _reference(here)
        seen = seen.copy()
        seen[:3, 3] -= CART
        return _gap(seen, setup.fixed)
    if setup.chain is None:
        return np.zeros(2)
    carrier = rig.arm(here.on).arm
    q = _random(carrier, rng)
    seen = pose(carrier.mechanism, q, here.frame) @ here.pose @ _reference(here)
    return _gap(seen, setup_base(setup, q))


def _setup_pose_gap(
    setup: SetupArm, lab: Lab, rig: RigDescription, rng: np.random.Generator
) -> Array:
    """Return how far poses of setup joints are from what the dVRK publishes, (2,) [m, rad].

    local/measured_cp is T_cart_base of the carried arm; measured_cp is that in the tip frame of the
    arm on the setup joints of the reference arm, but for these setup joints themselves. Source:
    mtsIntuitiveResearchKitSUJ.cpp and mtsIntuitiveResearchKitSUJSi.cpp, update_forward_kinematics.
    """
    name, q = f"SUJ_{setup.name}", {arm.name: _random(arm.arm, rng) for arm in rig.arms}
    seen, held = pose(rig.arm(name).arm.mechanism, q[name]), setup_base(setup, q[name])
    gap = _gap(seen, held)
    on = {arm.base.name: arm.name for arm in lab.arms if arm.base.on == "setup"}
    if lab.reference_arm in on and setup.name != lab.reference_arm:
        reference = next(suj for suj in lab.setup if suj.name == lab.reference_arm)
        holder = on[reference.name]
        tip = pose(rig.arm(holder).arm.mechanism, q[holder])
        at = q[f"SUJ_{reference.name}"]
        own = rig.arm(f"SUJ_{reference.name}").arm.mechanism
        base = pose(own, at) if reference.chain is None else setup_base(reference, at)
        held = inverse(base @ tip) @ held
    cart, _ = Places(rig, q.__getitem__).base_pose(name, rig.reference_arm)
    return np.maximum(gap, _gap(cart @ seen, held))


def _chain_gap(chain: Chain, arm: ArmDescription, rng: np.random.Generator) -> Array:
    """Return how far the chain's end is from the file's, (2,) [m, rad]."""
    q = _random(arm, rng)
    count = sum(1 for row in chain.rows if row.moves)
    return _gap(last_row(arm, q), chain_tip(chain, q[:count]))
