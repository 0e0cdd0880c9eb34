"""The topic of each kind of sensor, and the message that its readings become: a row each."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.sensors import (
    ContactsReading,
    EffortReading,
    Imu,
    ImuReading,
    JointEffort,
    ProximityReading,
    TwistReading,
    WrenchReading,
)
from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.arm_rows import FORCE, JOINTS, SPEED, TWIST, WRENCH
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.say import Message

Array = NDArray[np.float64]

CONTACTS = "trocar_msgs/Contacts"
NOTHING = np.zeros(0)
#: Source: sensor_msgs/Imu: the orientation is not measured.
UNMEASURED = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


@dataclass(frozen=True)
class SensorRow:
    """How sensors of a kind are published.

    Attributes:
        type: of the message
        unit: of its numbers
        help: what it tells
        make: returns the message of (reading, sensor, stamp)
    """

    type: str
    unit: str
    help: str
    make: Callable[[Any, Any, Stamp], Message]


def sensor_topic(name: str) -> str:
    """Return the topic of a sensor; what a topic's name may not have becomes an underscore."""
    return f"sensors/{re.sub('[^A-Za-z0-9_]', '_', name)}"


def contact(
    body: str, other: str, point: Array, normal: Array, force: Array, depth: float
) -> Message:
    """Return a trocar_msgs/Contact: the force is what the first does to the second."""
    return {
        "first": other,
        "second": body,
        "point": say.vector(point),
        "normal": say.vector(normal),
        "force": say.vector(force),
        "depth": float(depth),
    }


def _effort(reading: EffortReading, sensor: JointEffort, stamp: Stamp) -> Message:
    return say.joints(stamp, [sensor.joint], NOTHING, NOTHING, np.array([reading.effort]))


def _wrench(reading: WrenchReading, _: object, stamp: Stamp) -> Message:
    both = np.concatenate([reading.force, reading.torque])
    return say.wrench_stamped(stamp, reading.frame_id, both)


def _contacts(reading: ContactsReading, _: object, stamp: Stamp) -> Message:
    return {
        "header": say.header(stamp, reading.frame_id),
        "contacts": [
            contact(c.body, c.other, c.point, c.normal, c.force, c.depth) for c in reading.contacts
        ],
    }


def _proximity(reading: ProximityReading, _: object, stamp: Stamp) -> Message:
    lengths = np.array([reading.distance, reading.gap])
    return say.joints(stamp, ["distance", "gap"], lengths, NOTHING, NOTHING)


def _imu(reading: ImuReading, sensor: Imu, stamp: Stamp) -> Message:
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


def _twist(reading: TwistReading, _: object, stamp: Stamp) -> Message:
    both = np.concatenate([reading.linear, reading.angular])
    return say.twist_stamped(stamp, reading.frame_id, both)


#: {kind: how it is published}; one for each kind of `trocar.descriptions.sensors`.
SENSOR_ROWS = {
    "joint_effort": SensorRow(JOINTS, "N m, N", "effort of a motor", _effort),
    "tip_wrench": SensorRow(WRENCH, FORCE, "what the environment does to an instrument", _wrench),
    "contacts": SensorRow(CONTACTS, "m, N", "where something is touched", _contacts),
    "proximity": SensorRow(
        JOINTS, "m", "position: distance of what lies in the jaw, and its gap", _proximity
    ),
    "imu": SensorRow(
        "sensor_msgs/Imu", "rad/s, m/s^2", "angular velocity, and acceleration less gravity", _imu
    ),
    "twist": SensorRow(TWIST, SPEED, "velocity of a place on a link", _twist),
}
