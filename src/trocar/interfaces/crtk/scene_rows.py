"""The rows of a scene, in the form of `arm_rows`: what can be moved, contacts, sensors, time."""

from __future__ import annotations

from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk.arm_rows import (
    BOOL,
    EMPTY,
    FLOAT,
    PLACE,
    POSE,
    SPEED,
    TWIST,
    Row,
)
from trocar.interfaces.crtk.sensor_rows import CONTACTS, SENSOR_ROWS, sensor_topic

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
        row = SENSOR_ROWS[sensor.kind]
        rows += (("pub state", sensor_topic(sensor.name), row.type, row.unit, row.help),)
    return rows
