"""Messages as JSON, as rosbridge has them.

A time has both editions' names (secs, nsecs and sec, nanosec), a camera's matrices too (K and k);
uint8[] is base64; what JSON has no number for (NaN, infinities) is null.
"""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from trocar.interfaces.crtk.messages.catalogue import MessageType, message_type
from trocar.interfaces.crtk.messages.checking import (
    REALS,
    Message,
    blank_field,
    check,
    check_names,
    fields_by_name,
    scalar_problem,
)
from trocar.interfaces.crtk.messages.definition import Field
from trocar.interfaces.crtk.messages.errors import MessageError, shown

TIME_NAMES = ("secs", "sec"), ("nsecs", "nanosec")
ALL_TIME_NAMES = dict.fromkeys(name for names in TIME_NAMES for name in names)
WRONG = (KeyError, TypeError, ValueError, AttributeError, OverflowError)

Writer = Callable[[Any], Any]

_writers: dict[tuple[str | MessageType, bool], Writer] = {}


def to_json(kind: str | MessageType, message: Message, *, arrays: bool = False) -> dict[str, Any]:
    """What `json.dumps` takes for a message.

    Args:
        kind: its type
        message: its fields
        arrays: leave real numbers and arrays of them as they are, for a writer that takes arrays
            and writes null for what is no number: in a quarter of the time

    Raises:
        MessageError: the message is none of the type
    """
    write = _writers.get((kind, arrays))
    if write is None:
        known = message_type(kind)
        write = _message_writer(known, arrays)
        for name in (known, known.name, known.ros2_name):
            _writers[name, arrays] = write
    try:
        return write(message)
    except WRONG as error:
        check(kind, message)
        name = message_type(kind).name
        raise MessageError(name, "", f"cannot be written: {error}") from None


def from_json(kind: str | MessageType, given: object) -> Message:
    """A message from what `json.loads` returns; fields that are not there are zero.

    Raises:
        MessageError: which field, what was got and what is allowed
    """
    known = message_type(kind)
    return _message(known, known, given, "")


def _message_writer(kind: MessageType, arrays: bool) -> Writer:
    """Each field's name and how it is written, or None where it stays as it is."""
    plan = _plan(kind, arrays)
    return lambda message: {
        name: message[own] if write is None else write(message[own]) for name, own, write in plan
    }


def _plan(kind: MessageType, arrays: bool) -> list[tuple[str, str, Writer | None]]:
    return [
        (name, field.name, _field_writer(field, arrays))
        for field in kind.fields
        if not field.only_ros1
        for name in dict.fromkeys((field.ros1_name, field.name))
    ]


def _field_writer(field: Field, arrays: bool) -> Writer | None:
    single = _single_writer(field, arrays)
    if field.length is None:
        return single
    if field.type == "uint8":
        return lambda value: base64.b64encode(bytes(value)).decode()
    if field.type in REALS:
        return None if arrays else _write_reals
    if single is None:
        return lambda values: values.tolist() if isinstance(values, np.ndarray) else list(values)
    return lambda values: [single(value) for value in values]


def _single_writer(field: Field, arrays: bool) -> Writer | None:
    if field.is_message:
        kind = message_type(field.type)
        stays = arrays and all(
            write is None and name == own for name, own, write in _plan(kind, arrays)
        )
        return None if stays else _message_writer(kind, arrays)
    if field.type in ("time", "duration"):
        return _write_time
    if field.type == "string":
        return None
    if field.type in REALS:
        return None if arrays else _write_real
    return bool if field.type == "bool" else int


def _write_time(value: tuple[int, int]) -> dict[str, int]:
    seconds, rest = value
    return {"secs": seconds, "nsecs": rest, "sec": seconds, "nanosec": rest}


def _write_real(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def _write_reals(values: Any) -> list[float | None]:
    given = values.tolist() if isinstance(values, np.ndarray) else values
    return [float(value) if math.isfinite(value) else None for value in given]


def _message(top: MessageType, kind: MessageType, given: object, path: str) -> Message:
    if not isinstance(given, dict):
        raise MessageError(top.name, path, f"got {shown(given)}, an object is allowed")
    check_names(top, path, given, _names(kind))
    dot = f"{path}." if path else ""
    message: Message = {}
    for own, field in fields_by_name(kind).items():
        name = own if own in given else field.ros1_name
        if name in given:
            message[own] = _field(top, field, given[name], f"{dot}{name}")
        else:
            message[own] = blank_field(field)
    return message


@cache
def _names(kind: MessageType) -> dict[str, Field]:
    """Every name that a field may have in JSON, those of ROS 1 included."""
    pairs = [(name, field) for field in kind.fields for name in (field.name, field.ros1_name)]
    return dict(pairs)


def _field(top: MessageType, field: Field, given: Any, path: str) -> Any:
    if field.length is None:
        return _single(top, field, given, path)
    if field.type == "uint8" and isinstance(given, str | bytes | bytearray):
        values: Any = _bytes(top, given, path)
    elif not isinstance(given, list | tuple):
        raise MessageError(top.name, path, f"got {shown(given)}, a list is allowed")
    elif field.type == "float64" and {float}.issuperset(map(type, given)):
        values = given
    else:
        single = enumerate(given)
        values = [_single(top, field, entry, f"{path}[{index}]") for index, entry in single]
    if field.length and len(values) != field.length:
        raise MessageError(top.name, path, f"got {len(values)} values, {field.length} belong there")
    if field.type == "float64":
        return np.array(values, dtype=float)
    return bytes(values) if field.type == "uint8" else values


def _bytes(top: MessageType, given: str | bytes | bytearray, path: str) -> bytes:
    if not isinstance(given, str):
        return bytes(given)
    try:
        return base64.b64decode(given, validate=True)
    except (binascii.Error, ValueError):
        raise MessageError(top.name, path, f"got {shown(given)}, base64 is allowed") from None


def _single(top: MessageType, field: Field, given: Any, path: str) -> Any:
    if type(given) is float and field.type == "float64":
        return given
    if field.is_message:
        return _message(top, message_type(field.type), given, path)
    value: Any = _time(top, given, path) if field.type in ("time", "duration") else given
    if field.type in REALS and value is None:
        return math.nan
    problem = scalar_problem(field.type, value)
    if problem:
        raise MessageError(top.name, path, f"got {shown(given)}, {problem} is allowed")
    return float(value) if field.type in REALS else value


def _time(top: MessageType, given: Any, path: str) -> tuple[Any, Any]:
    if not isinstance(given, dict):
        raise MessageError(top.name, path, f"got {shown(given)}, secs and nsecs are allowed")
    check_names(top, path, given, ALL_TIME_NAMES)
    seconds, rest = (
        next((given[name] for name in names if name in given), 0) for names in TIME_NAMES
    )
    return seconds, rest
