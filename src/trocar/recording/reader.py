"""Read recordings back, also those whose end is missing."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.overlay import Overlay, parse_overlay
from trocar.errors import InputError, LogError
from trocar.recording.entries import entry_from_json, restored
from trocar.recording.layout import QUANTITIES, ArmColumns
from trocar.recording.mcap_file import (
    COMMANDS,
    EVENTS,
    LAYOUT,
    MAGIC,
    PAST,
    STATES,
    PackedRows,
    mcap_library,
    unpack,
)
from trocar.recording.metadata import ABOUT, FORMAT
from trocar.simulation.journal import Entry

Array = NDArray[np.float64]

#: Errors of Python for damaged lengths and texts, for memory too: a length may be terabytes.
UNREADABLE = ValueError, struct.error, MemoryError, OverflowError

#: Errors of Python for damaged JSON.
DAMAGED = KeyError, TypeError, ValueError, AttributeError, RecursionError


@dataclass(frozen=True, eq=False)
class Recorded:
    """The contents of a recording but for its states, which are read block by block.

    Attributes:
        file: where it is
        about: rig, versions, arguments of the world, ... by name
        past: commands that came before the first row, back to the building of the world
        entries: commands and events of the recording, in their order
        layouts: {number: columns of each arm}
        rows: rows of states; the first is the state that the recording began with
        start, end: simulated time of the first row, and that many steps later [s]
        problem: why the file ends early, "" where it is whole
    """

    file: str
    about: Mapping[str, str]
    past: tuple[Entry, ...]
    entries: tuple[Entry, ...]
    layouts: Mapping[int, tuple[ArmColumns, ...]]
    rows: int
    start: float
    end: float
    problem: str

    @property
    def timestep(self) -> float:
        """Physics time step [s]."""
        return float(self.about["timestep_s"])

    def arguments(self) -> dict[str, Any]:
        """Return the world's arguments.

        Raises:
            LogError: they are damaged
        """
        try:
            texts: dict[str, Any] = json.loads(self.about["arguments"])
            return {name: restored(value) for name, value in texts.items()}
        except DAMAGED as error:
            raise LogError(self.file, f"cannot be understood: arguments: {error}") from error

    def overlays(self) -> dict[str, Overlay]:
        """Return the overlays of calibrated arms, by arm.

        Raises:
            LogError: they are damaged
        """
        try:
            texts: dict[str, list[str]] = json.loads(self.about.get("calibration", "{}"))
            return {
                arm: parse_overlay(text, name or f"{self.file}: calibration of {arm}")
                for arm, (name, text) in texts.items()
            }
        except (InputError, *DAMAGED) as error:
            raise LogError(self.file, f"cannot be understood: calibration: {error}") from error

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of all arms."""
        return tuple(dict.fromkeys(arm.name for arms in self.layouts.values() for arm in arms))

    def blocks(self) -> Iterator[PackedRows]:
        """Read the states block by block."""
        for message in mcap_messages(self.file):
            if message.topic == STATES:
                yield unpack(message.data)

    def states(self, arm: ArmColumns, every: int = 1) -> ArmStates:
        """Return one arm's states, of every n-th row; rows of other joints are left out."""
        which = arm.name, arm.joints
        times: list[Array] = []
        values: list[Array] = []
        for block in self.blocks():
            same = (a for a in self.layouts[block.layout] if (a.name, a.joints) == which)
            own = next(same, None)
            if own is None:
                continue
            due = slice(-block.first % every, None, every)
            rows = np.arange(block.first, block.first + len(block.times))[due]
            times.append(np.asarray(self.start + rows * self.timestep, np.float64))
            values.append(block.values[:, own.columns, due].astype(np.float64))
        if not times:
            return ArmStates(arm, np.zeros(0), *np.zeros((len(QUANTITIES), 0, len(arm.joints))))
        table = np.concatenate(values, axis=-1).transpose(0, 2, 1)
        return ArmStates(arm, np.concatenate(times), *table)

    def columns(self, name: str) -> ArmColumns | None:
        """Return an arm's columns in the first layout that has it."""
        found = (arm for arms in self.layouts.values() for arm in arms if arm.name == name)
        return next(found, None)


@dataclass(frozen=True, eq=False)
class ArmStates:
    """One arm over time.

    Attributes:
        arm: whose joints these are
        time: since the world was built or reset last, going on over resets, (k,) [s]
        position, velocity, effort, setpoint: (k, n) [rad or m, per s, N m or N]
    """

    arm: ArmColumns
    time: Array
    position: Array
    velocity: Array
    effort: Array
    setpoint: Array


class McapMessage(NamedTuple):
    """A message of an MCAP file: topic, name of its schema, log time [ns], data."""

    topic: str
    schema: str
    time: int
    data: bytes


def is_mcap(path: str | Path) -> bool:
    """Return whether a file begins like an MCAP file."""
    where = Path(path).expanduser()
    if not where.is_file():
        return False
    with where.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def is_recording(path: str | Path) -> bool:
    """Return whether a file is a recording of trocar's own, whole or not."""
    if not is_mcap(path):
        return False
    messages = _Messages(path)
    next(iter(messages), None)
    return bool(messages.about)


