"""Topics of a scene: objects, contacts, sensors, and the flow of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.descriptions.sensor_records import SensorDescription, SensorReading
from trocar.descriptions.sensors import (
    ContactsReading,
    EffortReading,
    Imu,
    ImuReading,
    JointEffort,
    ProximityReading,
    Tension,
    TensionReading,
    TwistReading,
    WrenchReading,
)
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.live.inbox import Command
from trocar.ros import message_builders as build
from trocar.ros.clock import Stamp
from trocar.ros.message_builders import Message
from trocar.ros.message_fields import RefusedError, field, joints, pose, shown, text, wrench
from trocar.ros.sample import CONTACTS, SampleReadings, sensor_topic
from trocar.ros.topic import (
    BOOL,
    EMPTY,
    FLOAT,
    FORCE,
    JOINTS,
    PLACE,
    POSE,
    SPEED,
    STRING,
    TWIST,
    WRENCH,
    Make,
    Read,
    Topic,
    command,
    latched,
    state,
)
from trocar.simulation.grasps import Grasp
from trocar.simulation.journal import WORLD as JOURNAL

Array = NDArray[np.float64]

#: The frame of objects and contacts: that of the rig, the root of tf.
WORLD = "world"
CONTACTS_TYPE = "trocar_msgs/Contacts"
NOTHING = np.zeros(0)
#: Topics of the object between the pads of a jaw: type, unit and help.
GRASP = {
    "object": (STRING, "", "object between the pads, empty for none"),
    "force": (FLOAT, "N", "force on the object, the lesser of both pads"),
}
#: Source: sensor_msgs/Imu: the orientation is not measured.
UNMEASURED = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def scene_topics(rig: RigDescription) -> list[Topic]:
    """Return the rows of a rig's objects and sensors, and of its time."""
    rows = [
        state(CONTACTS, CONTACTS_TYPE, "m, N", "every place where two bodies touch", _contacts),
        state("scene/time", FLOAT, "s", "simulated time since the last reset", _time),
        latched("scene/paused", BOOL, "whether time is paused"),
        command("scene/reset", EMPTY, "", "arms and objects back to the start, at time 0",
                _flow("reset")),
        command("scene/pause", EMPTY, "", "pause time; commands are applied all the same",
                _flow("pause")),
        command("scene/resume", EMPTY, "", "resume time", _flow("resume")),
        command("scene/step", "std_msgs/Int32", "periods",
                "while paused: so many periods, then all states", _step),
    ]  # fmt: skip
    for index, prop in enumerate(rig.objects):
        at = f"scene/{prop.name}"
        rows += [
            state(f"{at}/measured_cp", POSE, PLACE, "the object in the world", _place_of(index)),
            state(f"{at}/measured_cv", TWIST, SPEED, "its velocity, in axes of the world",
                    _speed_of(index)),
            command(f"{at}/servo_cf", WRENCH, FORCE,
                    "force at its centre of mass, and torque, in axes of the world, until the next",
                    partial(_push, prop.name), newest=True),
        ]  # fmt: skip
        if prop.joint is None:
            help_ = "put the object there, at rest"
            rows.append(command(f"{at}/set_cp", POSE, PLACE, help_, partial(_put, prop.name)))
        elif prop.joint.kind != "ball":
            unit = "rad" if prop.joint.kind == "hinge" else "m"
            put = partial(_put_joint, prop.name)
            rows += [
                state(f"{at}/measured_js", JOINTS, unit, "its joint", _joint_of(index, prop.name)),
                command(f"{at}/set_jp", JOINTS, unit, "put its joint there, at rest", put),
            ]  # fmt: skip
        if prop.script:
            rows.append(latched(f"{at}/error", STRING, "its script raised and is called no longer"))
    if any(prop.joint is None for prop in rig.objects):
        for arm in rig.arms:
            rows += _grasp_rows(arm.name) if arm.arm.fingers else []
    for sensor in rig.sensors:
        row = sensor_row(type(sensor))
        make = _reading_of(sensor, row)
        rows.append(state(sensor_topic(sensor.name), row.type, row.unit, row.help, make))
    return rows


def _grasp_rows(arm: str) -> list[Topic]:
    """Return the rows of what an arm's jaw has between its pads."""

    def make(key: str, of: Callable[[Grasp], str | float]) -> Topic:
        def message(readings: SampleReadings, stamp: Stamp) -> Message | None:  # noqa: ARG001
            found = readings.sample.scene.grasps.get(arm)
            return None if found is None else {"data": of(found)}

        kind, unit, text = GRASP[key]
        return state(f"{arm}/grasp/{key}", kind, unit, text, message)

    return [
        make("object", lambda grasp: grasp.object),
        make("force", lambda grasp: grasp.force),
        latched(f"{arm}/grasp/slipped", STRING, "object whose load exceeded friction"),
        latched(f"{arm}/grasp/dropped", STRING, "object that fell after the jaw released it"),
    ]


