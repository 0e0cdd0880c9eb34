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
from trocar.messages import cdr_encode, message_type
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


JOINT_STATE = "sensor_msgs/msg/JointState"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
NANOSECONDS = 1_000_000_000
#: The first and the last bytes of every MCAP file. Source: MCAP specification 1, "Magic".
MAGIC = b"\x89MCAP0\r\n"
#: The end of a file without summary: DataEnd and Footer, both without checksum, and MAGIC.
#: Source: MCAP specification 1: opcode, length (8 bytes, little endian), content of each record.
END = struct.pack("<BQ4xBQ20x", 0x0F, 4, 0x02, 20) + MAGIC


class StateMessage(NamedTuple):
    """A ROS message of the recorded states, and its columns in the numbers of an instant.

    Attributes:
        topic, schema: "/PSM1/measured_js", JOINT_STATE
        frame_id: of its header
        names: joints; () for a pose
        columns: of positions, velocities and efforts; of a pose one slice of 7, quaternion xyzw
    """

    topic: str
    schema: str
    frame_id: str
    names: tuple[str, ...]
    columns: tuple[slice, ...]

    def encode(self, numbers: Array, stamp: tuple[int, int]) -> bytes:
        """Return the message in CDR.

        Args:
            numbers: of the instant, as `_messages` numbers them
            stamp: (s, ns)
        """
        header = {"stamp": stamp, "frame_id": self.frame_id}
        if self.schema == JOINT_STATE:
            q, v, effort = (numbers[part] for part in self.columns)
            fields = {"name": self.names, "position": q, "velocity": v, "effort": effort}
            return cdr_encode(JOINT_STATE, {"header": header, **fields})
        x, y, z, qx, qy, qz, qw = numbers[self.columns[0]].tolist()
        pose = {
            "position": {"x": x, "y": y, "z": z},
            "orientation": {"x": qx, "y": qy, "z": qz, "w": qw},
        }
        return cdr_encode(POSE_STAMPED, {"header": header, "pose": pose})


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
        #: (end offset, number of rows in the file up to there) of the last two whole chunks.
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
        self._messages = [
            (self._channel(m.topic, m.schema, message_type(m.schema).text_ros2), m)
            for m in _messages(layout)
        ]

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
        instants = np.concatenate(numbers, axis=1)
        for row, simulated, instant in zip(due.tolist(), states[:, 0], instants, strict=True):
            time = self._nanoseconds(rows.first + row)
            stamp = divmod(round(float(simulated) * NANOSECONDS), NANOSECONDS)
            for channel, message in self._messages:
                data = message.encode(instant, stamp)
                self._writer.add_message(channel, time, data, time, self._instants_written)
            self._instants_written += 1


def _messages(layout: Layout) -> list[StateMessage]:
    """Return the ROS messages of an instant.

    Its numbers are the joints' quantities, then seven of each tip, then seven of each object.
    """
    count, found = len(layout.rest), list[StateMessage]()
    poses = iter(range(len(QUANTITIES) * count, 1 << 30, 7))

    def pose(topic: str, frame_id: str) -> StateMessage:
        first = next(poses)
        return StateMessage(topic, POSE_STAMPED, frame_id, (), (slice(first, first + 7),))

    for arm, frame_id in zip(layout.arms, layout.frame_ids, strict=True):
        own = len(arm.joints) - arm.jaw
        for topic, part in ((f"/{arm.name}", slice(own)), (f"/{arm.name}/jaw", slice(own, None))):
            names, columns = arm.joints[part], range(arm.first, arm.columns.stop)[part]
            if not names:
                continue
            q, v, effort, goal = (
                slice(columns.start + k * count, columns.stop + k * count) for k in range(4)
            )
            for name, numbers in (
                ("measured", (q, v, effort)),
                ("setpoint", (goal, slice(0), slice(0))),
            ):
                found.append(StateMessage(f"{topic}/{name}_js", JOINT_STATE, "", names, numbers))
        found.append(pose(f"/{arm.name}/measured_cp", frame_id))
    found += [pose(f"/scene/{name}/measured_cp", FRAME) for name in layout.objects]
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
