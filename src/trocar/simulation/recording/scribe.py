"""Turns blocks into a file."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import IO

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.simulation.journal import Entry
from trocar.simulation.objects import FRAME
from trocar.simulation.recording.blocks import PackedBlock, digest, pack, single
from trocar.simulation.recording.extras import Extra
from trocar.simulation.recording.layout import QUANTITIES, quantities
from trocar.simulation.recording.mcap_file import McapFile, Part, messages
from trocar.simulation.recording.ros2 import (
    JOINT_STATE,
    NANOSECONDS,
    POSE_STAMPED,
    SCHEMAS,
    Cdr,
    Instants,
)
from trocar.simulation.recording.sampler import Block, Shape
from trocar.simulation.recording.values import entry_json

Array = NDArray[np.float64]

#: Simulated time between two messages for people [s]. Source: our own choice, 50 Hz.
MESSAGE_PERIOD_S = 0.02
STATES, LAYOUT = "/trocar/states", "/trocar/layout"
COMMANDS, EVENTS, PAST = "/trocar/commands", "/trocar/events", "/trocar/past"
#: Messages of others that wait for the next block. Source: our own choice, a megabyte of images.
MOST_EXTRAS = 24
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


class Scribe:
    """Writes blocks to a stream; the first thing that goes wrong is said once, and kept.

    Args:
        stream: a binary file, open for writing; the scribe closes it
        about: names and values of the whole recording
        start: simulation time of the first row [s]
        timestep: physics period [s]
        complain: told why nothing more is written
    """

    def __init__(
        self,
        stream: IO[bytes],
        about: dict[str, str],
        start: float,
        timestep: float,
        complain: Callable[[str], None],
    ) -> None:
        self._stream, self._complain = stream, complain
        self._start, self._timestep = start, timestep
        self._every = max(1, round(MESSAGE_PERIOD_S / timestep))
        self._shape: Shape | None = None
        self._instants: Instants | None = None
        self._scratch: mujoco.MjData | None = None
        self._told = 0
        self._channels: dict[str, int] = {}
        self._extras: list[tuple[int, int, bytes]] = []
        self._newest = self._turned_back = 0
        #: Why nothing more is written, "" while all is well.
        self.failure = ""
        self._file = McapFile(stream, "ros2", f"trocar {about['trocar']}")
        self._file.metadata("trocar", about)
        text = self._file.schema("trocar.Entry", "jsonschema", ENTRY_SCHEMA)
        form = self._file.schema("trocar.Layout", "jsonschema", '{"type": "object"}')
        for topic in (PAST, COMMANDS, EVENTS):
            self._channels[topic] = self._file.channel(topic, "json", text)
        self._channels[LAYOUT] = self._file.channel(LAYOUT, "json", form)
        self._channels[STATES] = self._file.channel(STATES, "trocar.states")
        self._schemas = {n: self._file.schema(n, "ros2msg", t) for n, t in SCHEMAS.items()}

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._file.size

    def past(self, entries: Sequence[Entry]) -> None:
        """Write the commands that came before the first row; called before any block is."""
        now = self._nanoseconds(0)
        channel = self._channels[PAST]
        self._file.chunk([messages([(channel, now, entry_json(e)) for e in entries])])

    def write(self, block: Block) -> None:
        """Write a block; an error of the disk is kept, and nothing more is written."""
        if self.failure:
            return
        try:
            self._write(block)
        except OSError as error:
            self._give_up(error)

    def add(self, extra: Extra) -> None:
        """Write a message of somebody else, with the next block or soon."""
        now = round(extra.time * NANOSECONDS)
        if now + self._turned_back < self._newest:  # the world was reset
            self._turned_back = self._newest - now
        self._newest = now + self._turned_back
        if extra.schema not in self._schemas:
            self._schemas[extra.schema] = self._file.schema(extra.schema, "ros2msg", extra.text)
        self._extras.append((self._channel(extra.topic, extra.schema), self._newest, extra.data))
        if len(self._extras) >= MOST_EXTRAS:
            try:
                self._flush()
            except OSError as error:
                self._give_up(error)

    def _flush(self) -> None:
        extras, self._extras = self._extras, []
        if extras and not self.failure:
            self._file.chunk([messages(extras)])

    def finish(self) -> None:
        """Write the summary and close the file."""
        try:
            if not self.failure:
                self._flush()
                self._file.finish()
            self._stream.close()
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        if not self.failure:
            self.failure = error.strerror or str(error)
            self._complain(self.failure)

    def _write(self, block: Block) -> None:
        self._flush()
        parts: list[Part] = []
        if block.shape is not self._shape:
            parts.append(self._begin(block.shape, block.first))
        parts.append(self._entries(block))
        if len(block.rows):
            values = quantities(block.shape.layout, block.rows, block.inputs, block.laws)
            parts.append(self._for_people(block, values))
            packed = PackedBlock(
                block.shape.number,
                block.first,
                block.times,
                single(values),
                digest(block.rows),
            )
            now = self._nanoseconds(block.first + len(block.rows) - 1)
            parts.append(messages([(self._channels[STATES], now, pack(packed))]))
        self._file.chunk(parts)

    def _nanoseconds(self, row: int) -> int:
        """Return the time that a row is logged at: simulated, and never going back [ns]."""
        return round((self._start + row * self._timestep) * NANOSECONDS)

    def _begin(self, shape: Shape, first: int) -> Part:
        """Say what the rows mean from now on, and lay out the messages for people."""
        self._shape, self._scratch = shape, mujoco.MjData(shape.model)
        self._instants = Instants(self._templates(shape))
        layout = {
            "number": shape.number,
            "first": first,
            "quantities": list(QUANTITIES),
            "arms": [arm.as_dict() for arm in shape.layout.arms],
            "timestep": self._timestep,
        }
        data = json.dumps(layout).encode()
        return messages([(self._channels[LAYOUT], self._nanoseconds(first), data)])

    def _templates(self, shape: Shape) -> list[tuple[int, Cdr]]:
        """Lay out an instant: numbers of `quantities`, seven of each tip, seven of each object."""
        count, found = shape.layout.joints, list[tuple[int, Cdr]]()
        for index, arm in enumerate(shape.layout.arms):
            own = range(arm.first, arm.first + len(arm.joints) - arm.jaw)
            parts = [(f"/{arm.name}", own, arm.joints[: len(own)])]
            if arm.jaw:
                jaw = range(own.stop, own.stop + 1)
                parts.append((f"/{arm.name}/jaw", jaw, arm.joints[len(own) :]))
            for topic, columns, names in parts:
                q, v, effort, told = ([k * count + c for c in columns] for k in range(4))
                for name, which in (("measured", (q, v, effort)), ("setpoint", (told, (), ()))):
                    channel = self._channel(f"{topic}/{name}_js", JOINT_STATE)
                    found.append((channel, Cdr("").joint_state(names, which)))
            first = len(QUANTITIES) * count + 7 * index
            channel = self._channel(f"/{arm.name}/measured_cp", POSE_STAMPED)
            tip = Cdr(shape.tips.frame_ids[index]).pose(range(first, first + 7))
            found.append((channel, tip))
        first = len(QUANTITIES) * count + 7 * len(shape.layout.arms)
        for index, name in enumerate(shape.layout.objects):
            channel = self._channel(f"/scene/{name}/measured_cp", POSE_STAMPED)
            seven = range(first + 7 * index, first + 7 * index + 7)
            found.append((channel, Cdr(FRAME).pose(seven)))
        return found

    def _channel(self, topic: str, schema: str) -> int:
        if topic not in self._channels:
            self._channels[topic] = self._file.channel(topic, "cdr", self._schemas[schema])
        return self._channels[topic]

    def _for_people(self, block: Block, values: Array) -> Part:
        """Return the messages of those instants that are due in a block."""
        due = np.arange(-block.first % self._every, len(block.rows), self._every)
        if not len(due) or self._scratch is None or self._instants is None:
            return messages([])
        qpos = block.rows[due, block.shape.layout.parts["qpos"]]
        tips = block.shape.tips.poses(block.shape.model, self._scratch, qpos)
        objects = qpos[:, block.shape.layout.places]
        of_joints = values[:, :, due].reshape(-1, len(due)).T
        numbers = np.concatenate(
            [of_joints, tips.reshape(len(due), -1), objects.reshape(len(due), -1)], axis=1
        )
        logged = (self._start + (block.first + due) * self._timestep) * NANOSECONDS
        stamps = np.round(block.times[due] * NANOSECONDS)
        part = self._instants.part(
            numbers, np.round(logged).astype(np.uint64), stamps.astype(np.uint64), self._told
        )
        self._told += len(due)
        return part

    def _entries(self, block: Block) -> Part:
        """Return the commands and events of a block, logged at the state that they met."""
        return messages(
            [
                (
                    self._channels[COMMANDS if entry.kind == "command" else EVENTS],
                    self._nanoseconds(max(row - 1, 0)),
                    entry_json(entry),
                )
                for row, entry in block.entries
            ]
        )