# ---------------------------------------------------------------------- commands


def _flow(verb: str) -> Read:
    return lambda message, _: Command(JOURNAL, verb, {}, f"scene/{verb}")  # noqa: ARG005


def _step(message: Mapping[str, Any], _: object) -> Command:
    periods = field(message, "data")
    if isinstance(periods, bool) or not isinstance(periods, int | np.integer):
        raise RefusedError("type", f"got data {shown(periods)}; allowed: an integer")
    return Command(JOURNAL, "step", {"periods": int(cast(int, periods))}, "scene/step")


def _push(name: str, message: Mapping[str, Any], _: object) -> Command:
    _check_frame(message)
    return Command(
        name, "servo_cf", {"wrench": wrench(message, "wrench")}, f"scene/{name}/servo_cf"
    )


def _put_joint(name: str, message: Mapping[str, Any], _: object) -> Command:
    q = joints(message, "position", [name])
    return Command(name, "set_jp", {"q": q}, f"scene/{name}/set_jp")


def _check_frame(message: Mapping[str, Any]) -> None:
    frame = text(message, "header.frame_id").lstrip("/")
    if frame not in ("", WORLD):
        raise RefusedError("frame", f"got the frame {frame!r}; allowed: {WORLD}, or none")


def _put(name: str, message: Mapping[str, Any], _: object) -> Command:
    _check_frame(message)
    return Command(name, "set_cp", {"T": pose(message, "pose")}, f"scene/{name}/set_cp")


# ---------------------------------------------------------------------- objects, contacts, time


def _place_of(index: int) -> Make:
    def make(readings: SampleReadings, stamp: Stamp) -> Message | None:
        seen = readings.sample.scene.objects
        if seen is None:
            return None
        w, x, y, z = seen.quaternions[index].tolist()
        at, turn = build.vector(seen.positions[index]), {"x": x, "y": y, "z": z, "w": w}
        header = build.header(stamp, WORLD)
        return {"header": header, "pose": {"position": at, "orientation": turn}}

    return make


def _speed_of(index: int) -> Make:
    def make(readings: SampleReadings, stamp: Stamp) -> Message | None:
        seen = readings.sample.scene.objects
        if seen is None:
            return None
        turn = matrix_from_quaternion(seen.quaternions[index])
        twist = np.concatenate([seen.linear[index], turn @ seen.spin[index]])
        return build.twist_stamped(stamp, WORLD, twist)

    return make


def _joint_of(index: int, name: str) -> Make:
    def make(readings: SampleReadings, stamp: Stamp) -> Message | None:
        seen = readings.sample.scene.objects
        if seen is None:
            return None
        q, qd = seen.joint[index]
        return build.joints(stamp, [name], np.array([q]), np.array([qd]), NOTHING)

    return make


def _time(readings: SampleReadings, stamp: Stamp) -> Message:  # noqa: ARG001  as every make
    return {"data": readings.sample.world.time}


def _contacts(readings: SampleReadings, stamp: Stamp) -> Message | None:
    table = readings.sample.scene.contacts
    if table is None:
        return None
    rows = zip(table.bodies, table.points, table.normals, table.forces, table.depths, strict=True)
    names = table.names
    return {
        "header": build.header(stamp, WORLD),
        "contacts": [
            contact(names[int(body)], names[int(other)], point, normal, force, depth)
            for (body, other), point, normal, force, depth in rows
        ],
    }


def contact(
    body: str, other: str, point: Array, normal: Array, force: Array, depth: float
) -> Message:
    """Return a trocar_msgs/Contact: the force is what the first exerts on the second."""
    return {
        "first": other,
        "second": body,
        "point": build.vector(point),
        "normal": build.vector(normal),
        "force": build.vector(force),
        "depth": float(depth),
    }


# ---------------------------------------------------------------------- sensors


@dataclass(frozen=True)
class SensorRow:
    """The messages of a kind of sensors.

    Attributes:
        type: of the message
        unit: of its numbers
        help: its content
        make: returns the message of (reading, sensor, stamp)
    """

    type: str
    unit: str
    help: str
    make: Callable[[Any, Any, Stamp], Message]


