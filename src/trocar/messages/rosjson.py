"""Messages as JSON, as rosbridge has them.

A time has both editions' names (secs, nsecs and sec, nanosec), a camera's matrices too (K and k);
uint8[] is base64; what JSON has no number for (NaN, infinities) is null.
"""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable, Sequence
from functools import cache, partial
from operator import attrgetter
from typing import Annotated, Any, cast

import msgspec
import numpy as np
from msgspec import Meta

from trocar.messages.types import (
    FLOAT32_MAX,
    RANGES,
    REALS,
    SECOND,
    Field,
    Message,
    MessageError,
    MessageType,
    blank_field,
    fields_by_name,
    message_type,
    shown,
)

WRONG = (KeyError, TypeError, ValueError, AttributeError, OverflowError)

#: Raised for JSON that is no message of a type.
REJECTED = (msgspec.ValidationError, msgspec.DecodeError, UnicodeError, OverflowError)
#: A step of a path of msgspec: a field, or an index.
STEP = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")
#: Types of single values in JSON; text that every wire can carry has no NUL and is valid UTF-8.
SINGLE: dict[str, Any] = {
    "bool": bool,
    "string": Annotated[str, Meta(pattern=r"^[^\0\ud800-\udfff]*\Z")],
    "float64": float,
}

#: Every empty float64[]: an array is not made for each.
EMPTY = np.zeros(0)
EMPTY.setflags(write=False)

Writer = Callable[[Any], Any]
Plain = Callable[[Any], Message]

_readers: dict[object, tuple[Any, Plain]] = {}
_writers: dict[tuple[str | MessageType, bool], Writer] = {}


