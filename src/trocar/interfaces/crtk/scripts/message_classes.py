"""Classes of messages as scripts import them, made from the definitions that transports use.

A script sees ROS 1's names and attributes; `fields_of` and `message_of` turn its messages into the
core's dicts and back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, ClassVar

import numpy as np

from trocar.interfaces.crtk.messages import (
    Field,
    MessageType,
    ServiceType,
    blank,
    message_type,
    service_type,
)
from trocar.interfaces.crtk.scripts.times import Duration, Time

TIMES = {"time": Time, "duration": Duration}
BYTES = "uint8"


class Message:
    """What every class of messages can do; its `__slots__` are the fields."""

    __slots__ = ()
    _type: ClassVar[str] = ""
    _md5sum: ClassVar[str] = ""
    _full_text: ClassVar[str] = ""
    _kind: ClassVar[MessageType]

    def __init__(self, *values: Any, **named: Any) -> None:
        """Take every field in order, or some by name; the others are zero, empty or false."""
        names: tuple[str, ...] = self.__slots__
        if values and (named or len(values) != len(names)):
            raise TypeError(
                f"{self._type}: got {len(values)} values; allowed: one for each of"
                f" {', '.join(names) or 'no field'}, or names"
            )
        unknown = named.keys() - set(names)
        if unknown:
            raise AttributeError(
                f"{self._type} has no field {min(unknown)!r}; known: {', '.join(names)}"
            )
        given: dict[str, Any] = dict(zip(names, values, strict=True)) if values else named
        for field in self._kind.fields:
            name = field.ros1_name
            setattr(self, name, given[name] if name in given else _blank(field))

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and fields_of(self) == fields_of(other)  # type: ignore[arg-type]

    def __hash__(self) -> int:
        return id(self)

    def __repr__(self) -> str:
        return "\n".join(_lines(self, ""))

    def serialize(self, buffer: Any) -> None:
        """Refuse: there is no wire here."""
        raise NotImplementedError(f"{self._type}: messages of a script are not serialised")


@cache
def message_class(name: str) -> type[Message]:
    """Return the class of a type of messages, such as "sensor_msgs/JointState".

    Raises:
        UnknownNameError: there is no such type
    """
    kind = message_type(name)
    package, own = kind.name.split("/")
    constants = {constant.name: constant.value for constant in kind.constants}
    members = {
        **constants,
        "__slots__": tuple(field.ros1_name for field in kind.fields),
        "__module__": f"{package}.msg",
        "__doc__": f"{kind.name}: {', '.join(f.ros1_name for f in kind.fields) or 'no field'}.",
        "_type": kind.name,
        "_md5sum": kind.md5,
        "_full_text": kind.text_ros1,
        "_kind": kind,
    }
    return type(own, (Message,), members)


@cache
def service_class(name: str) -> type:
    """Return the class of a service; `Request` and `Response` are those of its messages.

    Raises:
        UnknownNameError: there is no such type
    """
    kind: ServiceType = service_type(name)
    package, own = kind.name.split("/")
    halves = _half(kind.request), _half(kind.response)
    return type(
        own,
        (),
        {
            "__module__": f"{package}.srv",
            "__doc__": f"The service {kind.name}.",
            "_type": kind.name,
            "_md5sum": kind.md5,
            "_request_class": halves[0],
            "_response_class": halves[1],
            "Request": halves[0],
            "Response": halves[1],
        },
    )


def _half(kind: MessageType) -> type[Message]:
    made = {
        "__slots__": tuple(field.ros1_name for field in kind.fields),
        "__module__": f"{kind.name.split('/')[0]}.srv",
        "_type": kind.name,
        "_kind": kind,
    }
    return type(kind.name.split("/")[1], (Message,), made)


def _blank(field: Field) -> Any:
    if field.length is None:
        if field.is_message:
            return message_class(field.type)()
        if field.type in TIMES:
            return TIMES[field.type]()
        return {"string": "", "bool": False}.get(field.type, 0.0 if "float" in field.type else 0)
    if field.is_message:
        return [message_class(field.type)() for _ in range(field.length)]
    if field.type == BYTES:
        return bytes(field.length)
    return [0.0 if "float" in field.type else 0] * field.length


def fields_of(message: Message) -> dict[str, Any]:
    """Return a message as the core has it: a dict in ROS 2's field names, checked by nobody yet."""
    return {
        field.name: _plain(field, getattr(message, field.ros1_name))
        for field in message._kind.fields
        if not field.only_ros1
    }


def _plain(field: Field, value: Any) -> Any:
    if field.type in TIMES:
        ns = getattr(value, "nanoseconds", None)
        return value if ns is None else divmod(ns, 1_000_000_000)
    if not field.is_message:
        return value.tolist() if isinstance(value, np.ndarray) else value
    if field.length is None:
        return fields_of(value) if isinstance(value, Message) else value
    return [fields_of(one) if isinstance(one, Message) else one for one in value]


def message_of(kind: type[Message], fields: Mapping[str, Any]) -> Any:
    """Return the message that the core's dict is."""
    made = kind.__new__(kind)
    for field in kind._kind.fields:
        if field.only_ros1:
            setattr(made, field.ros1_name, 0)
        else:
            setattr(made, field.ros1_name, _rich(field, fields[field.name]))
    return made


def _rich(field: Field, value: Any) -> Any:
    if field.type in TIMES:
        return TIMES[field.type](*value)
    if field.is_message:
        kind = message_class(field.type)
        if field.length is None:
            return message_of(kind, value)
        return [message_of(kind, one) for one in value]
    if field.length is not None and field.type != BYTES:
        return value.tolist() if isinstance(value, np.ndarray) else list(value)
    return value


def _lines(message: Message, indent: str) -> list[str]:
    found: list[str] = []
    for name in message.__slots__:
        value = getattr(message, name)
        if isinstance(value, Message):
            found += [f"{indent}{name}:", *_lines(value, f"{indent}  ")]
        elif isinstance(value, Sequence) and value and isinstance(value[0], Message):
            found.append(f"{indent}{name}:")
            for one in value:
                found += [f"{indent}  -", *_lines(one, f"{indent}    ")]
        else:
            found.append(f"{indent}{name}: {value!r}")
    return found


def complete(kind: MessageType, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return a message of the core with what was left out, as of an answer of a service."""
    return {**blank(kind), **fields}
