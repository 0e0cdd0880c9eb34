"""Messages of others in a recording: images, for instance, which the simulation does not know."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Extra:
    """A message that somebody lets be written into a recording.

    Attributes:
        topic: "/endoscope/left/image_raw/compressed"
        schema: its type as ROS 2 names it: "sensor_msgs/msg/CompressedImage"
        text: the type's definition, with all that it is made of
        time: simulation time [s]
        data: the message, CDR
    """

    topic: str
    schema: str
    text: str
    time: float
    data: bytes
