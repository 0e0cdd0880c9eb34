"""Messages of a scene, made from samples: objects, contacts, sensors, time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.descriptions.sensor_records import SensorDescription
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.figures import RigFigures
from trocar.interfaces.crtk.scene import CONTACTS, WORLD
from trocar.interfaces.crtk.scene_rows import sensor_topic

if TYPE_CHECKING:
    from trocar.simulation.objects import ObjectStates

Array = NDArray[np.float64]
Figure = Callable[[RigFigures, Stamp], "dict[str, Any] | None"]

#: Source: sensor_msgs/Imu: the orientation is not measured.
UNMEASURED = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


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
        rows = rig.object_rows
        return None if rows is None else say.row_stamped(stamp, WORLD, rows[index])

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
    return {"data": rig.sample.time}


def _all_contacts(rig: RigFigures, stamp: Stamp) -> dict[str, Any] | None:
    table = None if rig.sample.scene is None else rig.sample.scene.contacts
    if table is None:
        return None
    rows = zip(table.bodies, table.points, table.normals, table.forces, table.depths, strict=True)
    names = table.names
    return {
        "header": say.header(stamp, WORLD),
        "contacts": [
            _contact(names[body], names[other], point, normal, force, depth)
            for (body, other), point, normal, force, depth in rows
        ],
    }


def _contact(
    body: str, other: str, point: Array, normal: Array, force: Array, depth: float
) -> dict[str, Any]:
    """Return a trocar_msgs/Contact: the force is what the first does to the second."""
    return {
        "first": other,
        "second": body,
        "point": say.vector(point),
        "normal": say.vector(normal),
        "force": say.vector(force),
        "depth": float(depth),
    }


def _reading_of(sensor: SensorDescription) -> Figure:
    """Return what makes a sensor's message; one with a rate tells each of its samples once."""
    make, told = _KINDS[sensor.kind], [-1.0]

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


def _effort(reading: Any, sensor: SensorDescription, stamp: Stamp) -> dict[str, Any]:
    nothing = np.zeros(0)
    return say.joints(stamp, [sensor.joint], nothing, nothing, np.array([reading.effort]))


def _wrench(reading: Any, sensor: SensorDescription, stamp: Stamp) -> dict[str, Any]:  # noqa: ARG001
    both = np.concatenate([reading.force, reading.torque])
    return say.wrench_stamped(stamp, reading.frame_id, both)


def _contacts(reading: Any, sensor: SensorDescription, stamp: Stamp) -> dict[str, Any]:  # noqa: ARG001
    return {
        "header": say.header(stamp, reading.frame_id),
        "contacts": [
            _contact(c.body, c.other, c.point, c.normal, c.force, c.depth) for c in reading.contacts
        ],
    }


def _proximity(reading: Any, sensor: SensorDescription, stamp: Stamp) -> dict[str, Any]:  # noqa: ARG001
    nothing, lengths = np.zeros(0), np.array([reading.distance, reading.gap])
    return say.joints(stamp, ["distance", "gap"], lengths, nothing, nothing)


def _imu(reading: Any, sensor: SensorDescription, stamp: Stamp) -> dict[str, Any]:
    def covariance(value: str) -> list[float]:
        return (sensor.noise[value] ** 2 * np.eye(3)).ravel().tolist()

    return {
        "header": say.header(stamp, reading.frame_id),
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        "orientation_covariance": UNMEASURED,
        "angular_velocity": say.vector(reading.angular_velocity),
        "angular_velocity_covariance": covariance("angular_velocity"),
        "linear_acceleration": say.vector(reading.linear_acceleration),
        "linear_acceleration_covariance": covariance("linear_acceleration"),
    }


_KINDS: Mapping[str, Callable[[Any, SensorDescription, Stamp], dict[str, Any]]] = {
    "joint_effort": _effort,
    "tip_wrench": _wrench,
    "contacts": _contacts,
    "proximity": _proximity,
    "imu": _imu,
}
