"""Read recordings back, also those whose end is missing."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, LogError
from trocar.simulation.journal import Entry
from trocar.simulation.recording.blocks import PackedBlock, unpack
from trocar.simulation.recording.layout import QUANTITIES, ArmColumns, arm_columns
from trocar.simulation.recording.library import Mcap, mcap_library
from trocar.simulation.recording.mcap_file import MAGIC
from trocar.simulation.recording.recorder import FORMAT
from trocar.simulation.recording.scribe import COMMANDS, EVENTS, LAYOUT, PAST, STATES
from trocar.simulation.recording.values import entry_from_json

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a recording holds, its states apart: these are read block by block.

    Attributes:
        file: where it is
        about: rig, versions, arguments of the world, ... by name
        past: commands that came before the first row, back to the building of the world
        entries: commands and events of the recording, in their order
        layouts: {number: columns of each arm}
        rows: rows of states; the first is the state that the recording began with
        start, end: simulated time of the first row, and that many periods later [s]
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
        """Physics period [s]."""
        return float(self.about["timestep_s"])

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of all arms."""
        return tuple(dict.fromkeys(arm.name for arms in self.layouts.values() for arm in arms))

    def blocks(self) -> Iterator[PackedBlock]:
        """Read the states block by block."""
        for told in _messages(Path(self.file).expanduser(), self.file, _Notes()):
            if told.topic == STATES:
                yield unpack(told.data)

    def states(self, arm: ArmColumns, every: int = 1) -> ArmStates:
        """Return one arm's states, of every n-th row; rows of other joints are left out."""
        times: list[Array] = []
        values: list[Array] = []
        for block in self.blocks():
            own = self._same(arm, block.layout)
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

    def _same(self, arm: ArmColumns, layout: int) -> ArmColumns | None:
        """Return where the arm is in a layout, None where it has other joints."""
        found = (a for a in self.layouts[layout] if a.name == arm.name and a.joints == arm.joints)
        return next(found, None)

    def columns(self, name: str) -> ArmColumns | None:
        """Return where an arm's joints are in the first layout that has it."""
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


class Told(NamedTuple):
    """A message of an MCAP file: topic, name of its schema, when it was logged [ns], its data."""

    topic: str
    schema: str
    time: int
    data: bytes


@dataclass
class _Notes:
    """What a reading found beside messages."""

    about: dict[str, str] = field(default_factory=dict[str, str])
    problem: str = ""


def is_mcap(path: str | Path) -> bool:
    """Tell whether a file begins like an MCAP file."""
    where = Path(path).expanduser()
    if not where.is_file():
        return False
    with where.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def is_recording(path: str | Path) -> bool:
    """Tell whether a file is a recording of trocar's own, whole or not."""
    if not is_mcap(path):
        return False
    notes = _Notes()
    next(_messages(Path(path).expanduser(), str(path), notes), None)
    return bool(notes.about)


def open_recording(path: str | Path) -> Recorded:
    """Read a recording but for its states.

    Raises:
        LogError: no recording, one of another format, or one without a single state
        MissingExtraError: the library for MCAP is not installed
    """
    where, file = Path(path).expanduser(), str(path)
    if not where.is_file():
        what = "is a folder" if where.is_dir() else "there is no such file"
        raise LogError(file, f"{what}; allowed: a recording (MCAP)")
    notes = _Notes()
    past: list[Entry] = []
    entries: list[Entry] = []
    layouts: dict[int, tuple[ArmColumns, ...]] = {}
    rows = 0
    try:
        for topic, _, _, data in _messages(where, file, notes):
            _check(file, notes)
            if topic == PAST:
                past.append(entry_from_json(data))
            elif topic in (COMMANDS, EVENTS):
                entries.append(entry_from_json(data))
            elif topic == LAYOUT:
                values = json.loads(data)
                layouts[int(values["number"])] = tuple(map(arm_columns, values["arms"]))
            elif topic == STATES:
                block = unpack(data)
                rows = block.first + len(block.times)
    except (InputError, KeyError, ValueError) as error:
        if isinstance(error, LogError):
            raise
        raise LogError(file, f"cannot be understood: {error}") from error
    _check(file, notes)
    if not rows:
        raise LogError(file, f"holds no states{_because(notes.problem)}")
    start = float(notes.about["start_s"])
    end = start + (rows - 1) * float(notes.about["timestep_s"])
    return Recorded(
        file,
        notes.about,
        tuple(past),
        tuple(entries),
        layouts,
        rows,
        start,
        end,
        notes.problem,
    )


