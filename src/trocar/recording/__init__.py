"""Record a world, and read recordings."""

from trocar.recording.mcap_file import Extra
from trocar.recording.reader import (
    ArmStates,
    Recorded,
    is_mcap,
    is_recording,
    mcap_messages,
    mcap_topics,
    open_recording,
)
from trocar.recording.recorder import Recorder, record, recorder_of

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
    "record",
    "recorder_of",
]
