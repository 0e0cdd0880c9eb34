"""What the written encoders and decoders call: numbers, strings and arrays as bytes and back.

A position counts from the start of the buffer. Where values are aligned (CDR), a run of scalars
has one `Struct` for each of the eight phases that its position can have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from struct import Struct, calcsize, pack, unpack_from
from typing import Any

import numpy as np

from trocar.interfaces.crtk.messages.definition import SCALARS

PADS = tuple(bytes(count) for count in range(8))
# Up to so many values are copied, and so many names remembered. Source: our own choice, joints.
CACHED = 64
DTYPES = {
    code: np.dtype(f"<{'f' if code in 'fd' else 'u' if code.isupper() else 'i'}{calcsize(code)}")
    for code in SCALARS.values()
    if code != "?"
} | {"?": np.dtype(bool)}
SECOND = 1_000_000_000


class WireError(ValueError):
    """Bytes that are none of the type; the caller adds which type and where."""


@dataclass(frozen=True)
class Wire:
    """One way of writing messages.

    Args:
        origin: bytes before the first value, from which alignment counts
        aligned: whether values stand at multiples of their size
        end: what follows each string, and is counted with it
        spare: how many bytes may follow a message
        ros1: whether fields that only ROS 1 has are written
    """

    prefix: bytes
    aligned: bool
    end: bytes
    spare: int
    ros1: bool

    @property
    def origin(self) -> int:
        """Where the first value stands."""
        return len(self.prefix)

    def struct(self, codes: str, phase: int) -> Struct:
        """A run of scalars that begins where a position is `phase` modulo 8."""
        if not self.aligned:
            return Struct(f"<{codes}")
        at = (phase - self.origin) % 8
        text = ""
        for code in codes:
            size = calcsize(code)
            text += "x" * (-at % size) + code
            at += -at % size + size
        return Struct(f"<{text}")


# Source: ROS 1's serialisation, as genpy writes it.
ROS1 = Wire(prefix=b"", aligned=False, end=b"", spare=0, ros1=True)
# XCDR1, little endian; DDS rounds a payload up to a multiple of four.
# Source: OMG DDSI-RTPS 2.5, 10.2; OMG DDS-XTypes 1.3, 7.4.3.
CDR = Wire(prefix=b"\x00\x01\x00\x00", aligned=True, end=b"\x00", spare=3, ros1=False)


def write_numbers(value: Any, code: str, count: int = 0) -> bytes | bytearray | memoryview:
    """An array of scalars as bytes; `count` is how many there must be, 0 for any number."""
    data: Any
    if code == "B" and isinstance(value, bytes | bytearray):
        data = value
    elif not isinstance(value, np.ndarray):
        data = pack(f"<{len(value)}{code}", *value)
    elif value.dtype is DTYPES[code] and value.size <= CACHED:
        data = value.tobytes()
    else:
        data = np.ascontiguousarray(value, dtype=DTYPES[code]).reshape(-1).view("u1").data
    if count and len(data) != count * calcsize(code):
        raise WireError(f"got {len(data) // calcsize(code)} values, {count} belong there")
    return data


def write_strings(values: Sequence[str], end: bytes, align: int) -> bytes:
    """Strings, each with its length before it, the count first."""
    if len(values) <= CACHED:
        return _write_strings(tuple(values), end, align)
    return _write_strings.__wrapped__(tuple(values), end, align)


@lru_cache(maxsize=256)
def _write_strings(values: tuple[str, ...], end: bytes, align: int) -> bytes:
    out = bytearray(len(values).to_bytes(4, "little"))
    for value in values:
        text = value.encode() + end
        out += bytes(-len(out) % align) + len(text).to_bytes(4, "little") + text
    return bytes(out)


def read_string(data: bytes, at: int, length: int, end: bytes) -> str:
    """One string of so many bytes, its end included."""
    stop = at + length
    if stop > len(data):
        raise WireError(f"a string of {length} bytes, {len(data) - at} are left")
    if end and length:
        stop -= 1
        if data[stop]:
            raise WireError("a string without an end")
    raw = data[at:stop]
    if 0 in raw:
        raise WireError("a string with a zero byte in it")
    return raw.decode()


def read_strings(data: bytes, at: int, wire: Wire) -> tuple[list[str], int]:
    """Strings with their count before them, and where they end."""
    (count,) = unpack_from("<I", data, at)
    at += 4
    room(data, at, count, 4)
    values = []
    for _ in range(count):
        if wire.aligned:
            at += (wire.origin - at) % 4
        (length,) = unpack_from("<I", data, at)
        at += 4
        values.append(read_string(data, at, length, wire.end))
        at += length
    return values, at


def room(data: bytes, at: int, count: int, least: int) -> None:
    """Refuse a count of things that cannot lie in the bytes that are left."""
    if count * least > len(data) - at:
        raise WireError(f"{count} entries of {least} bytes or more, {len(data) - at} are left")


def read_numbers(data: bytes, at: int, count: int, code: str) -> Any:
    """An array of scalars: bytes of uint8, an ndarray of float64, else a list."""
    size = calcsize(code)
    room(data, at, count, size)
    if code == "B":
        return data[at : at + count]
    if code == "d":
        return np.frombuffer(data, "<f8", count, at).copy() if count else np.empty(0)
    return list(unpack_from(f"<{count}{code}", data, at))


def written_runs(wire: Wire, codes: str) -> tuple[Struct, ...]:
    """One run of scalars at each phase."""
    return tuple(wire.struct(codes, phase) for phase in range(8))


def least_size(type_name: str) -> int:
    """The fewest bytes that one scalar, time or string can have."""
    if type_name in SCALARS:
        return calcsize(SCALARS[type_name])
    return 4 if type_name == "string" else 8