def _reading_of(sensor: SensorDescription, row: SensorRow) -> Make:
    """Return the maker of a sensor's messages; with a rate, each sample is published once."""
    published = -1.0

    def make(readings: SampleReadings, stamp: Stamp) -> Message | None:
        nonlocal published
        reading = readings.sample.scene.readings.get(sensor.name)
        if reading is None or (sensor.rate and reading.time == published):
            return None
        published = reading.time
        return row.make(reading, sensor, stamp)

    return make


def _effort(reading: EffortReading, sensor: JointEffort, stamp: Stamp) -> Message:
    return build.joints(stamp, [sensor.joint], NOTHING, NOTHING, np.array([reading.effort]))


def _wrench(reading: WrenchReading, _: object, stamp: Stamp) -> Message:
    both = np.concatenate([reading.force, reading.torque])
    return build.wrench_stamped(stamp, reading.frame_id, both)


def _touch(reading: ContactsReading, _: object, stamp: Stamp) -> Message:
    return {
        "header": build.header(stamp, reading.frame_id),
        "contacts": [
            contact(c.body, c.other, c.point, c.normal, c.force, c.depth) for c in reading.contacts
        ],
    }


def _proximity(reading: ProximityReading, _: object, stamp: Stamp) -> Message:
    lengths = np.array([reading.distance, reading.gap])
    return build.joints(stamp, ["distance", "gap"], lengths, NOTHING, NOTHING)


def _tension(reading: TensionReading, sensor: Tension, stamp: Stamp) -> Message:
    length, tension = np.array([reading.length]), np.array([reading.tension])
    return build.joints(stamp, [sensor.band], length, NOTHING, tension)


def _imu(reading: ImuReading, sensor: Imu, stamp: Stamp) -> Message:
    def covariance(value: str) -> list[float]:
        return (sensor.noise[value] ** 2 * np.eye(3)).ravel().tolist()

    return {
        "header": build.header(stamp, reading.frame_id),
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        "orientation_covariance": UNMEASURED,
        "angular_velocity": build.vector(reading.angular_velocity),
        "angular_velocity_covariance": covariance("angular_velocity"),
        "linear_acceleration": build.vector(reading.linear_acceleration),
        "linear_acceleration_covariance": covariance("linear_acceleration"),
    }


def _twist(reading: TwistReading, _: object, stamp: Stamp) -> Message:
    both = np.concatenate([reading.linear, reading.angular])
    return build.twist_stamped(stamp, reading.frame_id, both)


def _numbers(reading: SensorReading, _: object, stamp: Stamp) -> Message:
    """Return a JointState with every number of a reading: "speed", "force[0]", ..."""
    names: list[str] = []
    numbers: list[float] = []
    for value in reading.units:
        array = np.asarray(getattr(reading, value), dtype=np.float64)
        places = [list(at) for at in np.ndindex(array.shape)] if array.ndim else [""]
        names += [f"{value}{at}" for at in places]
        numbers += array.ravel().tolist()
    message = build.joints(stamp, names, np.array(numbers), NOTHING, NOTHING)
    return message | {"header": build.header(stamp, reading.frame_id)}


def sensor_row(kind: type[SensorDescription]) -> SensorRow:
    """Return the messages of a kind of sensors: as in SENSORS, else every number by its name."""
    units = ", ".join(dict.fromkeys(unit for _, unit in kind.values.values()))
    text = (kind.__doc__ or kind.kind).partition("\n")[0].rstrip(".")
    other = SensorRow(JOINTS, units, f"position: {text[:1].lower()}{text[1:]}", _numbers)
    return SENSORS.get(kind.kind, other)


#: {kind: its messages}, of kinds for which ROS has a type of its own.
SENSORS = {
    "joint_effort": SensorRow(JOINTS, "N m, N", "effort of a motor", _effort),
    "tip_wrench": SensorRow(WRENCH, FORCE, "external load on an instrument", _wrench),
    "contacts": SensorRow(CONTACTS_TYPE, "m, N", "contacts of a body", _touch),
    "proximity": SensorRow(
        JOINTS, "m", "position: distance of an object in the jaw, and gap", _proximity
    ),
    "tension": SensorRow(
        JOINTS, "m, N", "position: length of an elastic band; effort: its tension", _tension
    ),
    "imu": SensorRow(
        "sensor_msgs/Imu", "rad/s, m/s^2", "angular velocity, and acceleration less gravity", _imu
    ),
    "twist": SensorRow(TWIST, SPEED, "velocity of a place on a link", _twist),
}
