"""The sensors that a rig places. They are read, never stepped: unread, they cost nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trocar.descriptions.records import RigDescription
from trocar.descriptions.sensor_records import SensorReading
from trocar.errors import UnknownNameError
from trocar.simulation.probes import Probes

#: A sample is due when its time comes to within this share of its period: rounding of the time.
DUE = 1e-6


@dataclass(frozen=True, eq=False)
class _Held:
    """The last sample of a sensor with a rate: its number, and the generator of its noise."""

    number: int
    rng: np.random.Generator
    reading: SensorReading


class Sensors:
    """Reads the sensors of one rig.

    Args:
        rig: its description
        probes: the physics that they sample
    """

    def __init__(self, rig: RigDescription, probes: Probes) -> None:
        self._rig, self._probes = rig, probes
        self._known = {sensor.name: sensor for sensor in rig.sensors}
        self._held: dict[str, _Held] = {}

    def go_on(self, before: Sensors, without: str) -> None:
        """Keep the last samples of the sensors that were read before, but those of one arm."""
        self._held = {
            name: held for name, held in before._held.items() if self._known[name].arm != without
        }

    def save(self) -> dict[str, tuple[int, SensorReading]]:
        """Return the last samples of sensors with a rate."""
        return {name: (held.number, held.reading) for name, held in self._held.items()}

    def load(
        self, saved: Mapping[str, tuple[int, SensorReading]], rng: np.random.Generator
    ) -> None:
        """Take the samples that `save` returned; the next are drawn with a generator."""
        self._held = {
            name: _Held(number, rng, reading) for name, (number, reading) in saved.items()
        }

    def read(self, name: str, rng: np.random.Generator) -> SensorReading:
        """Return a new sample of a sensor, or its last one while its rate allows no new one.

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
            return sensor.sample(self._probes, rng)
        number = math.floor(self._probes.time * sensor.rate + DUE)
        held = self._held.get(name)
        if held is None or held.number != number or held.rng is not rng:
            held = self._held[name] = _Held(number, rng, sensor.sample(self._probes, rng))
        return held.reading
