"""Read the text of a definition: the ROS 2 flavour of .msg, with ROS 1's differences noted.

`#ros1 uint32 seq` on a line of its own is a field that only ROS 1 has, which carries nothing;
`float64[] d #ros1 D` has another name in ROS 1. Any other `#` begins a comment.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from trocar.errors import InputError

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
        InputError: the line is no field; `where` says which file it is of
    """
    only_ros1 = line.startswith(ROS1_MARK)
    text, _, remark = line.removeprefix(ROS1_MARK).partition("#")
    found = LINE.fullmatch(text.strip())
    if found is None:
        raise InputError(f"{where}: got {line!r}, a field reads like 'float64[] position'")
    kind = TIMES.get(found["type"], found["type"])
    if "/" not in kind and kind not in {*SCALARS, "string", "time", "duration"}:
        raise InputError(f"{where}: {found['name']}: no type {kind!r}; messages need their package")
    length = int(found["length"] or 0) if found["array"] else None
    if length and not (kind in SCALARS or "/" in kind):
        raise InputError(f"{where}: {found['name']}: got {length} of {kind}, [] is allowed")
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
