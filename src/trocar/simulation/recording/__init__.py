"""Record a world, and read recordings."""

from trocar.simulation.recording.extras import Extra
from trocar.simulation.recording.reading import (
    ArmStates,
    Recorded,
    is_mcap,
    is_recording,
    mcap_messages,
    mcap_topics,
    open_recording,
)
from trocar.simulation.recording.recorder import Recorder

__all__ = [
    "ArmStates",
    "Extra",
    "Recorded",
    "Recorder",
    "is_mcap",
    "is_recording",
    "mcap_messages",
    "mcap_topics",
    "open_recording",
]
