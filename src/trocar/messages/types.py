"""Types of messages and services: their definitions, with ROS 1's md5 sums and both texts.

A definition is the ROS 2 flavour of .msg, with ROS 1's differences noted: `#ros1 uint32 seq` on a
line of its own is a field that only ROS 1 has, which carries nothing; `float64[] d #ros1 D` has
another name in ROS 1. Any other `#` begins a comment.

Source of the fields: ROS's common messages as ROS 1 Noetic and ROS 2 Humble and Jazzy have them;
crtk_msgs 1.3.0 (github.com/collaborative-robotics/crtk_msgs); cisst_msgs
(github.com/jhu-cisst/cisst-ros). Ours are trocar_msgs.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sized
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from trocar.errors import InputError, UnknownNameError

# Name -> format letter of `struct`. Source: ROS message description language, both editions.
SCALARS = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
# ROS 2's names of ROS 1's built-in types.
TIMES = {"builtin_interfaces/Time": "time", "builtin_interfaces/Duration": "duration"}
ROS1_MARK = "#ros1 "
CONSTANT = re.compile(r"(?P<type>\w+)\s+(?P<name>\w+)\s*=\s*(?P<value>-?\d+)")
LINE = re.compile(r"(?P<type>[\w/]+)(?P<array>\[(?P<length>\d*)\])?\s+(?P<name>\w+)")
Message = dict[str, Any]
REALS = ("float32", "float64")
SECOND = 1_000_000_000
# The largest float32. Source: IEEE 754.
FLOAT32_MAX = float(np.finfo(np.float32).max)
FOLDER = Path(__file__).parent / "definitions"
# Between the parts of a text with all that it depends on. Source: genmsg, `compute_full_text`.
RULE = "=" * 80
# As much of a wrong value as an error repeats. Source: our own choice, a line of a terminal.
LONGEST = 60


class MessageError(InputError):
    """A message, or bytes of one, that cannot be used.

    Args:
        kind: the type's name, such as "sensor_msgs/JointState"
        path: the field, such as "header.stamp" or "position[2]"; "" for the whole
        problem: what was got and what is allowed
    """

    def __init__(self, kind: str, path: str, problem: str) -> None:
        self.kind = kind
        self.path = path
        self.problem = problem
        super().__init__(": ".join(filter(None, [kind, path, problem])))


def shown(value: object) -> str:
    """Return a value as text that fits one line, however large it is."""
    if value is None or isinstance(value, bool | float):
        return repr(value)
    if isinstance(value, int):
        return repr(value) if value.bit_length() < 128 else "a huge integer"
    if isinstance(value, str):
        return repr(value if len(value) <= LONGEST else value[:LONGEST] + "...")
    if isinstance(value, bytes | bytearray | list | tuple | dict):
        return f"{type(cast(object, value)).__name__} of {len(cast(Sized, value))}"
    return type(value).__name__


@dataclass(frozen=True)
class Field:
    """One field of a message.

    Args:
        name: as messages in memory and ROS 2 have it
        type: a scalar ("float64"), "string", "time", "duration" or a message ("std_msgs/Header")
        length: None for one value, 0 for any number, else how many
        ros1_name: as ROS 1 has it
        only_ros1: it stands on ROS 1's wire only and is always zero
    """

    name: str
    type: str
    length: int | None
    ros1_name: str
    only_ros1: bool = False

    @property
    def is_message(self) -> bool:
        """Whether it is a message in the message."""
        return "/" in self.type

    @property
    def ros1_type(self) -> str:
        """The type in ROS 1's words, brackets included, such as "float64[9]"."""
        return self.type + self.brackets

    @property
    def ros2_type(self) -> str:
        """The type in ROS 2's words, brackets included, such as "builtin_interfaces/Time"."""
        names = {short: full for full, short in TIMES.items()}
        return names.get(self.type, self.type) + self.brackets

    @property
    def brackets(self) -> str:
        """Nothing for one value, "[]" for any number, "[9]" for nine."""
        return "" if self.length is None else f"[{self.length or ''}]"

    def text(self, ros1: bool) -> str:
        """The line of a definition, in the words of one edition of ROS."""
        if ros1:
            return f"{self.ros1_type} {self.ros1_name}"
        return f"{self.ros2_type} {self.name}"


