"""The model in time."""

from trocar.descriptions.sensor_records import Contact, SensorReading
from trocar.descriptions.sensors import (
    ContactsReading,
    EffortReading,
    ImuReading,
    ProximityReading,
    TwistReading,
    WrenchReading,
)
from trocar.simulation.batch import Batch, Readings
from trocar.simulation.world import State, World

__all__ = [
    "Batch",
    "Contact",
    "ContactsReading",
    "EffortReading",
    "ImuReading",
    "ProximityReading",
    "Readings",
    "SensorReading",
    "State",
    "TwistReading",
    "World",
    "WrenchReading",
]
