"""The process that writes a recording: messages come in by a pipe, what goes wrong goes out."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.recording.layout import Inputs
from trocar.simulation.recording.sampler import Block, Shape
from trocar.simulation.recording.scribe import Scribe
from trocar.simulation.recording.writers import LENGTH

Array = NDArray[np.float64]


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
        elif kind == "extra":
            scribe.add(content[0])
        elif shape is not None:
            block = _block(source, shape, content)
            if block is None:
                break
            scribe.write(block)
    scribe.finish()


def _block(source: IO[bytes], shape: Shape, content: list[Any]) -> Block | None:
    first, times, laws, entries, starts, shapes = content
    rows, ctrl = (_numbers(source, size) for size in shapes)
    if rows is None or ctrl is None:
        return None
    return Block(shape, first, times, rows, Inputs(starts, ctrl), laws, entries)


def _numbers(source: IO[bytes], shape: tuple[int, int]) -> Array | None:
    count = 8 * shape[0] * shape[1]
    data = source.read(count)
    return np.frombuffer(data).reshape(shape) if len(data) == count else None


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
