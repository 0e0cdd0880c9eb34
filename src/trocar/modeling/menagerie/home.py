"""The keyframe "home": loops closed, and servos that hold the arms still."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.inertial import holding_efforts
from trocar.descriptions.records import RigArm
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.kinematics.forward import coordinates, pose
from trocar.modeling.markup import child
from trocar.modeling.menagerie.bodies import Bodies
from trocar.modeling.menagerie.sheet import Sheet, preset
from trocar.modeling.menagerie.text import row

Array = NDArray[np.float64]


def add_home(sheet: Sheet, bodies: Bodies, world: Any, to: Any) -> None:
    """Add the rig's pose "start" to the element `keyframe`.

    Args:
        sheet: the file
        bodies: its bodies
        world: the element `worldbody`: MuJoCo counts hinges in the order of the file
        to: the element `keyframe`
    """
    start = sheet.rig.poses["start"]
    at = {p.name: coordinates(p.arm.mechanism, start[p.name]) for p in sheet.rig.arms}
    index = {p.name: p.arm.mechanism.frame_index for p in sheet.rig.arms}
    owners = [bodies.hinges[hinge.get("name")] for hinge in world.iter("joint")]
    free = [_free_coordinates(prop.pose) for prop in sheet.rig.objects]  # ahead of all arms
    hinged = [at[arm][index[arm][frame]] for arm, frame in owners]
    qpos = np.concatenate([*free, hinged])
    ctrl = [value for place in sheet.rig.arms for value in _inputs(sheet, place)]
    child(to, "key", {"name": "home", "qpos": row(qpos), "ctrl": row(ctrl)})


def _free_coordinates(pose: Array) -> Array:
    """Return position and quaternion wxyz of a body that nothing holds, (7,)."""
    return np.concatenate([pose[:3, 3], quaternion_from_matrix(pose[:3, :3])])


def _inputs(sheet: Sheet, place: RigArm) -> list[float]:
    """Return what the servos of an arm are told at rest."""
    q = sheet.rig.poses["start"][place.name]
    control = preset(place)
    load = np.zeros(len(q))
    if not sheet.weightless(place) and not sheet.braked(place):
        load = holding_efforts(place.arm, q, _down(sheet, place))
    told: list[float] = []
    for joint, at, effort in zip(place.arm.joints, q, load, strict=True):
        if joint.spring is not None:
            effort = effort + joint.spring.stiffness * (at - joint.spring.rest)
        gain = control.pid[joint.name].p
        fed = control.gravity_compensation or joint.spring is not None
        if sheet.variant.servo == "pid":
            told += [at, 0.0, effort] if fed else [at + effort / gain, 0.0, 0.0]
        else:
            told.append(effort if joint.spring is not None else at + effort / gain)
    return told


def _down(sheet: Sheet, place: RigArm) -> Array:
    """Return the direction of gravity in an arm's reference frame at the pose "start", (3,)."""
    mechanism = place.arm.mechanism
    q = sheet.rig.poses["start"][place.name]
    reference = pose(mechanism, q, mechanism.reference, place.arm.root)
    return (_root(sheet, place) @ reference)[:3, :3].T @ np.array([0.0, 0.0, -1.0])


def _root(sheet: Sheet, place: RigArm) -> Array:
    """Return the pose of an arm's root in the world at the pose "start", (4, 4)."""
    if not place.on:
        return place.pose
    carrier = sheet.rig.arm(place.on)
    q = sheet.rig.poses["start"][carrier.name]
    mount = pose(carrier.arm.mechanism, q, place.frame, carrier.arm.root)
    return _root(sheet, carrier) @ mount @ place.pose
