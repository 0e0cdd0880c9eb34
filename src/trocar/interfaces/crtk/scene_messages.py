"""Messages of a scene, made from samples: objects, contacts, sensors, time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.descriptions.records import RigDescription
from trocar.descriptions.sensor_records import SensorDescription
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.sample import RigFigures
from trocar.interfaces.crtk.scene import CONTACTS, WORLD
from trocar.interfaces.crtk.sensor_rows import SENSOR_ROWS, contact, sensor_topic

if TYPE_CHECKING:
    from trocar.simulation.objects import ObjectStates

Figure = Callable[[RigFigures, Stamp], "dict[str, Any] | None"]


def makers(rig: RigDescription) -> dict[str, Figure]:
    """Return how to make the messages of a scene, {topic: from a sample}."""
    found: dict[str, Figure] = {CONTACTS: _all_contacts, "scene/time": _time}
    for index, prop in enumerate(rig.objects):
        found[f"scene/{prop.name}/measured_cp"] = _place_of(index)
        found[f"scene/{prop.name}/measured_cv"] = _speed_of(index)
    for sensor in rig.sensors:
        found[sensor_topic(sensor.name)] = _reading_of(sensor)
    return found


def _place_of(index: int) -> Figure:
    def make(rig: RigFigures, stamp: Stamp) -> dict[str, Any] | None:
        seen = _objects(rig)
        if seen is None:
            return None
        w, x, y, z = seen.quaternions[index]
        return say.row_stamped(stamp, WORLD, np.array([*seen.positions[index], x, y, z, w]))

    return make


def _speed_of(index: int) -> Figure:
    def make(rig: RigFigures, stamp: Stamp) -> dict[str, Any] | None:
        told = _objects(rig)
        if told is None:
            return None
        turn = matrix_from_quaternion(told.quaternions[index])
        twist = np.concatenate([told.linear[index], turn @ told.spin[index]])
        return say.twist_stamped(stamp, WORLD, twist)

    return make


def _objects(rig: RigFigures) -> ObjectStates | None:
    return None if rig.sample.scene is None else rig.sample.scene.objects


def _time(rig: RigFigures, stamp: Stamp) -> dict[str, Any]:  # noqa: ARG001  as every maker
    return {"data": rig.sample.world.time}


def _all_contacts(rig: RigFigures, stamp: Stamp) -> dict[str, Any] | None:
    table = None if rig.sample.scene is None else rig.sample.scene.contacts
    if table is None:
        return None
    rows = zip(table.bodies, table.points, table.normals, table.forces, table.depths, strict=True)
    names = table.names
    return {
        "header": say.header(stamp, WORLD),
        "contacts": [
            contact(names[body], names[other], point, normal, force, depth)
            for (body, other), point, normal, force, depth in rows
        ],
    }


def _reading_of(sensor: SensorDescription) -> Figure:
    """Return what makes a sensor's message; one with a rate tells each of its samples once."""
    make, told = SENSOR_ROWS[sensor.kind].make, [-1.0]

    def made(rig: RigFigures, stamp: Stamp) -> dict[str, Any] | None:
        scene = rig.sample.scene
        reading = None if scene is None or scene.readings is None else scene.readings.get(
            sensor.name
        )  # fmt: skip
        if reading is None or (sensor.rate and reading.time == told[0]):
            return None
        told[0] = reading.time
        return make(reading, sensor, stamp)

    return made
