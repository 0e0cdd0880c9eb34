"""Joint states, poses and images of any bag: rosbag 1, rosbag 2 and MCAP, as streams of messages.

Joint states are written as MCAP.
"""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar import __version__
from trocar.errors import LogError, MissingExtraError
from trocar.messages import MessageType, cdr_encode, message_type
from trocar.outputs import whole_file
from trocar.recording import mcap_messages, mcap_topics
from trocar.recording.mcap_file import JOINT_STATE, NANOSECONDS, mcap_library
from trocar.recording.rosbag1 import rosbag1_messages, rosbag1_reader

_log = logging.getLogger("trocar")

FORMATS = "rosbag 1 (.bag), rosbag 2, MCAP"
#: Types of poses. Source: `measured_cp` of dVRK 2.1 and newer, of 2.0, and of 1.2 and before.
POSES = tuple(f"geometry_msgs/msg/{kind}" for kind in ("PoseStamped", "TransformStamped", "Pose"))
IMAGES = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
#: Channels of image encodings, as (red, green, blue).
ENCODINGS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2), "bgra8": (2, 1, 0)}
MAGIC = {"rosbag1": b"#ROSBAG V2.0", "rosbag2": b"SQLite format 3", "mcap": b"\x89MCAP0\r\n"}


class JointMessage(NamedTuple):
    """A message of joint states.

    Attributes:
        topic: without a leading slash
        time: of logging [s]
        fields: name, position, velocity, effort; stamp [s] is `time` where the header's is 0
    """

    topic: str
    time: float
    fields: Mapping[str, Any]


class PoseMessage(NamedTuple):
    """A pose.

    Attributes:
        topic: without a leading slash
        time: of logging [s]
        frame: of the header, "" without one
        pose: position [m] and quaternion wxyz, (7,)
        stamp: of the header; `time` where it is 0 or absent [s]
    """

    topic: str
    time: float
    frame: str
    pose: NDArray[np.float64]
    stamp: float


class JointSamples(NamedTuple):
    """Joint states over time.

    Attributes:
        names: of the joints
        times: ascending, (k,) [s]
        positions: (k, n) [rad or m]
    """

    names: tuple[str, ...]
    times: NDArray[np.float64]
    positions: NDArray[np.float64]


class ImageMessage(NamedTuple):
    """An image: topic without a leading slash, stamp [s], (h, w, 3) red, green, blue."""

    topic: str
    stamp: float
    image: NDArray[np.uint8]


#: (topic, type, time of logging [ns], bytes); ROS 2 names a type with msg in its middle.
Packed = tuple[str, str, int, bytes]


class Bag(NamedTuple):
    """A recording.

    Attributes:
        file: its path, as given
        topics: {topic without a leading slash: type "sensor_msgs/msg/JointState"}
        messages: reads joint states of some topics, in the order of their times
        poses: reads poses of some topics, in the order of their times
        images: reads raw or compressed images of some topics, in the order of their times
        raw: reads messages of any type of some topics as bytes, in the order of the file
    """

    file: str
    topics: Mapping[str, str]
    messages: Callable[[Collection[str]], Iterator[JointMessage]]
    poses: Callable[[Collection[str]], Iterator[PoseMessage]]
    images: Callable[[Collection[str]], Iterator[ImageMessage]]
    raw: Callable[[Collection[str]], Iterator[Packed]]


def is_bag(path: str | Path) -> bool:
    """Return whether a path is a folder, or a file that begins as a bag does."""
    where = Path(path).expanduser()
    return where.is_dir() or _kind(where) is not None


def open_bag(path: str | Path) -> Bag:
    """Open a rosbag 1 file, a rosbag 2 (its folder, or one of its files), or an MCAP file.

    MCAP and rosbag 1 files whose recorder was killed are read up to where they break off. The types
    of joint states and images are those of ROS, whatever definitions the bag contains.

    Raises:
        LogError: none of these, or damaged
        MissingExtraError: rosbags is not installed
    """
    where, file = Path(path).expanduser(), str(path)
    if not where.exists():
        raise LogError(file, f"no such file; allowed: {FORMATS}")
    paths = _files(where, file)
    raw: Raw = _mcap_raw if _kind(paths[0]) == "mcap" else _rosbag_raw
    found: dict[str, str] = {}
    with _rosbags(file):
        for one in paths:
            if raw is _mcap_raw:
                found |= mcap_topics(one) or {m.topic: m.schema for m in mcap_messages(one)}
            else:
                with _reader(one) as reader:
                    found |= {c.topic: c.msgtype for c in reader.connections}
                    if getattr(reader, "broken", False):
                        _log.warning("%s: was not closed; read up to where it breaks off", file)
    topics = {topic.lstrip("/"): _type(kind) for topic, kind in found.items()}

    def every(wanted: Collection[str]) -> Iterator[Packed]:
        with _rosbags(file):
            for one in paths:
                yield from raw(one, wanted)

    def packed(wanted: Collection[str], allowed: tuple[str, ...]) -> Iterator[Packed]:
        for topic in wanted:
            if topics.get(topic, allowed[0]) not in allowed:
                raise LogError(
                    file, f"/{topic} is {topics[topic]}; allowed: {' or '.join(allowed)}"
                )
        yield from every(wanted)

    def messages(wanted: Collection[str]) -> Iterator[JointMessage]:
        with _rosbags(file):
            yield from _joints(packed(wanted, (JOINT_STATE,)))

    def poses(wanted: Collection[str]) -> Iterator[PoseMessage]:
        with _rosbags(file):
            for topic, logged, message in _decoded(packed(wanted, POSES)):
                yield _pose(topic, logged, message)

    def images(wanted: Collection[str]) -> Iterator[ImageMessage]:
        with _rosbags(file):
            for topic, logged, message in _decoded(packed(wanted, IMAGES)):
                yield ImageMessage(topic, _stamp(message, logged), _image(message, topic, file))

    return Bag(file, topics, messages, poses, images, every)