def open_recording(path: str | Path) -> Recorded:
    """Read a recording but for its states.

    Raises:
        LogError: no recording, one of another format, or one without a single state
        MissingExtraError: the library for MCAP is not installed
    """
    file = str(path)
    if not Path(path).expanduser().is_file():
        what = "is a folder" if Path(path).expanduser().is_dir() else "there is no such file"
        raise LogError(file, f"{what}; allowed: a recording (MCAP)")
    messages = _Messages(path)
    past: list[Entry] = []
    entries: list[Entry] = []
    layouts: dict[int, tuple[ArmColumns, ...]] = {}
    rows = 0
    try:
        for topic, _, _, data in messages:
            messages.check_format()
            if topic == PAST:
                past.append(entry_from_json(data))
            elif topic in (COMMANDS, EVENTS):
                entries.append(entry_from_json(data))
            elif topic == LAYOUT:
                values = json.loads(data)
                layouts[int(values["number"])] = tuple(map(_arm_columns, values["arms"]))
            elif topic == STATES:
                block = unpack(data)
                rows = block.first + len(block.times)
    except (InputError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, LogError):
            raise
        raise LogError(file, f"cannot be understood: {error}") from error
    messages.check_format()
    about, problem = messages.about, messages.problem
    if not rows:
        raise LogError(file, f"holds no states{f' ({problem})' if problem else ''}")
    if lost := sorted(ABOUT - set(about)):
        raise LogError(file, f"cannot be understood: it says nothing of {', '.join(lost)}")
    try:
        start = float(about["start_s"])
        end = start + (rows - 1) * float(about["timestep_s"])
    except ValueError as error:
        raise LogError(file, f"cannot be understood: start or time step: {error}") from error
    return Recorded(file, about, tuple(past), tuple(entries), layouts, rows, start, end, problem)


def mcap_messages(path: str | Path) -> Iterator[McapMessage]:
    """Read the messages of any MCAP file, up to where it ends or breaks off.

    Raises:
        LogError: no such file, or none of MCAP
        MissingExtraError: the library for MCAP is not installed
    """
    return iter(_Messages(path))


def mcap_topics(path: str | Path) -> dict[str, str]:
    """Return {topic: name of its schema} as the summary of an MCAP file lists them.

    Empty for a file without a summary, such as one that breaks off. No chunk is unpacked.

    Raises:
        MissingExtraError: the library for MCAP is not installed
    """
    mcap = mcap_library("reading a recording")
    schemas, found = {0: ""}, dict[str, int]()
    where = Path(path).expanduser()
    with where.open("rb") as stream:
        size = where.stat().st_size
        reader = mcap.stream_reader.StreamReader(stream, emit_chunks=True, record_size_limit=size)
        try:
            for record in reader.records:
                if isinstance(record, mcap.records.Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, mcap.records.Channel):
                    found[record.topic] = record.schema_id
        except (*UNREADABLE, mcap.exceptions.McapError):
            return {}
    return {topic: schemas.get(schema, "") for topic, schema in found.items()}


def _arm_columns(values: dict[str, Any]) -> ArmColumns:
    """Return columns from JSON, which has no tuples."""
    values["joints"], values["kinds"] = tuple(values["joints"]), tuple(values["kinds"])
    return ArmColumns(**values)


class _Messages:
    """Reads the messages of an MCAP file up to where it ends or breaks off.

    Attributes:
        about: metadata of a recording of trocar's, as soon as the first message is read
        problem: why the file ends early, "" while it is whole
    """

    def __init__(self, path: str | Path) -> None:
        self._mcap = mcap_library("reading a recording")
        self._path, self._file = Path(path).expanduser(), str(path)
        self.about: dict[str, str] = {}
        self.problem = ""

    def __iter__(self) -> Iterator[McapMessage]:
        try:
            with self._path.open("rb") as stream:
                if stream.read(len(MAGIC)) != MAGIC:
                    raise LogError(self._file, "is no recording; allowed: an MCAP file")
                stream.seek(0)
                yield from self._read(stream)
        except OSError as error:
            raise LogError(self._file, f"cannot be read: {error.strerror or error}") from error

    def check_format(self) -> None:
        """Reject other MCAP files, and recordings in a format of another version.

        Raises:
            LogError: got and allowed format
        """
        if not self.about:
            why = f" ({self.problem})" if self.problem else ""
            raise LogError(self._file, f"is an MCAP file, but no recording of trocar's{why}")
        if self.about.get("format") != str(FORMAT):
            raise LogError(
                self._file,
                f"got recording format {self.about.get('format')}, written by trocar"
                f" {self.about.get('trocar')}; allowed: format {FORMAT}",
            )

    def _read(self, stream: IO[bytes]) -> Iterator[McapMessage]:
        mcap, size = self._mcap, self._path.stat().st_size
        schemas: dict[int, str] = {0: ""}
        channels: dict[int, Any] = {}
        reader = mcap.stream_reader.StreamReader(stream, record_size_limit=size, validate_crcs=True)
        broken = (*UNREADABLE, mcap.exceptions.McapError, mcap.zstandard.ZstdError)
        try:
            for record in reader.records:
                if isinstance(record, mcap.records.Metadata) and record.name == "trocar":
                    self.about.update(record.metadata)
                elif isinstance(record, mcap.records.Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, mcap.records.Channel):
                    channels[record.id] = record
                elif isinstance(record, mcap.records.Message):
                    channel = channels[record.channel_id]
                    schema = schemas[channel.schema_id]
                    yield McapMessage(channel.topic, schema, record.log_time, record.data)
                elif isinstance(record, mcap.records.Footer) and not record.summary_start:
                    self.problem = "it breaks off: the program ended before its recording"
        except (mcap.exceptions.EndOfFile, mcap.exceptions.RecordLengthLimitExceeded):
            self.problem = "it breaks off: the file ends inside a record"
        except broken as error:
            self.problem = f"it breaks off: damaged: {' '.join(str(error).split())}"
