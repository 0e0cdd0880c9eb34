"""The model in time."""

from trocar.simulation.sensor_readings import (
    Contact,
    ContactsReading,
    EffortReading,
    ImuReading,
    ProximityReading,
    WrenchReading,
)
from trocar.simulation.world import World

__all__ = [
    "Contact",
    "ContactsReading",
    "EffortReading",
    "ImuReading",
    "ProximityReading",
    "World",
    "WrenchReading",
]
