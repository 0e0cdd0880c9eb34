"""Bags with the names of rosbag and rosbag2_py, over the readers of trocar's recordings.

Source of names and behaviour: the public documentation of rosbag (ROS 1 Noetic) and rosbag2_py
(ROS 2 Humble).
"""

# Public attributes of our messages begin with an underscore, as genpy's.
# pyright: reportPrivateUsage=false

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from errno import ENOENT
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from trocar.errors import LogError, UnknownNameError
from trocar.messages import cdr_decode, ros1_decode, ros1_encode
from trocar.messages.types import SECOND
from trocar.recording.bags import BagWriter, Packed, open_bag
from trocar.scripts.messages import Message, Time, fields_of, message_class, message_of


class BagMessage(NamedTuple):
    """A message of a bag: topic, message, and when it was logged."""

    topic: str
    message: Any
    timestamp: Any


class TopicTuple(NamedTuple):
    """A topic of a bag."""

    msg_type: str
    message_count: int
    connections: int
    frequency: float | None


class TypesAndTopics(NamedTuple):
    """Types {type: checksum} and topics {name: TopicTuple} of a bag."""

    msg_types: dict[str, str]
    topics: dict[str, TopicTuple]


@dataclass(frozen=True)
class OpaqueMessage:
    """A message of a type that trocar does not have: its type and bytes."""

    _type: str
    _buff: bytes


class BagException(Exception):  # noqa: N818  as scripts call it
    """A bag that cannot be used."""


class RosBag:
    """A bag of ROS 1; recordings of ROS 2 are read, too.

    Args:
        f: path of the bag
        mode: "r" to read, "w" to write
    """

    now: ClassVar[Any]

    def __init__(self, f: Any, mode: str = "r", *_: Any, **__: Any) -> None:
        self.filename, self.mode = str(getattr(f, "name", f)), mode
        if mode not in ("r", "w"):
            raise BagException(f"mode: got {mode!r}; allowed: r, w")
        self._writer = None
        self._bag = None
        if mode == "w":
            Path(self.filename).unlink(missing_ok=True)  # as rosbag does
            self._writer = BagWriter(self.filename, "rosbag1")
        else:
            if not Path(self.filename).exists():
                raise FileNotFoundError(ENOENT, "No such file or directory", self.filename)
            try:
                self._bag = open_bag(self.filename)
            except LogError as problem:
                raise BagException(str(problem)) from problem

    def __enter__(self) -> RosBag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[BagMessage]:
        return self.read_messages()

    def close(self) -> None:
        """End; what was written is complete."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()

    def flush(self) -> None:
        """Do nothing: a bag is complete when it is closed."""

    def read_messages(
        self,
        topics: str | Iterable[str] | None = None,
        start_time: Any = None,
        end_time: Any = None,
        connection_filter: Any = None,  # noqa: ARG002
        raw: bool = False,
        **_: Any,
    ) -> Iterator[BagMessage]:
        """Yield messages of some topics, or of all, in the order of their times."""
        first = 0 if start_time is None else start_time.to_nsec()
        last = None if end_time is None else end_time.to_nsec()
        chosen = [topics] if isinstance(topics, str) else topics
        packed = sorted(self._packed(chosen), key=lambda one: one[2])
        for topic, kind, time, data in packed:
            if time >= first and (last is None or time <= last):
                message = (kind, data, "", (0, 0), None) if raw else _decoded(kind, data)
                yield BagMessage(topic, message, Time.of(time))

    def write(self, topic: str, msg: Message, t: Any = None, *_: Any, **__: Any) -> None:
        """Write a message with a time, now when omitted."""
        if self._writer is None:
            raise BagException("bag is not open for writing")
        self._writer.add(topic, msg._type)
        when = type(self).now() if t is None else t
        self._writer.write(topic, ros1_encode(msg._type, fields_of(msg)), when.to_nsec())

    def get_message_count(self, topic_filters: Any = None) -> int:
        """Count the messages of some topics, or of all."""
        chosen = [topic_filters] if isinstance(topic_filters, str) else topic_filters
        return sum(1 for _ in self._packed(chosen))

    def get_start_time(self) -> float:
        """Return the time of the first message [s]."""
        return min(self._times()) / SECOND

    def get_end_time(self) -> float:
        """Return the time of the last message [s]."""
        return max(self._times()) / SECOND

    def get_type_and_topic_info(self, topic_filters: Any = None) -> TypesAndTopics:
        """Return types and topics with their numbers of messages and rates [Hz]."""
        times: dict[str, list[int]] = {}
        kinds: dict[str, str] = {}
        for topic, kind, time, _ in self._packed(topic_filters):
            times.setdefault(topic, []).append(time)
            kinds[topic] = kind.replace("/msg/", "/")
        topics: dict[str, TopicTuple] = {}
        for name, found in sorted(times.items()):
            span = (max(found) - min(found)) / SECOND
            rate = (len(found) - 1) / span if span > 0.0 else None
            topics[name] = TopicTuple(kinds[name], len(found), 1, rate)
        return TypesAndTopics(dict.fromkeys(kinds.values(), "*"), topics)

    def _times(self) -> list[int]:
        found = [time for _, _, time, _ in self._packed(None)]
        if not found:
            raise BagException("Bag contains no message")
        return found

    def _packed(self, topics: Iterable[str] | None) -> Iterator[Packed]:
        if self._bag is None:
            raise BagException("bag is not open for reading")
        known = self._bag.topics
        wanted = known if topics is None else [name.lstrip("/") for name in topics]
        return self._bag.raw([name for name in wanted if name in known])


def _decoded(kind: str, data: bytes) -> Any:
    try:
        made = message_class(kind.replace("/msg/", "/"))
    except UnknownNameError:
        return OpaqueMessage(kind, data)
    decode = cdr_decode if "/msg/" in kind else ros1_decode
    return message_of(made, decode(made._type, data))


@dataclass
class StorageOptions:
    """Path and storage ("sqlite3" or "mcap") of a bag of ROS 2."""

    uri: str = ""
    storage_id: str = ""
    max_bagfile_size: int = 0
    max_cache_size: int = 0
    storage_preset_profile: str = ""


@dataclass
class ConverterOptions:
    """Encodings of a bag's messages: "cdr"."""

    input_serialization_format: str = ""
    output_serialization_format: str = ""


