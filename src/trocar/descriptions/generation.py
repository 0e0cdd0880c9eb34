"""A rig of Classic arms with those of an Si in their place: the same ports, tips and tools."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription, RigArm, RigDescription
from trocar.descriptions.rig_frames import Places
from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry.rotations import rotation_x, rotation_z
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.chain_pose import chain_pose, standing_pose
from trocar.kinematics.inverse import nearest_solution

Array = NDArray[np.float64]

#: Mounting pitch of arms on an Si cart. Source: jhu-dvrk/sawIntuitiveResearchKit@9e535e6
#: share/arm/suj-si-simulated.json; PSM3's is -15 degrees. [rad]
LEAN = {"PSM": math.radians(-45.0), "ECM": math.radians(-70.0)}
#: Start of the search for an arm's joints, yaw, pitch, insertion: straight down, or as near to
#: it as the range allows [rad, m].
SEED = {"PSM": (0.0, -0.785, 0.15), "ECM": (0.0, -1.0, 0.05)}
#: Tilt of a shaft below which it points nowhere in particular. Source: our own choice. [rad]
UPRIGHT = 0.02


def on_si(
    rig: RigDescription, load_arm: Callable[[str, str | None], ArmDescription]
) -> RigDescription:
    """Return a rig with Si arms for its Classic PSMs and ECMs.

    Remote centres, instruments (of the same name, with the long shaft) and the poses of tips stay.
    A base stands where the endoscope looks to, as a cart does at the end of the table, or where it
    stood in a rig without one.

    Args:
        rig: of arms that stand in the world
        load_arm: returns an arm by its name and its tool's

    Raises:
        InputError: setup joints or masters, an instrument that no Si arm has, or a pose of the tip
            that an arm does not reach: the joint is named, and how far it is beyond its limit
    """
    others = [arm.name for arm in rig.arms if arm.on or arm.arm.type not in LEAN]
    if others:
        raise InputError(
            f"generation: got Si for the rig {rig.name}, which has {', '.join(others)}; allowed: a"
            " rig of PSMs and ECMs that stand in the world (full_cart_si has setup joints)"
        )
    start = rig.poses["start"]
    before = Places(rig, lambda name: start[name])
    ahead = next((_ahead(rig, before, a) for a in rig.arms if a.arm.type == "ECM"), None)
    arms: list[RigArm] = []
    for arm in rig.arms:
        if arm.arm.generation == "Si":
            arms.append(arm)
            continue
        T = before.reference_pose(arm.name)
        towards = -T[:2, 1] if ahead is None else ahead
        turn = rotation_z(math.atan2(towards[0], -towards[1]))
        leaning = transform(turn @ rotation_x(LEAN[arm.arm.type]), T[:3, 3])
        made = load_arm(f"{arm.arm.type.lower()}_si", _tool(arm.arm))
        own = standing_pose(made.mechanism, made.mechanism.reference, made.root)
        arms.append(replace(arm, arm=made, pose=leaning @ inverse(own)))
    found = replace(rig, arms=tuple(arms))
    after = Places(found, lambda name: start[name])
    poses = {
        pose: {name: _solved(rig, found, before, after, pose, name, q) for name, q in row.items()}
        for pose, row in rig.poses.items()
        if pose == "start"
    }
    return replace(found, poses=poses)


def _ahead(rig: RigDescription, places: Places, scope: RigArm) -> Array | None:
    """Return the level direction that an endoscope looks to, (2,); None of one that looks down."""
    tip = chain_pose(scope.arm.mechanism)(rig.poses["start"][scope.name])
    level = (places.reference_pose(scope.name) @ tip)[:2, 2]
    return level / np.linalg.norm(level) if np.linalg.norm(level) > UPRIGHT else None


def _tool(arm: ArmDescription) -> str | None:
    """Return the instrument of an Si arm that is that of a Classic one."""
    if not arm.tool_frame:
        return None
    name, _, code = arm.tool.partition(":")
    return f"{name}:42{code[2:]}" if code[:2] == "40" else arm.tool


def _solved(
    rig: RigDescription,
    found: RigDescription,
    before: Places,
    after: Places,
    pose: str,
    name: str,
    q: Array,
) -> Array:
    """Return the joints that bring an arm's tip to where it was."""
    was, arm = rig.arm(name).arm, found.arm(name).arm
    if was.generation == "Si":
        return q
    T = before.reference_pose(name) @ chain_pose(was.mechanism)(q)
    goal = inverse(after.reference_pose(name)) @ T
    seed = np.zeros(len(arm.mechanism.joints))
    seed[:3] = SEED[arm.type]
    own = arm.own_joints
    try:
        solved = nearest_solution(arm.mechanism, arm.inverse_kinematics, goal, seed[:own])
    except (UnreachableError, SingularError) as problem:
        raise InputError(
            f"generation: {name} of an Si does not reach its pose {pose!r} in {rig.name}: {problem}"
        ) from None
    return np.concatenate([solved, q[own:]])
