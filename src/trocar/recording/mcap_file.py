"""The MCAP file of a recording: channels, schemas, and rows turned into messages."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import IO, Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, MissingExtraError
from trocar.recording.entries import entry_json
from trocar.recording.layout import (
    QUANTITIES,
    Layout,
    Rows,
    joint_values,
    object_poses,
    tip_poses,
)
from trocar.simulation.journal import Entry
from trocar.simulation.objects import FRAME

Single = NDArray[np.float32]

Array = NDArray[np.float64]

Numbers = NDArray[np.uint64]


_RULE = "=" * 80 + "\n"
_HEADER = (
    f"{_RULE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_RULE}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
JOINT_STATE = "sensor_msgs/msg/JointState"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
#: Definitions in the form of MCAP's registry, "ros2msg": the message, then the types it contains.
#: Source: ROS 2 common_interfaces and rcl_interfaces, field names and types.
SCHEMAS = {
    JOINT_STATE: "std_msgs/Header header\nstring[] name\nfloat64[] position\n"
    "float64[] velocity\nfloat64[] effort\n" + _HEADER,
    POSE_STAMPED: "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    + _HEADER
    + f"{_RULE}MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n"
    + f"{_RULE}MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    + f"{_RULE}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}
#: CDR, little endian. Source: DDS-XTYPES 1.3, section 7.6.
ENCAPSULATION = b"\x00\x01\x00\x00"
NANOSECONDS = 1_000_000_000
#: The first and the last bytes of every MCAP file. Source: MCAP specification 1, "Magic".
MAGIC = b"\x89MCAP0\r\n"
#: The end of a file without summary: DataEnd and Footer, both without checksum, and MAGIC.
#: Source: MCAP specification 1: opcode, length (8 bytes, little endian), content of each record.
END = struct.pack("<BQ4xBQ20x", 0x0F, 4, 0x02, 20) + MAGIC


class Cdr:
    """One message: its bytes, and the places of its numbers."""

    def __init__(self, frame_id: str) -> None:
        self.data = bytearray(ENCAPSULATION)
        #: Offsets of the numbers in `data`, and the column of each in the values of an instant.
        self.gaps: list[tuple[int, int]] = []
        self.data += struct.pack("<iI", 0, 0)  # the stamp, at offset 4
        self._string(frame_id)

    def joint_state(self, names: Sequence[str], values: Sequence[Sequence[int]]) -> Cdr:
        """Append names, and gaps for the columns of positions, velocities and efforts."""
        self._count(len(names))
        for name in names:
            self._string(name)
        for columns in values:
            self._count(len(columns))
            self.numbers(columns)
        return self

    def numbers(self, columns: Sequence[int]) -> Cdr:
        """Append gaps for numbers; of a pose x, y, z and the quaternion xyzw."""
        if len(columns):
            self._align(8)
        for column in columns:
            self.gaps.append((len(self.data), column))
            self.data += bytes(8)
        return self

    def _align(self, size: int) -> None:
        self.data += bytes(-(len(self.data) - len(ENCAPSULATION)) % size)

    def _count(self, count: int) -> None:
        self._align(4)
        self.data += struct.pack("<I", count)

    def _string(self, text: str) -> None:
        raw = text.encode() + b"\0"
        self._count(len(raw))
        self.data += raw


class Instants:
    """The messages of one instant, filled in for many instants at once.

    Args:
        messages: all messages of an instant
    """

    def __init__(self, messages: Sequence[Cdr]) -> None:
        ends = np.cumsum([len(m.data) for m in messages], dtype=np.intp)
        starts = np.concatenate([[0], ends[:-1]]).astype(np.intp)
        self._slices = list(map(slice, starts.tolist(), ends.tolist()))
        self._empty = np.frombuffer(b"".join(m.data for m in messages), np.uint8)
        gaps = [
            (start + offset, column)
            for start, message in zip(starts.tolist(), messages, strict=True)
            for offset, column in message.gaps
        ]
        places, self._columns = np.array(gaps, np.intp).reshape(-1, 2).T
        self._places = (places[:, None] + np.arange(8)).ravel()
        self._stamps = (starts[:, None] + len(ENCAPSULATION) + np.arange(8)).ravel()

    def fill(self, values: Array, stamps: Numbers) -> list[list[bytes]]:
        """Return the messages of k instants.

        Args:
            values: (k, numbers of an instant)
            stamps: time in their headers [ns], (k,)
        """
        count = len(values)
        out = np.tile(self._empty, (count, 1))
        numbers = np.ascontiguousarray(values[:, self._columns], "<f8")
        out[:, self._places] = numbers.view(np.uint8).reshape(count, -1)
        halves = np.stack([stamps // NANOSECONDS, stamps % NANOSECONDS], axis=1).astype("<u4")
        stamped = halves.view(np.uint8).reshape(count, 8)
        out[:, self._stamps] = np.tile(stamped, (1, len(self._slices)))
        return [[row[s] for s in self._slices] for row in map(np.ndarray.tobytes, out)]


#: Simulated time between two ROS messages of a topic [s]. Source: our own choice, 50 Hz.
MESSAGE_PERIOD_S = 0.02
#: Simulated time of a chunk [s]. A killed process loses at most this and a block of rows.
#: Source: our own choice.
CHUNK_S = 0.4
STATES, LAYOUT = "/trocar/states", "/trocar/layout"
COMMANDS, EVENTS, PAST = "/trocar/commands", "/trocar/events", "/trocar/past"
#: Schemas of the messages in JSON. Source: MCAP's registry, "jsonschema".
ENTRY_SCHEMA = json.dumps(
    {
        "type": "object",
        "properties": {
            "period": {"type": "integer"},
            "time": {"type": "number"},
            "kind": {"enum": ["command", "event"]},
            "source": {"type": "string"},
            "name": {"type": "string"},
            "values": {"type": "object"},
        },
    }
)
#: Hexadecimal digits of a digest. SHA-256, since processors have instructions for it: half the time
#: of BLAKE2b (measured).
DIGEST_LENGTH = 32


class Mcap(NamedTuple):
    """The modules of the mcap library, and the compression of its chunks."""

    records: ModuleType
    stream_reader: ModuleType
    exceptions: ModuleType
    writer: ModuleType
    zstandard: ModuleType


def mcap_library(purpose: str) -> Mcap:
    """Import mcap.

    Raises:
        MissingExtraError: it is not installed; the error names `purpose`
    """
    try:
        import zstandard
        from mcap import exceptions, records, stream_reader, writer
    except ImportError as error:
        raise MissingExtraError("mcap", "record", purpose) from error
    return Mcap(records, stream_reader, exceptions, writer, zstandard)


@dataclass(frozen=True)
class Extra:
    """A message of another source in a recording: an image, for instance.

    Attributes:
        topic: "/endoscope/left/image_raw/compressed"
        schema: its type as ROS 2 names it: "sensor_msgs/msg/CompressedImage"
        text: the type's definition, with the types that it contains
        time: simulation time [s]
        data: the message, CDR
    """

    topic: str
    schema: str
    text: str
    time: float
    data: bytes


class _Stream:
    """A binary file as mcap's Writer takes it, without a buffer.

    A buffer would keep what a full disk refuses, and write it later, after the end of the file.
    """

    def __init__(self, raw: IO[bytes]) -> None:
        self._raw = raw
        self.tell, self.flush = raw.tell, raw.flush

    def write(self, data: bytes) -> int:
        left = memoryview(data)
        while left:
            left = left[self._raw.write(left) :]
        return len(data)


class McapFile:
    """Writes rows, commands, events and other messages of one recording.

    After each chunk the file has an end, which the next chunk replaces: standard tools read the
    file of a program that was killed.

    Args:
        stream: a binary file, open for writing; `finish` and `cut_off` close it
        about: metadata of the recording
        past: commands before the first row

    Raises:
        OSError: the stream cannot be written
    """

    def __init__(self, stream: IO[bytes], about: Mapping[str, str], past: Sequence[Entry]) -> None:
        self._stream = stream
        self._start, self._timestep = float(about["start_s"]), float(about["timestep_s"])
        self._every = max(1, round(MESSAGE_PERIOD_S / self._timestep))
        #: Where the last two whole chunks end, and how many rows the file has there.
        self._whole: list[tuple[int, int]] = []
        self._writer: Any = mcap_library("recording").writer.Writer(_Stream(stream))
        self._writer.start("ros2", f"trocar {about['trocar']}")
        self._writer.add_metadata("trocar", dict(about))
        self._flush(0)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        entry = self._writer.register_schema("trocar.Entry", "jsonschema", ENTRY_SCHEMA.encode())
        form = self._writer.register_schema("trocar.Layout", "jsonschema", b'{"type": "object"}')
        for topic, encoding, schema in (
            (PAST, "json", entry),
            (COMMANDS, "json", entry),
            (EVENTS, "json", entry),
            (LAYOUT, "json", form),
            (STATES, "trocar.states", 0),
        ):
            self._channels[topic] = self._writer.register_channel(topic, encoding, schema)
        self._layout: Layout | None = None
        self._newest = self._set_back = 0
        self._instants_written = 0
        for command in past:
            self._add(PAST, self._nanoseconds(0), entry_json(command))

    def write(self, rows: Rows, entries: Sequence[tuple[int, Entry]]) -> None:
        """Write rows, and the commands and events that came before row (number, entry)."""
        for number, entry in entries:
            topic = COMMANDS if entry.kind == "command" else EVENTS
            self._add(topic, self._nanoseconds(max(number - 1, 0)), entry_json(entry))
        if len(rows.states):
            if rows.layout is not self._layout:
                self._begin(rows.layout, rows.first)
            values = joint_values(rows)
            self._add_instants(rows, values)
            end = rows.first + len(rows.states)
            packed = pack(
                PackedRows(
                    rows.layout.number,
                    rows.first,
                    rows.states[:, 0],
                    single(values),
                    digest(rows.states),
                )
            )
            self._add(STATES, self._nanoseconds(end - 1), packed)
            if (end - self._whole[-1][1]) * self._timestep >= CHUNK_S - 0.5 * self._timestep:
                self._flush(end)

    def add(self, extra: Extra) -> None:
        """Write a message of another source."""
        now = round(extra.time * NANOSECONDS)
        if now + self._set_back < self._newest:  # the world was reset
            self._set_back = self._newest - now
        self._newest = now + self._set_back
        self._channel(extra.topic, extra.schema, extra.text)
        self._add(extra.topic, self._newest, extra.data)

    def finish(self) -> None:
        """Write the summary and close the file."""
        self._writer.finish()
        self._stream.close()

    def cut_off(self) -> None:
        """End a file that cannot be written any further after its last whole chunk, and close it.

        On a full disk that chunk may have to make room for the end of the file.
        """
        with contextlib.suppress(OSError), self._stream:
            while self._whole:
                offset, _ = self._whole[-1]
                self._stream.seek(offset)
                self._stream.truncate()
                try:
                    _Stream(self._stream).write(END)
                except OSError:
                    self._whole.pop()
                else:
                    break

    @property
    def until(self) -> float:
        """Simulation time of the last row in the file [s]."""
        rows = self._whole[-1][1] if self._whole else 0
        return self._start + max(rows - 1, 0) * self._timestep

    def _flush(self, rows: int) -> None:
        """End the chunk in progress, and the file, which has so many rows now."""
        self._writer.flush()
        offset = self._stream.tell()
        _Stream(self._stream).write(END)
        self._stream.seek(offset)
        self._whole = [*self._whole[-1:], (offset, rows)]

    def _nanoseconds(self, row: int) -> int:
        """Return the log time of a row: simulated, going on over resets [ns]."""
        return round((self._start + row * self._timestep) * NANOSECONDS)

    def _add(self, topic: str, time: int, data: bytes) -> None:
        self._writer.add_message(self._channels[topic], time, data, time)

    def _channel(self, topic: str, schema: str, text: str) -> int:
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(schema, "ros2msg", text.encode())
        if topic not in self._channels:
            number = self._writer.register_channel(topic, "cdr", self._schemas[schema])
            self._channels[topic] = number
        return self._channels[topic]

    def _begin(self, layout: Layout, first: int) -> None:
        """Write a layout, and lay out the ROS messages of an instant."""
        self._layout, self._scratch = layout, mujoco.MjData(layout.model)
        values = {
            "number": layout.number,
            "first": first,
            "quantities": list(QUANTITIES),
            "arms": [dataclasses.asdict(arm) for arm in layout.arms],
            "timestep": self._timestep,
        }
        self._add(LAYOUT, self._nanoseconds(first), json.dumps(values).encode())
        messages = _messages(layout)
        self._instant_channels = [
            self._channel(topic, schema, SCHEMAS[schema]) for topic, schema, _ in messages
        ]
        self._instants = Instants([message for _, _, message in messages])

    def _add_instants(self, rows: Rows, values: Array) -> None:
        """Write the ROS messages of those rows that are due."""
        due = np.arange(-rows.first % self._every, len(rows.states), self._every)
        if not len(due):
            return
        states = rows.states[due]
        numbers = (
            values[:, :, due].reshape(-1, len(due)).T,
            tip_poses(rows.layout, self._scratch, states).reshape(len(due), -1),
            object_poses(rows.layout, states).reshape(len(due), -1),
        )
        stamps = np.round(states[:, 0] * NANOSECONDS).astype(np.uint64)
        add, channels = self._writer.add_message, self._instant_channels
        filled = self._instants.fill(np.concatenate(numbers, axis=1), stamps)
        for row, messages in zip(due.tolist(), filled, strict=True):
            time, sequence = self._nanoseconds(rows.first + row), self._instants_written
            for channel, message in zip(channels, messages, strict=True):
                add(channel, time, message, time, sequence)
            self._instants_written += 1


def _messages(layout: Layout) -> list[tuple[str, str, Cdr]]:
    """Return (topic, schema, message) of an instant.

    Their numbers are the joints' quantities, then seven of each tip, then seven of each object.
    """
    count, found = len(layout.rest), list[tuple[str, str, Cdr]]()
    seven = iter(range(len(QUANTITIES) * count, 1 << 30, 7))
    for arm, frame_id in zip(layout.arms, layout.frame_ids, strict=True):
        columns = range(arm.columns.start, arm.columns.stop)
        own = len(columns) - arm.jaw
        for topic, part in ((f"/{arm.name}", slice(own)), (f"/{arm.name}/jaw", slice(own, None))):
            names = arm.joints[part]
            if not names:
                continue
            q, v, effort, goal = ([k * count + c for c in columns[part]] for k in range(4))
            for name, numbers in (("measured", (q, v, effort)), ("setpoint", (goal, (), ()))):
                message = Cdr("").joint_state(names, numbers)
                found.append((f"{topic}/{name}_js", JOINT_STATE, message))
        first = next(seven)
        tip = Cdr(frame_id).numbers(range(first, first + 7))
        found.append((f"/{arm.name}/measured_cp", POSE_STAMPED, tip))
    for name in layout.objects:
        first = next(seven)
        place = Cdr(FRAME).numbers(range(first, first + 7))
        found.append((f"/scene/{name}/measured_cp", POSE_STAMPED, place))
    return found


# ------------------------------------------------------------------ messages of /trocar/states
#
# The length of the head (4 bytes), the head (JSON), then numbers: the times, and the values as
# float32, all values of a joint in a row. Packing the values loses nothing: each one's bits become
# the difference to those of the value before (int32, wrapping), and the bytes of all differences
# are sorted by significance, which halves the compressed size.


@dataclass(frozen=True, eq=False)
class PackedRows:
    """Joint values of consecutive steps.

    Attributes:
        layout: number of the layout that names the columns
        first: number of the first row since the recording began
        times: simulation time of each row, (k,) [s]
        values: positions, velocities, efforts, set-points, (4, n_joints, k)
        digest: of the rows of the physics state in full precision
    """

    layout: int
    first: int
    times: Array
    values: Single
    digest: str


def digest(states: Array) -> str:
    """Return a fingerprint of rows of the physics state: it differs where one bit does."""
    return hashlib.sha256(np.ascontiguousarray(states).data).hexdigest()[:DIGEST_LENGTH]


def single(values: Array) -> Single:
    """Return values in stored precision; those beyond float32 become infinite."""
    with np.errstate(over="ignore"):
        return values.astype("<f4")


def pack(rows: PackedRows) -> bytes:
    """Return rows as the data of a message."""
    head = {
        "layout": rows.layout,
        "first": rows.first,
        "shape": list(rows.values.shape),
        "digest": rows.digest,
    }
    text = json.dumps(head).encode()
    bits = np.ascontiguousarray(rows.values).view("<i4")
    change = np.diff(bits, axis=-1, prepend=np.int32(0)).astype("<i4", copy=False)
    planes = np.ascontiguousarray(change).view(np.uint8).reshape(-1, 4).T
    times = np.ascontiguousarray(rows.times, "<f8")
    return b"".join([struct.pack("<I", len(text)), text, times.tobytes(), planes.tobytes()])


def unpack(data: bytes) -> PackedRows:
    """Return rows from the data of a message.

    Raises:
        InputError: the data are no rows
    """
    try:
        (length,) = struct.unpack_from("<I", data)
        head: Mapping[str, Any] = json.loads(data[4 : 4 + length])
        shape = tuple(int(n) for n in head["shape"])
        quantities, joints, count = shape
        at = 4 + length + 8 * count
        times = np.frombuffer(data, "<f8", count, 4 + length)
        planes = np.frombuffer(data, np.uint8, 4 * quantities * joints * count, at)
        change = np.ascontiguousarray(planes.reshape(4, -1).T).view("<i4").reshape(shape)
        bits = np.cumsum(change, axis=-1, dtype=np.int32)
        return PackedRows(
            int(head["layout"]),
            int(head["first"]),
            times.astype(np.float64),
            bits.view("<f4"),
            str(head["digest"]),
        )
    except (KeyError, TypeError, ValueError, struct.error) as error:
        raise InputError(f"a block of states is damaged: {error}") from error
