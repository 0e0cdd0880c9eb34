"""Whether a message in memory is one of a type, and where not."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from trocar.interfaces.crtk.messages.types import (
    SCALARS,
    Field,
    MessageError,
    MessageType,
    message_type,
    shown,
)

Message = dict[str, Any]
Names = Mapping[str, object]
REALS = ("float32", "float64")
SECOND = 1_000_000_000
# The largest float32. Source: IEEE 754.
FLOAT32_MAX = float(np.finfo(np.float32).max)


def integer_range(kind: str) -> tuple[int, int]:
    """The least and the greatest value of an integer type such as "uint8"."""
    bits = int(kind.lstrip("uint"))
    return (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


RANGES = {kind: integer_range(kind) for kind in SCALARS if "int" in kind}


def check(kind: str | MessageType, message: object) -> None:
    """Refuse a message that is none of the type: each field there, none unknown, all in range.

    NaN and infinities are numbers here; who may not have them says so itself.

    Raises:
        MessageError: which field, what was got and what is allowed
        UnknownNameError: there is no such type
    """
    known = message_type(kind)
    _message(known, known, message, "")


def blank(kind: str | MessageType) -> Message:
    """A new message of a type with zeros, empty strings and empty arrays."""
    fields = message_type(kind).fields
    return {field.name: blank_field(field) for field in fields if not field.only_ros1}


def blank_field(field: Field) -> Any:
    """What a field holds that nobody has set."""
    if field.length is not None:
        if field.is_message:
            return [blank(field.type) for _ in range(field.length)]
        zero = np.zeros(field.length) if field.type == "float64" else [0] * field.length
        return bytes(field.length) if field.type == "uint8" else zero
    if field.is_message:
        return blank(field.type)
    if field.type in ("time", "duration"):
        return (0, 0)
    return {"string": "", "bool": False}.get(field.type, 0.0 if field.type in REALS else 0)


@cache
def fields_by_name(kind: MessageType) -> dict[str, Field]:
    """The fields that a message in memory has, in order."""
    return {field.name: field for field in kind.fields if not field.only_ros1}


def _message(top: MessageType, kind: MessageType, message: object, path: str) -> None:
    if not isinstance(message, dict):
        raise MessageError(top.name, path, f"got {shown(message)}; allowed: a dict of fields")
    fields = fields_by_name(kind)
    check_names(top, path, message, fields)
    dot = f"{path}." if path else ""
    for name, field in fields.items():
        if name not in message:
            raise MessageError(top.name, f"{dot}{name}", "is missing")
        _field(top, field, message[name], f"{dot}{name}")


def check_names(top: MessageType, path: str, message: dict[Any, Any], known: Names) -> None:
    """Refuse fields that nobody knows."""
    if message.keys() <= known.keys():
        return
    name = next(name for name in message if name not in known)
    allowed = ", ".join(known) or "none"
    raise MessageError(top.name, path, f"unknown field {shown(name)}; known: {allowed}")


def _field(top: MessageType, field: Field, value: Any, path: str) -> None:
    if field.length is None:
        _single(top, field, value, path)
        return
    if isinstance(value, np.ndarray):
        picture = field.type == "uint8" and value.dtype == np.uint8
        wrong = value.ndim != 1 or value.dtype.kind not in "fiu"
        wrong = wrong or (value.dtype.kind == "f" and field.type not in REALS)
        if wrong and not picture:
            got = f"got {value.dtype} of shape {value.shape}"
            raise MessageError(top.name, path, f"{got}; allowed: one row of {field.type}")
    elif not isinstance(value, list | tuple) and not (
        field.type == "uint8" and isinstance(value, bytes | bytearray)
    ):
        raise MessageError(top.name, path, f"got {shown(value)}; allowed: a list")
    if field.length and len(value) != field.length:
        raise MessageError(top.name, path, f"got {len(value)} values; allowed: {field.length}")
    kind = value.dtype.name if isinstance(value, np.ndarray) else "uint8"
    if isinstance(value, np.ndarray | bytes | bytearray) and kind == field.type:
        return  # in range whatever it holds
    for index, entry in enumerate(value):
        _single(top, field, entry, f"{path}[{index}]")


def _single(top: MessageType, field: Field, value: Any, path: str) -> None:
    if field.is_message:
        _message(top, message_type(field.type), value, path)
        return
    problem = scalar_problem(field.type, value)
    if problem:
        raise MessageError(top.name, path, f"got {shown(value)}; allowed: {problem}")


def scalar_problem(kind: str, value: Any) -> str:
    """What would be allowed instead of a value, or "" where it may stay."""
    if kind == "string":
        return "" if isinstance(value, str) and sound_text(value) else "a string without NUL"
    if kind == "bool":
        return "" if isinstance(value, bool | np.bool_) else "true or false"
    if kind in ("time", "duration"):
        return "" if sound_time(kind, value) else f"(seconds, nanoseconds below {SECOND})"
    number = isinstance(value, int | float | np.integer | np.floating)
    if isinstance(value, bool) or not number:
        return "a number" if kind in REALS else "an integer"
    if kind in REALS:
        return "" if sound_real(kind, value) else f"a {kind}"
    least, most = RANGES[kind]
    inside = isinstance(value, int | np.integer) and least <= value <= most
    return "" if inside else f"an integer from {least} to {most}"


def sound_text(text: str) -> bool:
    """Whether every wire can carry a string."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in text


def sound_time(kind: str, value: Any) -> bool:
    """Whether a pair is a time, or a duration."""
    if not isinstance(value, tuple) or len(value) != 2:
        return False
    if not all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in value):
        return False
    least = -(2**31) if kind == "duration" else 0
    return least <= value[0] < 2**31 and 0 <= value[1] < SECOND


def sound_real(kind: str, value: Any) -> bool:
    """Whether a number fits, infinities and NaN included."""
    try:
        number = float(value)
    except OverflowError:
        return False
    infinite = not math.isfinite(number)
    return infinite or kind == "float64" or abs(number) <= FLOAT32_MAX
