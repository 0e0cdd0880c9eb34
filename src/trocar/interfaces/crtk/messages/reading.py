"""Write a decoder for a type: the encoder's mirror, which trusts no count that it reads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trocar.interfaces.crtk.messages.catalogue import MessageType, message_type
from trocar.interfaces.crtk.messages.definition import SCALARS, Field
from trocar.interfaces.crtk.messages.wire import (
    Wire,
    WireError,
    least_size,
    read_numbers,
    read_string,
    read_strings,
    room,
    written_runs,
)
from trocar.interfaces.crtk.messages.writing import EMPTY_ROS2, Script, check_clock, clock_line


class Reader(Script):
    """Collects runs of scalars; each field becomes an expression of what was read."""

    def __init__(self, wire: Wire) -> None:
        super().__init__(wire)
        self.codes = ""
        self.targets: list[str] = []
        self.names |= {
            "numbers": read_numbers,
            "string": read_string,
            "strings": read_strings,
            "room": room,
            "clock": check_clock,
            "WIRE": wire,
            "END": wire.end,
            "end": check_end,
        }

    def scalar(self, code: str) -> str:
        """Add one scalar to the run; returns the variable that will hold it."""
        self.codes += code
        self.targets.append(self.fresh())
        return self.targets[-1]

    def flush(self) -> None:
        """Read the run of scalars."""
        if not self.codes:
            return
        targets = f"{', '.join(self.targets)},"
        if self.wire.aligned:
            runs = self.constant(written_runs(self.wire, self.codes))
            self.add(f"s = {runs}[p & 7]; {targets} = s.unpack_from(d, p); p += s.size")
        else:
            run = self.constant(self.wire.struct(self.codes, 0))
            self.add(f"{targets} = {run}.unpack_from(d, p); p += {run}.size")
        self.codes, self.targets = "", []

    def pad(self, size: int) -> None:
        """Skip to a multiple of the size."""
        self.flush()
        if self.wire.aligned:
            self.add(f"p += ({self.wire.origin} - p) % {size}")

    def message(self, kind: MessageType) -> str:
        """Read each field of a message; returns the dict as an expression."""
        above = self.path
        fields = [f for f in kind.fields if self.wire.ros1 or not f.only_ros1]
        entries = []
        for field in fields:
            self.path = f"{above}.{field.name}".removeprefix(".")
            if field.only_ros1:
                self.scalar(SCALARS[field.type])
                continue
            value = self.single(field) if field.length is None else self.array(field)
            entries.append(f"{field.name!r}: {value}")
        if not fields and not self.wire.ros1:
            self.scalar(EMPTY_ROS2)
        self.path = above
        return f"{{{', '.join(entries)}}}"

    def single(self, field: Field) -> str:
        """Read a field of one value."""
        if field.type in SCALARS:
            return self.scalar(SCALARS[field.type])
        if field.is_message:
            return self.message(message_type(field.type))
        if field.type == "string":
            length, name = self.scalar("I"), self.fresh()
            self.flush()
            self.add(f"{name} = string(d, p, {length}, END); p += {length}")
            return name
        seconds, rest = self.scalar("i"), self.scalar("I")
        self.flush()
        self.add(clock_line(field.type, seconds, rest))
        return f"({seconds}, {rest})"

    def array(self, field: Field) -> str:
        """Read a field of several values."""
        name = self.fresh()
        if field.type == "string":
            self.pad(4)
            self.add(f"{name}, p = strings(d, p, WIRE)")
        elif field.type in SCALARS:
            self.numbers(field, name)
        else:
            count = str(field.length) if field.length else self.scalar("I")
            self.flush()
            self.each(field, name, count)
        return name

    def numbers(self, field: Field, name: str) -> None:
        """Read an array of scalars."""
        code = SCALARS[field.type]
        size = least_size(field.type)
        count = str(field.length) if field.length else self.scalar("I")
        self.flush()
        if self.wire.aligned:
            self.add(f"if {count}: p += ({self.wire.origin} - p) % {size}")
        self.add(f"{name} = numbers(d, p, {count}, {code!r}); p += {size} * {count}")

    def each(self, field: Field, name: str, count: str) -> None:
        """Read every message of an array."""
        above, kind = self.path, message_type(field.type)
        self.add(f"room(d, p, {count}, {least_message(kind)}); {name} = []")
        self.path += "[]"
        self.add(f"for _ in range({count}):")
        self.depth += 1
        value = self.message(kind)
        self.flush()
        self.add(f"{name}.append({value})")
        self.depth -= 1
        self.path = above


def least_message(kind: MessageType) -> int:
    """The fewest bytes that a message can have on any wire, at least 1."""
    total = 0
    for field in kind.fields:
        if field.only_ros1:
            continue
        if field.length == 0:
            total += 4
        elif field.is_message:
            total += least_message(message_type(field.type)) * (field.length or 1)
        else:
            total += least_size(field.type) * (field.length or 1)
    return max(total, 1)


def check_end(size: int, at: int, spare: int) -> None:
    """Refuse what lies behind a message."""
    if not at <= size <= at + spare:
        raise WireError(f"the message ends after {at} bytes, got {size}")


def write_decoder(kind: MessageType, wire: Wire) -> tuple[Callable[[bytes], Any], Script]:
    """The decoder of a type and the lines that it was made of."""
    script = Reader(wire)
    script.add(f"p = {wire.origin}")
    value = script.message(kind)
    script.flush()
    script.path = ""
    script.add(f"end(len(d), p, {wire.spare})")
    script.add(f"return {value}")
    return script.compile("def run(d):", f"decoder of {kind.name}"), script