@dataclass(frozen=True)
class Constant:
    """A number that a definition gives a name; no wire carries it."""

    name: str
    type: str
    value: int

    def text(self) -> str:
        """The line of a definition, in the form that ROS 1 hashes."""
        return f"{self.type} {self.name}={self.value}"


def read_constants(text: str) -> tuple[Constant, ...]:
    """The constants of a definition, in order."""
    found = (CONSTANT.fullmatch(line.strip()) for line in text.splitlines())
    return tuple(Constant(f["name"], f["type"], int(f["value"])) for f in found if f)


def read_field(line: str, where: str) -> Field:
    """One field from one line, comments allowed.

    Raises:
        InputError: the line is no field; `where` names its file
    """
    only_ros1 = line.startswith(ROS1_MARK)
    text, _, remark = line.removeprefix(ROS1_MARK).partition("#")
    found = LINE.fullmatch(text.strip())
    if found is None:
        raise InputError(f"{where}: got {line!r}; allowed: a field, e.g. 'float64[] position'")
    kind = TIMES.get(found["type"], found["type"])
    if "/" not in kind and kind not in {*SCALARS, "string", "time", "duration"}:
        raise InputError(
            f"{where}: {found['name']}: no type {kind!r}; allowed: message types with their package"
        )
    length = int(found["length"] or 0) if found["array"] else None
    if length and not (kind in SCALARS or "/" in kind):
        raise InputError(f"{where}: {found['name']}: got {length} of {kind}; allowed: []")
    mark = ROS1_MARK.removeprefix("#")
    ros1_name = remark.removeprefix(mark).strip() if remark.startswith(mark) else found["name"]
    return Field(found["name"], kind, length, ros1_name, only_ros1)


def read_fields(text: str, where: str) -> tuple[Field, ...]:
    """The fields of a definition, in order.

    Raises:
        InputError: a line that is no field
    """
    lines = (line.strip() for line in text.splitlines())
    return tuple(
        read_field(line, where)
        for line in lines
        if line.startswith(ROS1_MARK)
        or (line and not line.startswith("#") and not CONSTANT.fullmatch(line))
    )


@dataclass(frozen=True, eq=False)
class MessageType:
    """One type of message.

    Args:
        name: such as "sensor_msgs/JointState"; a service's halves end in Request and Response
        fields: in order, those that only ROS 1 has included
        constants: in order
        text_ros1: definition in ROS 1's words, followed by those of all that it depends on
        text_ros2: the same in ROS 2's words
        md5: ROS 1's checksum
        ros2_name: such as "sensor_msgs/msg/JointState"
        dds_name: such as "sensor_msgs::msg::dds_::JointState_"
    """

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...]
    text_ros1: str
    text_ros2: str
    md5: str
    ros2_name: str
    dds_name: str


@dataclass(frozen=True, eq=False)
class ServiceType:
    """One type of service: its two messages and ROS 1's checksum of both."""

    name: str
    request: MessageType
    response: MessageType
    md5: str
    ros2_name: str


def message_type(name: str | MessageType) -> MessageType:
    """The type of a message, by ROS 1's or by ROS 2's name.

    Raises:
        UnknownNameError: there is none of that name
    """
    if isinstance(name, MessageType):
        return name
    short = name.replace("/msg/", "/", 1)
    if short not in _texts():
        raise UnknownNameError("message type", name, message_names())
    return _message(short)


def service_type(name: str | ServiceType) -> ServiceType:
    """The type of a service, by ROS 1's or by ROS 2's name.

    Raises:
        UnknownNameError: there is none of that name
    """
    if isinstance(name, ServiceType):
        return name
    short = name.replace("/srv/", "/", 1)
    if short not in service_names():
        raise UnknownNameError("service type", name, service_names())
    return _service(short)


