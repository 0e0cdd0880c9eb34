"""Copies the physics state in every period, a block of rows at a time."""

from __future__ import annotations

import queue
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.simulation.journal import Entry
from trocar.simulation.recording.frames import Tips, tips_of
from trocar.simulation.recording.layout import STATE, Inputs, Layout, layout_of
from trocar.simulation.state_view import StateView

if TYPE_CHECKING:
    from trocar.simulation.world import World

Array = NDArray[np.float64]

#: Simulated time of a block [s]. One block fills while the one before is written: what a killed
#: process loses is less than two. Source: our own choice.
BLOCK_S = 0.4
BUFFERS = 2
#: Commands after which poses are told in another frame.
MOVES_BASES = ("set_base_frame", "set_reference_arm")


@dataclass(frozen=True, eq=False)
class Shape:
    """What rows mean until the model changes.

    Attributes:
        number: counts from 0
        model: whose state the rows are
        layout: which numbers are which joint
        tips: where the tips are
    """

    number: int
    model: mujoco.MjModel
    layout: Layout
    tips: Tips


@dataclass(frozen=True, eq=False)
class Block:
    """Rows of the state that follow one another, and what happened meanwhile.

    Attributes:
        shape: what the rows mean
        first: number of the first row since the recording began
        times: simulation time after each period, (k,) [s]
        rows: physics state there, (k, size); valid until its buffer is recycled
        inputs: what the servos were told meanwhile; valid as long as the rows
        laws: (row, how the servos act from there on), rows rising
        entries: (row that the entry came before, entry)
    """

    shape: Shape
    first: int
    times: Array
    rows: Array
    inputs: Inputs
    laws: tuple[tuple[int, Array], ...]
    entries: tuple[tuple[int, Entry], ...]


class Buffer:
    """Room for a block's rows, and for as many inputs as there may be beside them.

    Attributes:
        sizes: numbers of a state and of a set of inputs
        rows: the states, (k, sizes[0])
        inputs: (k, sizes[1])
    """

    def __init__(self, count: int, sizes: tuple[int, int]) -> None:
        self.sizes = sizes
        self.rows, self.inputs = (np.zeros((count, size)) for size in sizes)


class Sink(Protocol):
    """Takes blocks, in their order."""

    def take(self, block: Block, buffer: Buffer) -> None:
        """Take a block; hand `buffer` to `Sampler.recycle` when its rows are no longer needed."""
        ...


class Sampler:
    """Stands between a world and mj_step, and hands on what it sees.

    Args:
        world: is sampled from `start` to `stop`
        sink: gets the blocks
    """

    def __init__(self, world: World, sink: Sink) -> None:
        self._world, self._sink = world, sink
        self._block = max(1, round(BLOCK_S / world.timestep))
        self._free: queue.SimpleQueue[Buffer] = queue.SimpleQueue()
        self._sizes = (0, 0)
        self._buffer = Buffer(0, self._sizes)
        self._state = np.zeros(0)
        self._times: list[float] = []
        self._starts: list[int] = []
        self._filled = 0
        self._shape: Shape | None = None
        self._stale = True
        self._entries: list[tuple[int, Entry]] = []
        self._laws: list[tuple[int, Array]] = []
        self._revision = -1
        #: Rows so far, those of the block in work included.
        self.count = 0

    def start(self) -> None:
        """Take the state as it is for the first row, and every period's from now on."""
        self._deaf = self._world.listen(self._hear)
        self._reshape()
        data = self._world._data
        self._starts.append(0)
        self._buffer.inputs[0] = data.ctrl
        self._times.append(data.time)
        self._buffer.rows[0] = self._state
        self._filled = self.count = 1
        self._world._mj_step = self.step

    def stop(self) -> None:
        """Let go of the world and hand on what is left."""
        self._world._mj_step = mujoco.mj_step
        self._deaf()
        self._hand_over(last=True)

    def step(self, model: mujoco.MjModel, data: mujoco.MjData, count: int) -> None:
        """Step some periods and copy the state after each."""
        if self._stale or self._shape is None or model is not self._shape.model:
            self._reshape()
        if self._world._servos.revision != self._revision:
            self._see_laws()
        one, state = mujoco.mj_step, self._state
        left = count
        while left > 0:
            begin, rows, keep_time = self._filled, self._buffer.rows, self._times.append
            run = min(left, self._block - begin)
            del self._times[begin:]  # of periods that an interrupt broke off
            self._buffer.inputs[len(self._starts)] = data.ctrl
            self._starts.append(begin)
            for row in range(begin, begin + run):  # by number: a thousand views cost cache
                one(model, data)
                rows[row] = state
                keep_time(data.time)
            self._filled += run
            self.count += run
            left -= run
            if self._filled == self._block:
                self._hand_over()

    def recycle(self, buffer: Buffer) -> None:
        """Take back the rows of a block, unless rows have another size by now."""
        if buffer.sizes == self._sizes:
            self._free.put(buffer)

    def _hear(self, entry: Entry) -> None:
        self._entries.append((self.count, entry))
        if entry.name in MOVES_BASES:
            self._stale = True  # from the next period on: the command is about to act

    def _see_laws(self) -> None:
        """Note how the servos act from the next row on."""
        self._revision = self._world._servos.revision
        if self._laws and self._laws[-1][0] == self._filled:
            self._laws.pop()
        self._laws.append((self._filled, self._law()))

    def _law(self) -> Array:
        live = [d.law() for d in self._world._drives.values() if not d.welded]
        return np.concatenate(live) if live else np.zeros((0, 4))

    def _reshape(self) -> None:
        """Begin with a model, or with another one."""
        if self._filled:
            self._hand_over()
        world = self._world
        number = 0 if self._shape is None else self._shape.number + 1
        welded = {
            name: world.arms[name].positions() for name, d in world._drives.items() if d.welded
        }
        bases = {name: arm.base_frame() for name, arm in world.arms.items()}
        chosen = [name for name, arm in world.arms.items() if arm._base is not None]
        state = StateView(world._data, STATE)
        layout = layout_of(state, world.rig, world._drives, welded, world.objects)
        tips = tips_of(world.rig, world._drives, bases, chosen)
        self._shape, self._state = Shape(number, world._model, layout, tips), state.values
        self._stale = False
        sizes = (layout.size, world._model.nu)
        if sizes != self._sizes:
            self._make_buffers(sizes)
        self._laws.clear()
        self._see_laws()

    def _make_buffers(self, sizes: tuple[int, int]) -> None:
        self._sizes, self._free = sizes, queue.SimpleQueue()
        for _ in range(BUFFERS):
            self._free.put(Buffer(self._block, sizes))
        self._buffer = self._free.get()

    def _hand_over(self, last: bool = False) -> None:
        """Give the block away and go on with the other buffer, once that is free."""
        if self._shape is None:
            return
        buffer = self._buffer
        if self._filled or self._entries:
            told = Inputs(np.array(self._starts, np.intp), buffer.inputs[: len(self._starts)])
            block = Block(
                self._shape,
                self.count - self._filled,
                np.array(self._times),
                buffer.rows[: self._filled],
                told,
                tuple(self._laws),
                tuple(self._entries),
            )
            self._entries = []
            self._sink.take(block, buffer)
            if not last:
                self._buffer = self._free.get()
        self._times, self._starts = [], []
        self._laws = [(0, self._laws[-1][1])]
        self._filled = 0