def write_joint_states(
    path: str | Path, streams: Mapping[str, JointSamples], overwrite: bool = False
) -> None:
    """Write joint states as an MCAP file, in messages of ROS 2.

    Args:
        path: of the file
        streams: {topic: its joint states}
        overwrite: an existing file is replaced

    Raises:
        InputError: the file exists or cannot be written
        MissingExtraError: the library for MCAP is not installed
    """
    library = mcap_library("writing a recording")
    with whole_file(path, overwrite) as part, part.open("wb") as stream:
        writer: Any = library.writer.Writer(stream)
        writer.start("ros2", f"trocar {__version__}")
        text = message_type(JOINT_STATE).text_ros2.encode()
        schema = writer.register_schema(JOINT_STATE, "ros2msg", text)
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in streams}
        messages = [
            (round(float(time) * NANOSECONDS), channels[topic], samples.names, position)
            for topic, samples in streams.items()
            for time, position in zip(samples.times, samples.positions, strict=True)
        ]
        empty = {"velocity": np.zeros(0), "effort": np.zeros(0)}
        for stamp, channel, names, position in sorted(messages, key=lambda one: one[:2]):
            header = {"stamp": divmod(stamp, NANOSECONDS), "frame_id": ""}
            message = {"header": header, "name": names, "position": position, **empty}
            writer.add_message(channel, stamp, cdr_encode(JOINT_STATE, message), stamp)
        writer.finish()


class BagWriter:
    """Writes a new bag: a rosbag 1 file, or a rosbag 2 folder; types are those that trocar has.

    Args:
        path: of the file or folder, which must not exist
        storage: "rosbag1", or of a rosbag 2 "sqlite3" or "mcap"

    Raises:
        LogError: the path exists or cannot be written, or an unknown storage
        MissingExtraError: rosbags is not installed
    """

    def __init__(self, path: str | Path, storage: str) -> None:
        self.file, self._one = str(path), storage == "rosbag1"
        allowed = ("rosbag1", "sqlite3", "mcap")
        if storage not in allowed:
            raise LogError(self.file, f"storage {storage!r}; allowed: {', '.join(allowed)}")
        if Path(path).exists():
            raise LogError(self.file, "exists")
        with _rosbags(self.file):
            from rosbags import rosbag1, rosbag2

            if self._one:
                self._writer: Any = rosbag1.Writer(path)
            else:
                plugin = rosbag2.StoragePlugin[storage.upper()]
                self._writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
            self._writer.open()
        self._topics: dict[str, Any] = {}

    def add(self, topic: str, kind: str) -> None:
        """Add a topic of a type such as "sensor_msgs/JointState", unless it is there."""
        if topic in self._topics:
            return
        known = message_type(kind)
        with _rosbags(self.file):
            if self._one:
                self._topics[topic] = self._writer.add_connection(
                    topic, _type(kind), msgdef=known.text_ros1, md5sum=known.md5
                )
            else:
                self._topics[topic] = self._writer.add_connection(
                    topic, _type(kind), msgdef=known.text_ros2, rihs01=_digest(known)
                )

    def write(self, topic: str, data: bytes, time_ns: int) -> None:
        """Write the bytes of a message, in the encoding of the bag's edition [ns]."""
        with _rosbags(self.file):
            self._writer.write(self._topics[topic], time_ns, data)

    def close(self) -> None:
        """Finish the bag."""
        with _rosbags(self.file):
            self._writer.close()


def _digest(kind: MessageType) -> str:
    """Return the checksum that ROS 2 has of a type (REP 2016)."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    found = get_types_from_msg(kind.text_ros2, _type(kind.name))
    store.register({name: made for name, made in found.items() if name not in store.fielddefs})
    return store.hash_rihs01(_type(kind.name))


def _type(name: str) -> str:
    """Return a type's name as ROS 2 writes it."""
    return name if "/msg/" in name else name.replace("/", "/msg/")


def _kind(file: Path) -> str | None:
    if not file.is_file():
        return "rosbag2" if file.is_dir() else None
    with file.open("rb") as stream:
        head = stream.read(16)
    return next((kind for kind, magic in MAGIC.items() if head.startswith(magic)), None)


