"""Poses of a rig's links by the kinematics alone, for the judges of every format."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.formats.links import LinkModel, link_name
from trocar.kinematics.forward import coordinates, poses

Array = NDArray[np.float64]


def random_rig_positions(rig: RigDescription, rng: np.random.Generator) -> dict[str, Array]:
    """Return joint positions of each arm over its whole range, jaws from shut on."""
    found: dict[str, Array] = {}
    for place in rig.arms:
        mechanism = place.arm.mechanism
        q = rng.uniform(mechanism.lower, mechanism.upper)
        if place.arm.has_jaw:
            q[-1] = abs(q[-1])
        found[place.name] = q
    return found


def frames_in_world(rig: RigDescription, q: Mapping[str, Array]) -> dict[str, Array]:
    """Return {link: T_world_link (4, 4)} of each frame of each arm."""
    found: dict[str, Array] = {}
    for place in rig.arms:
        arm = place.arm
        root = place.pose
        if place.on:
            root = found[link_name(place.on, place.frame)] @ root
        for frame, pose in poses(arm.mechanism, q[place.name], arm.root).items():
            if frame in arm.mechanism.frame_index:
                found[link_name(place.name, frame)] = root @ pose
    return found


def leading(model: LinkModel, rig: RigDescription, q: Mapping[str, Array]) -> dict[str, float]:
    """Return the coordinates of the joints that follow none [rad or m]."""
    found: dict[str, float] = {}
    for place in rig.arms:
        at = coordinates(place.arm.mechanism, q[place.name])
        index = place.arm.mechanism.frame_index
        for joint in model.joints:
            if joint.arm == place.name and joint.hinge is not None and not joint.follows:
                found[joint.name] = float(at[index[joint.frame]])
    return found
