"""The process that writes a recording: messages come in by a pipe, what goes wrong goes out."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path
from typing import IO, Any

import numpy as np

from trocar.simulation.recording.sampler import Block, Shape
from trocar.simulation.recording.scribe import Scribe
from trocar.simulation.recording.writers import LENGTH


def main() -> None:
    """Write until the pipe ends; it also ends when the simulation is killed."""
    source = sys.stdin.buffer
    first = _receive(source)
    if first is None:
        return
    _, path, about, start, timestep = first
    stream = Path(path).open("wb")  # noqa: SIM115  the scribe closes it
    scribe = Scribe(stream, about, start, timestep, lambda why: _tell(failure=why))
    _tell(ready=True)
    shape: Shape | None = None
    while (message := _receive(source)) is not None:
        kind, *content = message
        if kind == "past":
            scribe.past(content[0])
        elif kind == "shape":
            shape = content[0]
        elif shape is not None:
            block = _block(source, shape, content)
            if block is None:
                break
            scribe.write(block)
    scribe.finish()


def _block(source: IO[bytes], shape: Shape, content: list[Any]) -> Block | None:
    first, laws, entries, (rows, columns) = content
    data = source.read(8 * rows * columns)
    if len(data) < 8 * rows * columns:
        return None
    return Block(shape, first, np.frombuffer(data).reshape(rows, columns), laws, entries)


def _receive(source: IO[bytes]) -> Any:
    head = source.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    length = LENGTH.unpack(head)[0]
    data = source.read(length)
    return pickle.loads(data) if len(data) == length else None


def _tell(**what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()
