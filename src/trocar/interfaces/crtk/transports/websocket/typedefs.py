"""A type of message as rosapi tells it: field by field, the types inside it after it."""

from __future__ import annotations

from typing import Any

from trocar.interfaces.crtk.messages import MessageType, message_type


def typedefs(kind: MessageType) -> list[dict[str, Any]]:
    """Describe a type and every type inside it, each once."""
    found: dict[str, dict[str, Any]] = {}
    waiting = [kind]
    while waiting:
        one = waiting.pop(0)
        if one.name not in found:
            found[one.name] = _typedef(one)
            waiting += [message_type(field.type) for field in one.fields if "/" in field.type]
    return list(found.values())


def _typedef(kind: MessageType) -> dict[str, Any]:
    fields = [field for field in kind.fields if not field.only_ros1]
    return {
        "type": kind.name,
        "fieldnames": [field.ros1_name for field in fields],
        "fieldtypes": [field.type for field in fields],
        "fieldarraylen": [-1 if field.length is None else field.length for field in fields],
        "examples": [
            "[]" if field.length is not None else _example(field.type) for field in fields
        ],
        "constnames": [],
        "constvalues": [],
    }


def _example(kind: str) -> str:
    if "/" in kind or kind in ("time", "duration"):
        return "{}"
    if kind == "string":
        return ""
    return {"bool": "False", "float32": "0.0", "float64": "0.0"}.get(kind, "0")