@dataclass
class StorageFilter:
    """Topics that are read; all, when empty."""

    topics: list[str] = field(default_factory=list[str])


class TopicMetadata:
    """A topic of a bag: name and type, such as "sensor_msgs/msg/JointState"."""

    def __init__(self, *given: Any, **named: Any) -> None:
        words = ("id", "name", "type", "serialization_format", "offered_qos_profiles")
        given_names = words if given and isinstance(given[0], int) else words[1:]
        found: Mapping[str, Any] = {**dict(zip(given_names, given, strict=False)), **named}
        self.name: str = found.get("name", "")
        self.type: str = found.get("type", "")
        self.serialization_format: str = found.get("serialization_format", "cdr")
        self.offered_qos_profiles: Any = found.get("offered_qos_profiles", "")


class SequentialBagReader:
    """Reads a bag message by message."""

    def __init__(self) -> None:
        self._messages: list[Packed] = []
        self._every: list[Packed] = []
        self._next = 0

    def open(self, storage_options: Any, converter_options: Any = None) -> None:  # noqa: ARG002
        """Open a bag."""
        bag = open_bag(getattr(storage_options, "uri", storage_options))
        self._kinds = {f"/{topic}": kind for topic, kind in bag.topics.items()}
        self._every = sorted(bag.raw(bag.topics), key=lambda one: one[2])
        self._messages, self._next = self._every, 0

    open_uri = open  # noqa: A003  as the real one

    def set_filter(self, storage_filter: StorageFilter) -> None:
        """Read some topics only."""
        wanted = {name.lstrip("/") for name in storage_filter.topics}
        self._messages = [
            one for one in self._every if not wanted or one[0].lstrip("/") in wanted
        ]  # fmt: skip

    def reset_filter(self) -> None:
        """Read all topics."""
        self._messages = self._every

    def seek(self, timestamp: int) -> None:
        """Go on with the first message at a time or later [ns]."""
        self._next = sum(1 for one in self._messages if one[2] < timestamp)

    def has_next(self) -> bool:
        """Return whether there is another message."""
        return self._next < len(self._messages)

    def read_next(self) -> tuple[str, bytes, int]:
        """Return topic, bytes and time of the next message [ns]."""
        topic, _, time, data = self._messages[self._next]
        self._next += 1
        return f"/{topic.lstrip('/')}", data, time

    def get_all_topics_and_types(self) -> list[TopicMetadata]:
        """Return the topics."""
        return [TopicMetadata(name=name, type=kind) for name, kind in self._kinds.items()]

    def close(self) -> None:
        """End."""
        self._messages = self._every = []


class SequentialBagWriter:
    """Writes a bag message by message."""

    def open(self, storage_options: Any, converter_options: Any = None) -> None:  # noqa: ARG002
        """Begin a bag."""
        uri = getattr(storage_options, "uri", storage_options)
        self._writer = BagWriter(uri, getattr(storage_options, "storage_id", "") or "mcap")

    def create_topic(self, topic: TopicMetadata) -> None:
        """Add a topic."""
        self._writer.add(topic.name, topic.type.replace("/msg/", "/"))

    def write(self, topic_name: str, message: bytes, time: int) -> None:
        """Write the bytes of a message with its time [ns]."""
        self._writer.write(topic_name, bytes(message), time)

    def close(self) -> None:
        """Finish the bag."""
        writer = self.__dict__.pop("_writer", None)
        if writer is not None:
            writer.close()

    def __del__(self) -> None:
        self.close()
