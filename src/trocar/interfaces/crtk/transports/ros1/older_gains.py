"""Parameters of dvrk_env, which its users load before they start: gains and first positions.

Source: WPI-AIM/dvrk_env@07023a1: the plugin reads, of every joint that has a motor,
/dvrk/psm1/yaw_joint_controller/{p,i,d,init_joint}; config/dvrk.yaml holds them.
"""

from __future__ import annotations

from collections.abc import Mapping

from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk.compat.dvrk_env import joints_of

FIRST = "init_joint"
"""The parameter that tells where a joint is to be at first [rad or m]."""


def older_keys(rig: RigDescription) -> dict[str, tuple[str, str]]:
    """Return {parameter that holds a joint's gains there: (arm, joint)}.

    Fingers are left out: there each has a motor, here the jaw has one.
    """
    return {
        f"/dvrk/{arm.name.lower()}/{joint.name}_controller": (arm.name, joint.own)
        for arm in rig.arms
        for joint in joints_of(arm.arm)
        if joint.driven and joint.ratio == 1.0
    }


def first_positions(
    rig: RigDescription,
    found: Mapping[tuple[str, str], float],
    now: Mapping[str, tuple[float, ...]],
) -> dict[str, tuple[float, ...]]:
    """Return the goals of the arms that have first positions, {arm: q without the jaw (n,)}.

    Args:
        rig: the rig
        found: {(arm, joint): first position [rad or m]}
        now: {arm: set-points of all its joints}, which the other joints keep
    """
    goals: dict[str, tuple[float, ...]] = {}
    for arm in rig.arms:
        names = arm.arm.mechanism.joint_names[: arm.arm.own_joints]
        if any((arm.name, name) in found for name in names):
            goals[arm.name] = tuple(
                found.get((arm.name, name), now[arm.name][k]) for k, name in enumerate(names)
            )
    return goals
