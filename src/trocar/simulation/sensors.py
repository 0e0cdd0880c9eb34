"""The sensors that a rig places. They are asked, never stepped: unread, they cost nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.descriptions.sensor_records import SensorDescription
from trocar.errors import UnknownNameError
from trocar.geometry.se3 import transform
from trocar.modeling import naming
from trocar.modeling.joints import JointTable
from trocar.simulation.arm import Arm
from trocar.simulation.probes import Bodies, Probes, Site
from trocar.simulation.sensor_readings import (
    ContactsReading,
    EffortReading,
    ImuReading,
    ProximityReading,
    Reading,
    WrenchReading,
)

Array = NDArray[np.float64]

UNITS = {
    "tip_wrench": {"force": "N", "torque": "N m"},
    "contacts": {
        "point": "m", "normal": "1", "force": "N", "torque": "N m", "depth": "m",
    },
    "proximity": {"distance": "m", "gap": "m"},
    "imu": {"angular_velocity": "rad/s", "linear_acceleration": "m/s^2"},
}  # fmt: skip
EFFORT_UNITS = {"revolute": {"effort": "N m"}, "prismatic": {"effort": "N"}}
#: A sample is due when its time comes to within this share of its period: rounding of the time.
DUE = 1e-6


@dataclass(frozen=True, eq=False)
class _Held:
    """The last sample of a sensor with a rate: its number, and the generator of its noise."""

    number: int
    rng: np.random.Generator
    reading: Reading


class Sensors:
    """Reads the sensors of one rig.

    Args:
        rig: its description
        table: where its arms are in the model
        model, data: the physics
        arms: by name
        probes: look at the physics
    """

    def __init__(
        self,
        rig: RigDescription,
        table: JointTable,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        arms: Mapping[str, Arm],
        probes: Probes,
    ) -> None:
        self._rig, self._model, self._data = rig, model, data
        self._table, self._arms, self._probes = table, arms, probes
        self._known = {sensor.name: sensor for sensor in rig.sensors}
        self._held: dict[str, _Held] = {}

    def go_on(self, before: Sensors, without: str) -> None:
        """Keep the last samples of the sensors that were read before, but those of one arm."""
        self._held = {
            name: held for name, held in before._held.items() if self._known[name].arm != without
        }

    def save(self) -> dict[str, tuple[int, Reading]]:
        """Return the last samples of sensors with a rate."""
        return {name: (held.number, held.reading) for name, held in self._held.items()}

    def load(self, saved: Mapping[str, tuple[int, Reading]], rng: np.random.Generator) -> None:
        """Take the samples that `save` returned; the next are drawn with a generator."""
        self._held = {
            name: _Held(number, rng, reading) for name, (number, reading) in saved.items()
        }

    def read(self, name: str, rng: np.random.Generator) -> Reading:
        """Return what a sensor tells now, or its last sample while its rate allows no new one.

        Args:
            name: of the sensor
            rng: noise is drawn from it; another generator than before begins anew

        Raises:
            UnknownNameError: no such sensor; the known ones are listed
        """
        sensor = self._known.get(name)
        if sensor is None:
            raise UnknownNameError("sensor", name, self._known, f"rig {self._rig.name}")
        if not sensor.rate:
            return self._sample(sensor, rng)
        number = math.floor(float(self._data.time) * sensor.rate + DUE)
        held = self._held.get(name)
        if held is None or held.number != number or held.rng is not rng:
            held = self._held[name] = _Held(number, rng, self._sample(sensor, rng))
        return held.reading

    def contacts(self) -> ContactsReading:
        """Return every place where two bodies touch, without noise."""
        everything = np.ones(self._model.nbody, dtype=np.bool_)
        return ContactsReading(
            name="contacts",
            kind="contacts",
            time=float(self._data.time),
            frame_id="world",
            units=dict(UNITS["contacts"]),
            contacts=self._probes.contacts(everything),
        )

    def _sample(self, sensor: SensorDescription, rng: np.random.Generator) -> Reading:
        if sensor.kind == "joint_effort":
            return self._joint_effort(sensor, rng)
        if sensor.kind == "tip_wrench":
            return self._tip_wrench(sensor, rng)
        if sensor.kind == "proximity":
            return self._proximity(sensor, rng)
        if sensor.kind == "imu":
            return self._imu(sensor, rng)
        return self._contacts(sensor, rng)

    def _joint_effort(self, sensor: SensorDescription, rng: np.random.Generator) -> Reading:
        arm = self._arms[sensor.arm].description
        kind, joint = arm.joint(sensor.joint).kind, arm.mechanism.joint_index[sensor.joint]
        effort = float(self._arms[sensor.arm].readings()[2][joint])
        return EffortReading(
            **self._head(sensor, naming.scoped(sensor.arm, sensor.joint), EFFORT_UNITS[kind]),
            effort=float(_noisy(np.array(effort), sensor.noise["effort"], rng)),
        )

    def _tip_wrench(self, sensor: SensorDescription, rng: np.random.Generator) -> Reading:
        mine = self._probes.beyond(self._site(sensor.arm, sensor.beyond, np.eye(4)).body)
        site = self._site(sensor.arm, sensor.frame, sensor.pose)
        force, torque = self._probes.wrench(mine, site)
        return WrenchReading(
            **self._head(sensor, sensor.name),
            force=_noisy(force, sensor.noise["force"], rng),
            torque=_noisy(torque, sensor.noise["torque"], rng),
        )

    def _contacts(self, sensor: SensorDescription, rng: np.random.Generator) -> Reading:
        found = [
            replace(contact, force=_noisy(contact.force, sensor.noise["force"], rng))
            for contact in self._probes.contacts(self._touchable(sensor))
        ]
        return ContactsReading(**self._head(sensor, "world"), contacts=tuple(found))

    def _proximity(self, sensor: SensorDescription, rng: np.random.Generator) -> Reading:
        start = self._site(sensor.arm, sensor.frame, sensor.pose)
        end = self._site(sensor.arm, sensor.to_frame, transform(np.eye(3), sensor.to_point))
        distance, gap = self._probes.ray(start, end, self._own(sensor.arm))
        distance = float(_noisy(np.array(distance), sensor.noise["distance"], rng))
        return ProximityReading(
            **self._head(sensor, sensor.name), distance=max(0.0, distance), gap=gap
        )

    def _imu(self, sensor: SensorDescription, rng: np.random.Generator) -> Reading:
        site = self._site(sensor.arm, sensor.frame, sensor.pose)
        angular, linear = self._probes.inertial(site)
        return ImuReading(
            **self._head(sensor, sensor.name),
            angular_velocity=_noisy(angular, sensor.noise["angular_velocity"], rng),
            linear_acceleration=_noisy(linear, sensor.noise["linear_acceleration"], rng),
        )

    def _head(
        self, sensor: SensorDescription, frame_id: str, units: Mapping[str, str] | None = None
    ) -> dict[str, Any]:
        return {
            "name": sensor.name,
            "kind": sensor.kind,
            "time": float(self._data.time),
            "frame_id": frame_id,
            "units": dict(units or UNITS[sensor.kind]),
        }

    def _site(self, arm: str, frame: str, pose: Array) -> Site:
        body, at = self._table.arms[arm].carrier(self._rig.arm(arm), frame)
        return Site(body, at @ pose)

    def _touchable(self, sensor: SensorDescription) -> Bodies:
        """Return the bodies whose contacts a sensor tells: a frame's and beyond, an arm's, all."""
        if sensor.frame:
            return self._probes.beyond(self._site(sensor.arm, sensor.frame, np.eye(4)).body)
        if sensor.arm:
            return self._own(sensor.arm)
        return np.ones(self._model.nbody, dtype=np.bool_)

    def _own(self, arm: str) -> Bodies:
        mine = np.zeros(self._model.nbody, dtype=np.bool_)
        mine[list(self._table.arms[arm].bodies.values())] = True
        return mine


def _noisy(value: Array, deviation: float, rng: np.random.Generator) -> Array:
    """Return a read-only value with normal noise; without noise nothing is drawn."""
    told = value + rng.normal(0.0, deviation, value.shape) if deviation > 0.0 else value
    told = np.asarray(told, dtype=np.float64)
    told.setflags(write=False)
    return told
