"""Motors: the servo of each public joint, and sensors of what it does."""

from __future__ import annotations

from typing import Any

import numpy as np

from trocar.descriptions.records import JointDescription, RigArm
from trocar.modeling.markup import child
from trocar.modeling.menagerie.sheet import Sheet, preset
from trocar.modeling.menagerie.text import exact, row

SENSORS = {"position": "actuatorpos", "velocity": "actuatorvel", "effort": "actuatorfrc"}


def servo_defaults(sheet: Sheet, place: RigArm, joint: JointDescription) -> dict[str, str]:
    """Return the attributes that the servo of a joint shares with others of its class."""
    said: dict[str, str] = {}
    weight = joint.drive[0][1]
    if weight != 1.0:
        said["gear"] = exact(weight)
    force = row([-joint.effort_max, joint.effort_max])
    control = preset(place)
    held = control.effort_limits or joint.name == "jaw" or joint.spring is not None
    limited = held and bool(np.isfinite(joint.effort_max))
    if limited:
        said["forcerange"] = force
    tag = servo_tag(sheet, joint)
    if tag == "motor":
        return {**said, "ctrlrange": force} if limited else said
    gains = control.pid[joint.name]
    # A gripper has no motor: what fingers exert comes in as effort alone.
    p, i, d = (0.0, 0.0, 0.0) if joint.spring is not None else (gains.p, gains.i, gains.d)
    said |= {"kp": exact(p), "kv": exact(d)}
    reach = row([joint.lower, joint.upper])
    if tag == "position":
        return {**said, "ctrlrange": reach}
    if i:
        said["ki"] = exact(i)
    return {**said, "input": "pos vel ff", "posrange": reach}


def servo_tag(sheet: Sheet, joint: JointDescription) -> str:
    """Return the element of a joint's servo."""
    if sheet.variant.servo == "pid":
        return "pid"
    return "position" if joint.spring is None else "motor"


def add_servos(sheet: Sheet, classes: dict[str, str], servos: Any, sensors: Any) -> None:
    """Add the servo and the sensors of each public joint.

    Args:
        sheet: the file
        classes: {name of a hinge: its default class}
        servos, sensors: the elements that grow
    """
    for group, place in enumerate(sheet.rig.arms, start=1):
        for joint in place.arm.joints:
            name, hinge = sheet.name(place.name, joint.name), hinge_name(sheet, place, joint)
            said = {"class": classes[hinge], "name": name, "joint": hinge}
            if sheet.variant.servo == "pid":
                said["group"] = str(group)
            child(servos, servo_tag(sheet, joint), said)
            for what, tag in SENSORS.items():
                child(sensors, tag, {"name": f"{name}_{what}", "actuator": name})


def hinge_name(sheet: Sheet, place: RigArm, joint: JointDescription) -> str:
    """Return what the hinge is called that a joint's motor sits on.

    The joint's own name, unless one is not the other's coordinate.
    """
    frame, weight = joint.drive[0]
    return sheet.name(place.name, joint.name if weight == 1.0 else frame)
