"""Recordings of any kind as one stream of messages: rosbag 1, rosbag 2 and MCAP.

Whatever their length, a bag takes the memory of a chunk: nothing is read ahead, and no index.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trocar.apps.mirroring.rosbag1 import MAGIC, Told, rosbag1_messages, rosbag1_topics
from trocar.apps.mirroring.rosbag2 import sqlite_messages, sqlite_topics
from trocar.errors import LogError
from trocar.interfaces.crtk.messages import cdr_decode, ros1_decode
from trocar.recording import mcap_messages, mcap_topics

#: How many messages of an MCAP file without a summary are looked at to learn which topics it has.
LOOKED_AT = 20_000


@dataclass(frozen=True)
class Heard:
    """A message of joint states.

    Attributes:
        topic: without a leading slash
        time: of logging [s]
        message: its fields
    """

    topic: str
    time: float
    message: Mapping[str, Any]


@dataclass(frozen=True)
class Bag:
    """A recording.

    Attributes:
        file: for messages
        topics: {topic without a leading slash: type "sensor_msgs/JointState"}
        messages: the messages of some topics, in the order of their times
    """

    file: str
    topics: Mapping[str, str]
    messages: Callable[[Collection[str]], Iterator[Heard]]


def open_bag(path: str | Path) -> Bag:
    """Open a rosbag 1 file, a rosbag 2 (its folder, or one of its files), or an MCAP file.

    Raises:
        LogError: none of these, or damaged
        MissingExtraError: a library that it takes is not installed
    """
    where = Path(path).expanduser()
    files = _files(where, str(path))
    kinds = set(map(_kind, files))
    if len(kinds) != 1 or None in kinds:
        raise LogError(str(path), "is no bag; allowed: rosbag 1 (.bag), rosbag 2, MCAP")
    kind = kinds.pop()
    topics: dict[str, str] = {}
    for file in files:
        topics |= _topics(file, kind or "")

    def messages(wanted: Collection[str]) -> Iterator[Heard]:
        for file in files:
            for told in _told(file, kind or "", {f"/{t}" for t in wanted} | set(wanted)):
                yield _heard(told, str(path))

    plain = {topic.lstrip("/"): _type(found) for topic, found in topics.items()}
    return Bag(str(path), plain, messages)


def _type(kind: str) -> str:
    return kind.replace("/msg/", "/")


def _files(where: Path, told: str) -> list[Path]:
    """Return a recording's files in their order."""
    if where.is_file():
        return [where]
    if not where.is_dir():
        raise LogError(told, "there is no such bag")
    found = [p for p in where.iterdir() if p.suffix in (".db3", ".mcap")]
    packed = [p.name for p in where.iterdir() if p.suffix == ".zstd"]
    if packed:
        raise LogError(told, f"is packed ({packed[0]}): unpack it first (`zstd -d`)")
    if not found:
        raise LogError(told, "holds no file of a rosbag 2; allowed: *.db3 or *.mcap")
    return sorted(found, key=lambda p: [int(n) for n in re.findall(r"\d+", p.stem)] or [0])


def _kind(file: Path) -> str | None:
    with file.open("rb") as stream:
        head = stream.read(16)
    for kind, magic in (("ros1", MAGIC), ("mcap", b"\x89MCAP0\r\n"), ("sqlite", b"SQLite format")):
        if head.startswith(magic):
            return kind
    return None


def _topics(file: Path, kind: str) -> dict[str, str]:
    if kind == "ros1":
        return rosbag1_topics(file)
    if kind == "sqlite":
        return sqlite_topics(file)
    found = mcap_topics(file)
    if found:
        return found
    for k, told in enumerate(mcap_messages(file)):
        found[told.topic] = told.schema
        if k >= LOOKED_AT:
            break
    return found


def _told(file: Path, kind: str, topics: Collection[str]) -> Iterator[Told]:
    if kind == "ros1":
        yield from (told for told in rosbag1_messages(file) if told.topic in topics)
    elif kind == "sqlite":
        yield from sqlite_messages(file, topics)
    else:
        for told in mcap_messages(file):
            if told.topic in topics:
                yield Told(told.topic, told.schema, told.time, told.data)


def _heard(told: Told, file: str) -> Heard:
    """Decode a message: those of ROS 2 name their type with msg in its middle."""
    kind = _type(told.kind)
    try:
        message = (cdr_decode if "/msg/" in told.kind else ros1_decode)(kind, told.data)
    except ValueError as error:
        raise LogError(file, f"{told.topic}: {error}") from error
    return Heard(told.topic.lstrip("/"), 1e-9 * told.time, message)
