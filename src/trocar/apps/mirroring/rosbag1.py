"""Messages of a rosbag 1 file, chunk after chunk, in the order of the file.

The file's index is not read: it grows with the recording, and a mirror reads from front to back.
Source: http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

from trocar.errors import LogError, MissingExtraError

MAGIC = b"#ROSBAG V2.0\n"
#: Kinds of records: message, bag header, chunk, connection. Source: the format's table of opcodes.
MESSAGE, CHUNK, CONNECTION = 0x02, 0x05, 0x07
#: Chunks are some hundred kilobytes; one that claims more is none [bytes]. Source: our own choice.
LARGEST = 1 << 30


class Told(NamedTuple):
    """A message: topic, type ("sensor_msgs/JointState"), time of logging [ns], bytes of ROS 1."""

    topic: str
    kind: str
    time: int
    data: bytes


def rosbag1_messages(path: Path) -> Iterator[Told]:
    """Read the messages of a file.

    Raises:
        LogError: it is no rosbag 1, or breaks off inside a record
        MissingExtraError: its chunks are packed by lz4, which is not installed
    """
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise LogError(str(path), "is no rosbag 1 file")
            connections: dict[int, tuple[str, str]] = {}
            for head, data in _records(stream, str(path)):
                if head.get("op") == bytes([CHUNK]):
                    inner = BytesIO(_unpacked(head, data, str(path)))
                    for found in _records(inner, str(path)):
                        yield from _told(*found, connections)
                else:
                    yield from _told(head, data, connections)
    except OSError as error:
        raise LogError(str(path), f"cannot be read: {error.strerror or error}") from error


def rosbag1_topics(path: Path) -> dict[str, str]:
    """Return {topic: type} of a file, from its records of connections.

    Raises:
        LogError: it is no rosbag 1, or was not closed by who wrote it
    """
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise LogError(str(path), "is no rosbag 1 file")
            head, _ = next(_records(stream, str(path)), ({}, b""))
            at = struct.unpack("<Q", head.get("index_pos", bytes(8)))[0]
            if not at:
                raise LogError(str(path), "was not closed by who wrote it; `rosbag reindex` it")
            stream.seek(at)
            found = (_connection(h, d) for h, d in _records(stream, str(path)))
            return {topic: kind for _, topic, kind in (f for f in found if f is not None)}
    except OSError as error:
        raise LogError(str(path), f"cannot be read: {error.strerror or error}") from error


def _records(stream: IO[bytes], file: str) -> Iterator[tuple[dict[str, bytes], bytes]]:
    """Give (header, data) of each record up to the end."""
    while size := stream.read(4):
        head = _piece(stream, size, file)
        yield _fields(head, file), _piece(stream, stream.read(4), file)


def _piece(stream: IO[bytes], size: bytes, file: str) -> bytes:
    length = struct.unpack("<I", size)[0] if len(size) == 4 else LARGEST
    found = stream.read(length) if length < LARGEST else b""
    if len(found) != length:
        raise LogError(file, "breaks off inside a record")
    return found


def _fields(head: bytes, file: str) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    at = 0
    while at + 4 <= len(head):
        (length,) = struct.unpack_from("<I", head, at)
        name, sign, value = head[at + 4 : at + 4 + length].partition(b"=")
        if not sign or length > len(head) - at - 4:
            raise LogError(file, "holds a record without a header")
        found[name.decode(errors="replace")] = value
        at += 4 + length
    return found


def _connection(head: dict[str, bytes], data: bytes) -> tuple[int, str, str] | None:
    if head.get("op") != bytes([CONNECTION]):
        return None
    told = _fields(data, "")
    topic = head["topic"].decode(errors="replace")
    kind = told.get("type", b"").decode(errors="replace")
    return struct.unpack("<I", head["conn"])[0], topic, kind


def _told(
    head: dict[str, bytes], data: bytes, connections: dict[int, tuple[str, str]]
) -> Iterator[Told]:
    found = _connection(head, data)
    if found is not None:
        connections[found[0]] = found[1:]
    elif head.get("op") == bytes([MESSAGE]):
        known = connections.get(struct.unpack("<I", head["conn"])[0])
        if known is not None:
            seconds, nanoseconds = struct.unpack("<II", head["time"])
            yield Told(*known, seconds * 1_000_000_000 + nanoseconds, data)


def _unpacked(head: dict[str, bytes], data: bytes, file: str) -> bytes:
    how = head.get("compression", b"none")
    if how == b"none":
        return data
    if how == b"bz2":
        return bz2.decompress(data)
    if how != b"lz4":
        raise LogError(file, f"holds chunks packed by {how.decode(errors='replace')!r}")
    try:
        import lz4.frame
    except ImportError as error:
        raise MissingExtraError("lz4", "bags", "reading a bag with chunks packed by lz4") from error
    return bytes(lz4.frame.decompress(data))  # pyright: ignore