def _files(where: Path, file: str) -> list[Path]:
    """Return the paths to read: a file, a rosbag 2's folder, or its files without metadata."""
    if where.is_file():
        if _kind(where) is None:
            raise LogError(file, f"is not a bag; allowed: {FORMATS}")
        return [where]
    if (where / "metadata.yaml").is_file():
        return [where]
    found = [p for p in where.iterdir() if p.suffix in (".db3", ".mcap") and _kind(p)]
    if not found:
        packed = [p.name for p in where.iterdir() if p.suffix == ".zstd"]
        raise LogError(
            file,
            f"is compressed ({packed[0]}): decompress it first (`zstd -d`)"
            if packed
            else "contains no rosbag 2 file; allowed: *.db3 or *.mcap",
        )
    return sorted(found, key=lambda p: [int(n) for n in re.findall(r"\d+", p.stem)] or [0])


Raw = Callable[[Path, Collection[str]], Iterator[Packed]]


def _mcap_raw(path: Path, topics: Collection[str]) -> Iterator[Packed]:
    for message in mcap_messages(path):
        if message.topic.lstrip("/") in topics:
            yield message.topic, message.schema, message.time, message.data


def _rosbag_raw(path: Path, topics: Collection[str]) -> Iterator[Packed]:
    with _reader(path) as reader:
        chosen = {c.id: c for c in reader.connections if c.topic.lstrip("/") in topics}
        if _kind(path) == "rosbag1":
            yield from rosbag1_messages(reader, chosen)
        elif chosen:
            for connection, time, data in reader.messages(list(chosen.values())):
                yield connection.topic, _type(connection.msgtype), time, data


def _reader(path: Path) -> Any:
    """Return rosbags' reader; its AnyReader goes by suffixes, and parses types of all topics."""
    from rosbags import rosbag2

    return rosbag1_reader(path) if _kind(path) == "rosbag1" else rosbag2.Reader(path)


def _decoded(packed: Iterable[Packed]) -> Iterator[tuple[str, float, Any]]:
    """Yield topics without a leading slash, times of logging [s] and messages."""
    from rosbags.typesys import Stores, get_typestore

    cdr = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr
    ros1 = get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
    for topic, kind, time, data in packed:
        message: Any = (cdr if "/msg/" in kind else ros1)(data, _type(kind))
        yield topic.lstrip("/"), 1e-9 * time, message


def _stamp(message: Any, logged: float) -> float:
    """Return the time of a header, that of logging where it is 0 [s]."""
    stamp = message.header.stamp
    return stamp.sec + 1e-9 * stamp.nanosec or logged


def _joints(packed: Iterable[Packed]) -> Iterator[JointMessage]:
    for topic, logged, message in _decoded(packed):
        fields = {
            "stamp": _stamp(message, logged),
            "name": message.name,
            "position": message.position,
            "velocity": message.velocity,
            "effort": message.effort,
        }
        yield JointMessage(topic, logged, fields)


def _pose(topic: str, logged: float, message: Any) -> PoseMessage:
    frame, stamp = "", logged
    if hasattr(message, "header"):
        frame, stamp = message.header.frame_id, _stamp(message, logged)
    pose = message.pose if hasattr(message, "pose") else message
    if hasattr(message, "transform"):
        at, q = message.transform.translation, message.transform.rotation
    else:
        at, q = pose.position, pose.orientation
    return PoseMessage(
        topic, logged, frame, np.array([at.x, at.y, at.z, q.w, q.x, q.y, q.z]), stamp
    )


def _image(message: Any, topic: str, file: str) -> NDArray[np.uint8]:
    """Return the pixels of a raw or compressed image, (h, w, 3)."""
    if hasattr(message, "format"):
        with Image.open(BytesIO(bytes(message.data))) as picture:
            return np.array(picture.convert("RGB"), np.uint8)
    if message.encoding not in ENCODINGS:
        allowed = ", ".join(ENCODINGS)
        raise LogError(file, f"/{topic}: got encoding {message.encoding!r}; allowed: {allowed}")
    rows = np.asarray(message.data, np.uint8).reshape(message.height, message.step)
    pixels = rows[:, : message.step // message.width * message.width]
    pixels = pixels.reshape(message.height, message.width, -1)
    return np.ascontiguousarray(pixels[..., list(ENCODINGS[message.encoding])])


@contextmanager
def _rosbags(file: str) -> Generator[None]:
    """Turn the errors of rosbags about a file, and of its absence, into ours."""
    try:
        import apsw  # with rosbags
        from rosbags.rosbag1 import ReaderError as Error1
        from rosbags.rosbag2 import ReaderError as Error2
        from rosbags.serde import SerdeError
    except ImportError as error:
        raise MissingExtraError("rosbags", "bags", "reading a bag") from error
    own = (Error1, Error2, SerdeError, apsw.Error)
    foreign = (OSError, ValueError, KeyError, IndexError, AssertionError, EOFError, struct.error)
    try:
        yield
    except LogError:
        raise
    except (*own, *foreign) as error:
        raise LogError(file, f"cannot be read as a bag: {error}") from error
