"""The model in time."""

from trocar.simulation.batch import Batch, Readings
from trocar.simulation.sensor_readings import (
    Contact,
    ContactsReading,
    EffortReading,
    ImuReading,
    ProximityReading,
    WrenchReading,
)
from trocar.simulation.world import State, World

__all__ = [
    "Batch",
    "Contact",
    "ContactsReading",
    "EffortReading",
    "ImuReading",
    "ProximityReading",
    "Readings",
    "State",
    "World",
    "WrenchReading",
]
