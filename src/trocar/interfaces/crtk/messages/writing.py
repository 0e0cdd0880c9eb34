"""Write an encoder for a type: straight Python without loops over fields, compiled once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trocar.interfaces.crtk.messages.catalogue import MessageType, message_type
from trocar.interfaces.crtk.messages.definition import SCALARS, Field
from trocar.interfaces.crtk.messages.wire import (
    PADS,
    SECOND,
    Wire,
    WireError,
    write_numbers,
    write_strings,
    written_runs,
)

Encoder = Callable[[Any], bytes]
EMPTY_ROS2 = "B"  # ROS 2 gives a message without fields one byte. Source: rosidl, IDL mapping.


class Script:
    """Lines of a function, and the field that each one speaks of."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.lines: list[str] = []
        self.paths: list[str] = []
        self.names: dict[str, Any] = {}
        self.depth = 1
        self.count = 0
        self.path = ""

    def add(self, line: str) -> None:
        """One more line."""
        self.lines.append(f"{'    ' * self.depth}{line}")
        self.paths.append(self.path)

    def fresh(self, prefix: str = "v") -> str:
        """A name that no other line has."""
        self.count += 1
        return f"{prefix}{self.count}"

    def constant(self, value: object) -> str:
        """The name under which the lines find a value."""
        name = self.fresh("K")
        self.names[name] = value
        return name

    def compile(self, head: str, label: str) -> Callable[..., Any]:
        """The function; line n of its traceback is about `paths[n - 2]`."""
        source = "\n".join([head, *self.lines])
        exec(compile(source, f"<{label}>", "exec"), self.names)  # our own lines, made above
        return self.names["run"]

    def path_at(self, error: BaseException, label: str) -> str:
        """The field that a line was about when it failed."""
        trace = error.__traceback__
        while trace is not None:
            if trace.tb_frame.f_code.co_filename == f"<{label}>":
                return self.paths[max(trace.tb_lineno - 2, 0)]
            trace = trace.tb_next
        return ""


class Writer(Script):
    """Collects runs of scalars, and puts what has no fixed size between them."""

    def __init__(self, wire: Wire) -> None:
        super().__init__(wire)
        self.codes = ""
        self.values: list[str] = []
        self.names |= {
            "numbers": write_numbers,
            "strings": write_strings,
            "clock": check_clock,
            "wrong_count": wrong_count,
            "PADS": PADS,
            "END": wire.end,
        }

    def scalar(self, code: str, value: str) -> None:
        """Add one scalar to the run."""
        self.codes += code
        self.values.append(value)

    def flush(self) -> None:
        """Write the run of scalars."""
        if not self.codes:
            return
        values = ", ".join(self.values)
        if self.wire.aligned:
            runs = self.constant(written_runs(self.wire, self.codes))
            self.add(f"s = {runs}[p & 7]; put(s.pack({values})); p += s.size")
        else:
            pack = self.constant(self.wire.struct(self.codes, 0).pack)
            self.add(f"put({pack}({values}))")
        self.codes, self.values = "", []

    def raw(self, name: str) -> None:
        """Write bytes that have been made already."""
        self.flush()
        self.add(f"put({name})")
        if self.wire.aligned:
            self.add(f"p += len({name})")

    def pad(self, size: int) -> None:
        """Fill up to a multiple of the size."""
        self.flush()
        if self.wire.aligned:
            self.add(f"f = ({self.wire.origin} - p) % {size}; put(PADS[f]); p += f")

    def message(self, kind: MessageType, value: str) -> None:
        """Write each field of a message that a variable holds."""
        above = self.path
        fields = [f for f in kind.fields if self.wire.ros1 or not f.only_ros1]
        for field in fields:
            self.path = f"{above}.{field.name}".removeprefix(".")
            if field.only_ros1:
                self.scalar(SCALARS[field.type], "0")
            elif field.length is None:
                self.single(field, f"{value}[{field.name!r}]")
            else:
                self.array(field, f"{value}[{field.name!r}]")
        if not fields and not self.wire.ros1:
            self.scalar(EMPTY_ROS2, "0")
        self.path = above

    def single(self, field: Field, value: str) -> None:
        """Write a field of one value."""
        if field.type in SCALARS:
            self.scalar(SCALARS[field.type], value)
            return
        name = self.fresh()
        if field.type == "string":
            self.add(f"{name} = {value}.encode(){' + END' if self.wire.end else ''}")
            self.scalar("I", f"len({name})")
            self.raw(name)
        elif field.is_message:
            self.add(f"{name} = {value}")
            self.message(message_type(field.type), name)
        else:
            self.add(f"{name}, {name}n = {value}")
            self.add(clock_line(field.type, name, f"{name}n"))
            self.scalar("i", name)
            self.scalar("I", f"{name}n")

    def array(self, field: Field, value: str) -> None:
        """Write a field of several values."""
        name = self.fresh()
        if field.type in SCALARS:
            self.numbers(field, value, name)
        elif field.type == "string":
            self.flush()
            self.pad(4)
            self.add(f"{name} = strings({value}, END, {4 if self.wire.aligned else 1})")
            self.raw(name)
        else:
            self.add(f"{name} = {value}")
            if field.length:
                self.add(f"if len({name}) != {field.length}: wrong_count(len({name}))")
            else:
                self.scalar("I", f"len({name})")
            self.flush()
            self.each(field, name)

    def numbers(self, field: Field, value: str, name: str) -> None:
        """Write an array of scalars."""
        code = SCALARS[field.type]
        size = self.wire.struct(code, self.wire.origin).size
        self.add(f"{name} = numbers({value}, {code!r}, {field.length})")
        if not field.length:
            self.scalar("I", f"len({name}) // {size}")
        self.flush()
        if self.wire.aligned and (size > 4 or field.length):
            self.add(f"if {name}:")
            self.depth += 1
            self.pad(size)
            self.depth -= 1
        self.raw(name)

    def each(self, field: Field, name: str) -> None:
        """Write every message of an array."""
        above = self.path
        self.path += "[]"
        entry = self.fresh()
        self.add(f"for {entry} in {name}:")
        self.depth += 1
        self.message(message_type(field.type), entry)
        self.flush()
        self.depth -= 1
        self.path = above


def clock_line(kind: str, seconds: str, rest: str) -> str:
    """The line that refuses what is no time; what is one fits both editions' signs."""
    early = f"{seconds} < 0 or " if kind == "time" else ""
    return f"if {early}not 0 <= {rest} < {SECOND}: clock({seconds}, {rest})"


def wrong_count(count: int) -> None:
    """Say that an array of so many does not fit."""
    raise WireError(f"got {count} messages")


def check_clock(seconds: int, rest: int) -> None:
    """Say what a time may be."""
    raise WireError(f"got {seconds} s and {rest} ns, a time in 1970 to 2038 is allowed")


def write_encoder(kind: MessageType, wire: Wire) -> tuple[Callable[[Any], bytes], Script]:
    """The encoder of a type and the lines that it was made of."""
    script = Writer(wire)
    script.names["PREFIX"] = wire.prefix
    script.add(f"parts = [PREFIX]; put = parts.append; p = {wire.origin}")
    script.message(kind, "m")
    script.flush()
    script.add("return b''.join(parts)")
    return script.compile("def run(m):", f"encoder of {kind.name}"), script