@cache
def message_names() -> tuple[str, ...]:
    """Every message that is no half of a service, sorted."""
    return tuple(sorted(_name(path) for path in FOLDER.rglob("*.msg")))


@cache
def service_names() -> tuple[str, ...]:
    """Every service, sorted."""
    return tuple(sorted(_name(path) for path in FOLDER.rglob("*.srv")))


def _name(path: Path) -> str:
    return f"{path.parent.name}/{path.stem}"


@cache
def _texts() -> dict[str, str]:
    """The text of every definition, both halves of a service under their own names."""
    texts = {_name(path): path.read_text(encoding="utf-8") for path in FOLDER.rglob("*.msg")}
    for path in FOLDER.rglob("*.srv"):
        request, response = f"\n{path.read_text(encoding='utf-8')}".split("\n---", 1)
        texts[f"{_name(path)}Request"] = request
        texts[f"{_name(path)}Response"] = response
    return texts


@cache
def _fields(name: str) -> tuple[Field, ...]:
    return read_fields(_texts()[name], name)


@cache
def _constants(name: str) -> tuple[Constant, ...]:
    return read_constants(_texts()[name])


def _md5_text(name: str) -> str:
    """Return the text that ROS 1 hashes: constants, then fields, a message's sum for its type."""
    fields = [
        f"{_md5(field.type)} {field.ros1_name}" if field.is_message else field.text(ros1=True)
        for field in _fields(name)
    ]
    return "\n".join([*(constant.text() for constant in _constants(name)), *fields])


@cache
def _md5(*names: str) -> str:
    text = "".join(map(_md5_text, names))
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


def _depends(name: str) -> list[str]:
    """Every message inside a message, at any depth, each once, in the order of first mention."""
    found: list[str] = []
    for field in _fields(name):
        if field.is_message:
            found += [field.type, *_depends(field.type)]
    return list(dict.fromkeys(found))


def _full_text(name: str, *, ros1: bool) -> str:
    def lines(of: str) -> str:
        fields = [f.text(ros1) for f in _fields(of) if ros1 or not f.only_ros1]
        constants = [constant.text() for constant in _constants(of)]
        return "".join(f"{line}\n" for line in [*constants, *fields])

    parts = [f"{RULE}\nMSG: {other}\n{lines(other)}" for other in _depends(name)]
    return "\n".join([lines(name), *parts])


@cache
def _message(name: str) -> MessageType:
    package, own = name.split("/")
    folder, ros2 = "msg", own
    if name not in message_names():
        half = "Request" if own.endswith("Request") else "Response"
        folder, ros2 = "srv", f"{own.removesuffix(half)}_{half}"
    return MessageType(
        name=name,
        fields=_fields(name),
        constants=_constants(name),
        text_ros1=_full_text(name, ros1=True),
        text_ros2=_full_text(name, ros1=False),
        md5=_md5(name),
        ros2_name=f"{package}/{folder}/{ros2}",
        dds_name=f"{package}::{folder}::dds_::{ros2}_",
    )


@cache
def _service(name: str) -> ServiceType:
    package, own = name.split("/")
    halves = f"{name}Request", f"{name}Response"
    request, response = map(_message, halves)
    return ServiceType(name, request, response, _md5(*halves), f"{package}/srv/{own}")


def integer_range(kind: str) -> tuple[int, int]:
    """The least and the greatest value of an integer type such as "uint8"."""
    bits = int(kind.lstrip("uint"))
    return (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


RANGES = {kind: integer_range(kind) for kind in SCALARS if "int" in kind}


def blank(kind: str | MessageType) -> Message:
    """A new message of a type with zeros, empty strings and empty arrays."""
    fields = message_type(kind).fields
    return {field.name: blank_field(field) for field in fields if not field.only_ros1}


def blank_field(field: Field) -> Any:
    """Return the value of a field that was not set."""
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