def _because(problem: str) -> str:
    return f" ({problem})" if problem else ""


def _check(file: str, notes: _Notes) -> None:
    """Refuse what is no recording of ours, or one that this version cannot read."""
    if not notes.about:
        raise LogError(
            file, f"is an MCAP file, but no recording of trocar's{_because(notes.problem)}"
        )
    if notes.about.get("format") != str(FORMAT):
        raise LogError(
            file,
            f"got format {notes.about.get('format')}, written by trocar"
            f" {notes.about.get('trocar')}; allowed: {FORMAT}",
        )


def mcap_messages(path: str | Path) -> Iterator[Told]:
    """Read the messages of any MCAP file, up to where it ends or breaks off.

    Raises:
        LogError: no such file, or none of MCAP
        MissingExtraError: the library for MCAP is not installed
    """
    return _messages(Path(path).expanduser(), str(path), _Notes())


def mcap_topics(path: str | Path) -> dict[str, str]:
    """Return {topic: name of its schema} as the summary of an MCAP file lists them.

    Empty for a file without a summary, such as one that breaks off. No chunk is unpacked.

    Raises:
        MissingExtraError: the library for MCAP is not installed
    """
    mcap = mcap_library("reading a recording")
    records, schemas, found = mcap.records, {0: ""}, dict[str, int]()
    where = Path(path).expanduser()
    with where.open("rb") as stream:
        size = where.stat().st_size
        reader = mcap.stream_reader.StreamReader(stream, emit_chunks=True, record_size_limit=size)
        try:
            for record in reader.records:
                if isinstance(record, records.Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, records.Channel):
                    found[record.topic] = record.schema_id
        except (mcap.exceptions.McapError, ValueError, struct.error):
            return {}
    return {topic: schemas.get(schema, "") for topic, schema in found.items()}


def _messages(path: Path, file: str, notes: _Notes) -> Iterator[Told]:
    """Give every message up to where the file ends or breaks off, and note what else is there."""
    mcap = mcap_library("reading a recording")
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise LogError(file, "is no recording; allowed: an MCAP file")
            stream.seek(0)
            yield from _records(mcap, stream, path.stat().st_size, notes)
    except OSError as error:
        raise LogError(file, f"cannot be read: {error.strerror or error}") from error


def _records(mcap: Mcap, stream: IO[bytes], size: int, notes: _Notes) -> Iterator[Told]:
    records = mcap.records
    schemas: dict[int, str] = {0: ""}
    channels: dict[int, Any] = {}
    reader = mcap.stream_reader.StreamReader(stream, record_size_limit=size, validate_crcs=True)
    found = iter(reader.records)
    while True:
        try:
            record: Any = next(found)
        except StopIteration:
            return
        except (mcap.exceptions.EndOfFile, mcap.exceptions.RecordLengthLimitExceeded):
            notes.problem = "it breaks off: the file ends inside a record"
            return
        except (mcap.exceptions.McapError, mcap.zstandard.ZstdError, ValueError, struct.error) as e:
            notes.problem = f"it breaks off: damaged: {' '.join(str(e).split())}"
            return
        if isinstance(record, records.Metadata) and record.name == "trocar":
            notes.about.update(record.metadata)
        elif isinstance(record, records.Channel):
            channels[record.id] = record
        elif isinstance(record, records.Schema):
            schemas[record.id] = record.name
        elif isinstance(record, records.Message):
            channel = channels[record.channel_id]
            yield Told(channel.topic, schemas[channel.schema_id], record.log_time, record.data)