def to_json(kind: str | MessageType, message: Message, *, arrays: bool = False) -> dict[str, Any]:
    """Convert a message to plain values for `json.dumps`.

    Args:
        kind: its type
        message: its fields
        arrays: leave real numbers and arrays of them as they are, for a writer that takes arrays
            and writes null for what is no number: in a quarter of the time

    Raises:
        MessageError: the message is not of the type
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
        problem = f"cannot be written: {type(error).__name__}: {error}"
        raise MessageError(message_type(kind).name, "", problem) from None


def from_json(kind: str | MessageType, given: object) -> Message:
    """A message from JSON; fields that are not there are zero.

    Args:
        kind: its type
        given: what `json.loads` returns, or the text as bytes or `msgspec.Raw`

    Raises:
        MessageError: which field, what was got and what is allowed
    """
    reader = _readers.get(kind)
    if reader is None:
        known = message_type(kind)
        reader = _readers[kind] = _struct(known), _plain(known)
    struct, plain = reader
    try:
        if isinstance(given, (bytes, msgspec.Raw)):
            return plain(msgspec.json.decode(given, type=struct))
        return plain(msgspec.convert(given, struct))
    except REJECTED as error:
        return _from_json_slowly(message_type(kind), struct, plain, given, error)


def _from_json_slowly(
    kind: MessageType, struct: Any, plain: Plain, given: Any, error: Exception
) -> Message:
    """Read a message with null among its numbers, or raise what is wrong with it."""
    try:
        if isinstance(given, (bytes, msgspec.Raw)):
            given = msgspec.json.decode(given)
        return plain(msgspec.convert(_with_nan(given), struct))
    except (*REJECTED, RecursionError):
        raise _rejected(kind, given, str(error)) from None


def _with_nan(given: Any) -> Any:
    """Replace null by NaN, which JSON has no number for."""
    if isinstance(given, dict):
        known = cast(dict[str, Any], given)
        return {name: _with_nan(value) for name, value in known.items()}
    if isinstance(given, list | tuple):
        return [_with_nan(value) for value in cast(Sequence[Any], given)]
    return math.nan if given is None else given


def _rejected(kind: MessageType, given: Any, text: str) -> MessageError:
    """Return an error with the path that msgspec found, the value there, and what is allowed."""
    problem, _, at = text.partition(" - at `")
    path = at.rstrip("`").removeprefix("$").removeprefix(".") if at.startswith("$") else ""
    value: Any = given
    for name, index in STEP.findall(path):
        held: object = value
        if isinstance(held, dict):
            field = fields_by_name(kind).get(name)
            if field is not None and field.is_message:
                kind = message_type(field.type)
        value = value[int(index)] if index else value.get(name)
    if problem.startswith("Object contains unknown field"):
        problem = f"{problem[0].lower()}{problem[1:]}; known: {', '.join(fields_by_name(kind))}"
    else:
        problem = f"got {shown(value)}, {problem[0].lower()}{problem.partition(', got')[0][1:]}"
    return MessageError(message_type(kind).name, path, problem)


@cache
def _struct(kind: MessageType) -> Any:
    """The msgspec type that JSON of a message is checked against, all fields optional."""
    fields: list[tuple[str, Any, Any]] = []
    for field in kind.fields:
        given, default = _json_type(field), _default(field)
        if field.ros1_name != field.name:
            fields.append((field.ros1_name, given | msgspec.UnsetType, msgspec.UNSET))
            given, default = given | msgspec.UnsetType, msgspec.UNSET
        fields.append((field.name, given, default))
    return msgspec.defstruct(kind.name.replace("/", "_"), fields, forbid_unknown_fields=True)


class _Time(msgspec.Struct, forbid_unknown_fields=True):
    """A time or duration, by the names of either edition."""

    secs: Annotated[int, Meta(ge=-(2**31), lt=2**31)] = 0
    nsecs: Annotated[int, Meta(ge=0, lt=SECOND)] = 0
    sec: Annotated[int, Meta(ge=-(2**31), lt=2**31)] = 0
    nanosec: Annotated[int, Meta(ge=0, lt=SECOND)] = 0


class _PositiveTime(_Time, forbid_unknown_fields=True):
    secs: Annotated[int, Meta(ge=0, lt=2**31)] = 0
    sec: Annotated[int, Meta(ge=0, lt=2**31)] = 0


def _json_type(field: Field) -> Any:
    single: Any
    if field.is_message:
        single = _struct(message_type(field.type))
    elif field.type in RANGES:
        least, most = RANGES[field.type]
        single = Annotated[int, Meta(ge=least, le=most)]
    elif field.type == "float32":
        single = Annotated[float, Meta(ge=-FLOAT32_MAX, le=FLOAT32_MAX)]
    elif field.type in ("time", "duration"):
        single = _PositiveTime if field.type == "time" else _Time
    else:
        single = SINGLE[field.type]
    if field.length is None:
        return single
    size = Meta(min_length=field.length, max_length=field.length) if field.length else Meta()
    many = Annotated[list[single], size]
    listed: Any = many
    return Annotated[bytes, size] | listed if field.type == "uint8" else many


def _default(field: Field) -> Any:
    blank = blank_field(field)
    if field.is_message and field.length is None:
        return msgspec.field(default_factory=_struct(message_type(field.type)))
    if field.type in ("time", "duration"):
        return msgspec.field(default_factory=_json_type(field))
    if field.length is None:
        return blank
    if field.is_message:
        struct, count = _struct(message_type(field.type)), field.length or 0
        return msgspec.field(default_factory=lambda: [struct() for _ in range(count)])
    return msgspec.field(default_factory=lambda: list(blank_field(field)))


@cache
def _plain(kind: MessageType) -> Plain:
    """Return the function that makes the dict in memory of a checked message."""
    own = [field for field in kind.fields if not field.only_ros1]
    names = [field.name for field in own]
    if not names:
        return lambda _: {}
    get = attrgetter(*names) if len(names) > 1 else _one(names[0])
    special = [
        (f.name, made, EMPTY if f.type == "float64" else None)
        for f in own
        if (made := _plain_field(f)) is not None
    ]
    renamed = [(f.name, f.ros1_name, list(blank_field(f))) for f in own if f.ros1_name != f.name]

    def plain(checked: Any) -> Message:
        message = dict(zip(names, get(checked)))  # noqa: B905  as many, and a third faster
        for name, older, blank in renamed:
            if message[name] is msgspec.UNSET:
                found = getattr(checked, older)
                message[name] = blank if found is msgspec.UNSET else found
        for name, made, empty in special:
            value = message[name]
            message[name] = made(value) if value or empty is None else empty
        return message

    return plain


def _one(name: str) -> Callable[[Any], tuple[Any]]:
    return lambda checked: (getattr(checked, name),)


def _plain_field(field: Field) -> Writer | None:
    if field.type in ("time", "duration"):
        return lambda time: (time.secs or time.sec, time.nsecs or time.nanosec)
    if field.is_message:
        made = _plain(message_type(field.type))
        return made if field.length is None else lambda values: [made(value) for value in values]
    if field.length is None:
        return None
    return {"uint8": bytes, "float64": partial(np.array, dtype=float)}.get(field.type)


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
