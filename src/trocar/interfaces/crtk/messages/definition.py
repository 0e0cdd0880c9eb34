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

    def text(self, ros1: bool) -> str:
        """The line of a definition, in the words of one edition of ROS."""
        names = {short: full for full, short in TIMES.items()}
        kind = self.type if ros1 else names.get(self.type, self.type)
        array = "" if self.length is None else f"[{self.length or ''}]"
        return f"{kind}{array} {self.ros1_name if ros1 else self.name}"


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
    if length and kind not in SCALARS:
        raise InputError(f"{where}: {found['name']}: an array of so many may only be of scalars")
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
        if line and (line.startswith(ROS1_MARK) or not line.startswith("#"))
    )
