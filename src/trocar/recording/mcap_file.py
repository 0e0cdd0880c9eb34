"""The MCAP file of a recording: channels, schemas, and rows turned into messages."""

from __future__ import annotations

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
from trocar.recording.layout import QUANTITIES, Layout, Rows, joint_values, tip_poses
from trocar.recording.ros2 import JOINT_STATE, NANOSECONDS, POSE_STAMPED, SCHEMAS, Cdr, Instants
from trocar.simulation.journal import Entry
from trocar.simulation.objects import FRAME

Array = NDArray[np.float64]
Single = NDArray[np.float32]

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


class McapFile:
    """Writes rows, commands, events and other messages of one recording.

    Args:
        stream: a binary file, open for writing; `finish` closes it
        about: metadata of the recording
        past: commands before the first row

    Raises:
        OSError: the stream cannot be written
    """

    def __init__(self, stream: IO[bytes], about: Mapping[str, str], past: Sequence[Entry]) -> None:
        self._stream = stream
        self._start, self._timestep = float(about["start_s"]), float(about["timestep_s"])
        self._every = max(1, round(MESSAGE_PERIOD_S / self._timestep))
        self._writer: Any = mcap_library("recording").writer.Writer(stream)
        self._writer.start("ros2", f"trocar {about['trocar']}")
        self._writer.add_metadata("trocar", dict(about))
        self._writer.flush()
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
        self._flushed_row = self._instants_written = 0
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
            if (end - self._flushed_row) * self._timestep >= CHUNK_S - 0.5 * self._timestep:
                self._flushed_row = end
                self._writer.flush()

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
        self._writer.flush()  # the writer's own buffer of a raw stream
        self._stream.close()

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
            states[:, rows.layout.places].reshape(len(due), -1),
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
    """Joint values of consecutive periods.

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
