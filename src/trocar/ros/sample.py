"""Samples of a world: copied in the loop's thread, so that all else is computed outside of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import transform
from trocar.ros.clock import Stamp
from trocar.ros.period_statistics import PeriodStatistics
from trocar.simulation.readout import ArmReadout, Readout
from trocar.simulation.records import ArmSample, WorldSample

if TYPE_CHECKING:
    from trocar.simulation import SensorReading, World
    from trocar.simulation.grasps import Grasp
    from trocar.simulation.objects import ObjectStates
    from trocar.simulation.probes import ContactTable

Array = NDArray[np.float64]
CONTACTS = "scene/contacts"


def sensor_topic(name: str) -> str:
    """Return the topic of a sensor; what a topic's name may not have becomes an underscore."""
    return f"sensors/{re.sub('[^A-Za-z0-9_]', '_', name)}"


@dataclass(frozen=True)
class Event:
    """An event between two samples.

    Attributes:
        name: its topic
        fields: its message without a header
        stamp: its time; the sample's own where it is None
    """

    name: str
    fields: Mapping[str, Any]
    stamp: Stamp | None = None


@dataclass(frozen=True, eq=False)
class SceneSample:
    """Objects, contacts and sensors at one moment.

    Attributes:
        objects: all of them, None where the rig has none
        contacts: all of them, None without a subscriber
        readings: {sensor: its reading}, of those with subscribers
        grasps: {arm: what its jaw has between its pads}
    """

    objects: ObjectStates | None = None
    contacts: ContactTable | None = None
    readings: Mapping[str, SensorReading] = field(default_factory=dict[str, "SensorReading"])
    grasps: Mapping[str, Grasp] = field(default_factory=dict[str, "Grasp"])

    def object_poses(self) -> dict[str, Array]:
        """Return the poses of objects in the world, {name: (4, 4)}."""
        if self.objects is None:
            return {}
        at = transform(matrix_from_quaternion(self.objects.quaternions), self.objects.positions)
        return dict(zip(self.objects.names, at, strict=True))


def scene_sample(world: World, wanted: frozenset[str]) -> SceneSample:
    """Copy a scene, in the thread that steps it.

    Args:
        world: the world
        wanted: topics with subscribers; contacts and sensors are computed only for these
    """
    sensors = [name for name in world.sensors if sensor_topic(name) in wanted]
    return SceneSample(
        world.object_states() if world.objects else None,
        world.contact_table() if CONTACTS in wanted else None,
        {name: world.sensor(name) for name in sensors},
        world.grasps(),
    )


@dataclass(frozen=True, eq=False)
class Sample:
    """A world at one moment.

    Attributes:
        stamp: of every message that is made from it
        elapsed: time since the loop began, pauses included [s]
        world: source of every reading
        events: what happened since the sample before, oldest first
        scene: objects, and those contacts and sensors with subscribers
        cameras: {name: its place}, when images of this moment follow; tf is published then
        due_s: when its messages are to go out, by the loop's clock; None: at once [s]
    """

    stamp: Stamp
    elapsed: float
    world: WorldSample
    events: tuple[Event, ...] = ()
    scene: SceneSample = field(default_factory=SceneSample)
    cameras: Mapping[str, Any] = field(default_factory=dict[str, Any])
    due_s: float | None = None

    @property
    def rig(self) -> RigDescription:
        """The rig with its tools as they were."""
        return self.world.model.rig

    @property
    def arms(self) -> Mapping[str, ArmSample]:
        """{name: source of its readings}."""
        return self.world.arms


@dataclass(frozen=True, eq=False)
class SampleReadings:
    """A sample and the readings of its arms: the source of messages.

    Attributes:
        sample, readout: as above
        statistics: periods, by what they are of
    """

    sample: Sample
    readout: Readout
    statistics: Mapping[str, PeriodStatistics] = field(default_factory=dict[str, PeriodStatistics])

    def arm(self, name: str) -> ArmReadout:
        """Return the readings of an arm."""
        return self.readout.arm(name)
