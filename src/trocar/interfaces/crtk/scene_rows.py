"""The rows of a scene, in the form of `arm_rows`: what can be moved, contacts, sensors, time."""

from __future__ import annotations

import re

from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk.arm_rows import (
    BOOL,
    EMPTY,
    FLOAT,
    JOINTS,
    PLACE,
    POSE,
    SPEED,
    TWIST,
    WRENCH,
    Row,
)

CONTACTS = "trocar_msgs/Contacts"
INTEGER = "std_msgs/Int32"

#: What every simulator has.
SCENE: tuple[Row, ...] = (
    ("pub state", "scene/contacts", CONTACTS, "m, N", "every place where two bodies touch"),
    ("pub state", "scene/time", FLOAT, "s", "simulated time since the last reset"),
    ("pub latched", "scene/paused", BOOL, "", "whether time stands still"),
    ("sub", "scene/reset", EMPTY, "", "bring arms and objects back to the start, at time 0"),
    ("sub", "scene/pause", EMPTY, "", "let time stand still; commands are obeyed all the same"),
    ("sub", "scene/resume", EMPTY, "", "let time flow again"),
    ("sub", "scene/step", INTEGER, "periods", "while paused: so many periods, then all states"),
)

#: {kind of sensor: type, unit, help}.
SENSORS: dict[str, tuple[str, str, str]] = {
    "joint_effort": (JOINTS, "N m, N", "effort of a motor"),
    "tip_wrench": (WRENCH, "N, N m", "what the environment does to an instrument"),
    "contacts": (CONTACTS, "m, N", "where something is touched"),
    "proximity": (JOINTS, "m", "position: distance of what lies in the jaw, and its gap"),
    "imu": ("sensor_msgs/Imu", "rad/s, m/s^2", "angular velocity, and acceleration less gravity"),
}


def sensor_topic(name: str) -> str:
    """Return the topic of a sensor; what a topic's name may not have becomes an underscore."""
    return f"sensors/{re.sub('[^A-Za-z0-9_]', '_', name)}"


def topics_of(rig: RigDescription) -> tuple[Row, ...]:
    """Return the rows of a rig's objects and sensors, and of its time."""
    rows = SCENE
    for prop in rig.objects:
        at = f"scene/{prop.name}"
        rows += (
            ("pub state", f"{at}/measured_cp", POSE, PLACE, "the object in the world"),
            ("pub state", f"{at}/measured_cv", TWIST, SPEED, "its velocity, in axes of the world"),
            ("sub", f"{at}/set_cp", POSE, PLACE, "put the object there, at rest"),
        )
    for sensor in rig.sensors:
        kind, unit, text = SENSORS[sensor.kind]
        rows += (("pub state", sensor_topic(sensor.name), kind, unit, text),)
    return rows
