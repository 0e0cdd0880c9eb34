"""Messages of ROS 1, ROS 2 and rosbridge, without any of them installed.

A message in memory is a dict in ROS 2's field names: ``{"header": {"stamp": (sec, nanosec),
"frame_id": "ECM"}, "name": ["yaw"], "position": array, ...}``. Times and durations are pairs of
integers, uint8[] is bytes, float64[] may be an array. ROS 1's sequence number does not exist.
"""

from trocar.messages.binary import cdr_decode, cdr_encode, ros1_decode, ros1_encode
from trocar.messages.rosjson import from_json, to_json
from trocar.messages.types import (
    Constant,
    Field,
    MessageError,
    MessageType,
    ServiceType,
    blank,
    message_names,
    message_type,
    service_names,
    service_type,
)

__all__ = [
    "Constant",
    "Field",
    "MessageError",
    "MessageType",
    "ServiceType",
    "blank",
    "cdr_decode",
    "cdr_encode",
    "from_json",
    "message_names",
    "message_type",
    "ros1_decode",
    "ros1_encode",
    "service_names",
    "service_type",
    "to_json",
]
