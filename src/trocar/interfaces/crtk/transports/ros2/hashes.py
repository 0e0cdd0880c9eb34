"""The hash of a type that ROS 2 compares since Iron: RIHS01.

Source: REP-2016 and rosidl_generator_type_description: SHA-256 of the type's description as
JSON, `FieldType` numbers of type_description_interfaces.
"""

from __future__ import annotations

import json
from functools import cache
from hashlib import sha256
from typing import Any

from trocar.interfaces.crtk.messages import Field, MessageType, message_type

NESTED = 1
NUMBERS = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "string": 17,
}
ARRAY = 48
SEQUENCE = 144
# Messages that our definitions have as one word.
WORDS = {
    "time": ("builtin_interfaces/msg/Time", ("sec", "int32"), ("nanosec", "uint32")),
    "duration": ("builtin_interfaces/msg/Duration", ("sec", "int32"), ("nanosec", "uint32")),
}
# What a message without fields carries in ROS 2: one octet. Source: rosidl.
FILLER = ("structure_needs_at_least_one_member", "uint8")


@cache
def type_hash(kind: MessageType) -> str:
    """Return "RIHS01_..." of a message, or of one half of a service."""
    others: dict[str, Any] = {}
    own = _description(kind, others)
    text = json.dumps(
        {
            "type_description": own,
            "referenced_type_descriptions": [others[name] for name in sorted(others)],
        }
    )
    return f"RIHS01_{sha256(text.encode()).hexdigest()}"


def _description(kind: MessageType, others: dict[str, Any]) -> dict[str, Any]:
    fields = [_field(field, others) for field in kind.fields if not field.only_ros1]
    return {"type_name": kind.ros2_name, "fields": fields or [_plain(*FILLER)]}


def _field(field: Field, others: dict[str, Any]) -> dict[str, Any]:
    entry = _plain(field.name, field.type)
    kind = entry["type"]
    if field.is_message:
        inner = message_type(field.type)
        kind["nested_type_name"] = inner.ros2_name
        if inner.ros2_name not in others:
            others[inner.ros2_name] = _description(inner, others)
    elif field.type in WORDS:
        name, *members = WORDS[field.type]
        kind["nested_type_name"] = name
        others[name] = {"type_name": name, "fields": [_plain(*member) for member in members]}
    if field.length is not None:
        kind["type_id"] += ARRAY if field.length else SEQUENCE
        kind["capacity"] = field.length
    return entry


def _plain(name: str, kind: str) -> dict[str, Any]:
    return {
        "name": name,
        "type": {
            "type_id": NUMBERS.get(kind, NESTED),
            "capacity": 0,
            "string_capacity": 0,
            "nested_type_name": "",
        },
    }
