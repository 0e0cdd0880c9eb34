"""Record a world into a file that standard tools open and `trocar replay` repeats."""

from __future__ import annotations

import atexit
import contextlib
import logging
import queue
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import IO, Self

import mujoco
import numpy as np

from trocar.errors import InputError, RecordingError
from trocar.outputs import locked_stream
from trocar.recording.layout import STATE, Rows, effective_gains, layout_of
from trocar.recording.mcap_file import Extra, McapFile, mcap_library
from trocar.recording.metadata import world_metadata
from trocar.simulation import World
from trocar.simulation.journal import Entry

_log = logging.getLogger("trocar")

#: Simulated time of the rows that are handed to the writing thread together [s].
#: Source: our own choice: 100 rows at 1 kHz.
BLOCK_S = 0.1
#: Blocks that may wait for the writing thread; the simulation waits for a slower one.
#: Source: our own choice.
MOST_BLOCKS = 4
#: Messages that may wait. Source: our own choice: two seconds of two cameras.
MOST_WAITING = 256
#: Commands that change the frame of an arm's poses.
MOVES_BASES = ("set_base_frame", "set_reference_arm", "reset", "load")

Entries = tuple[tuple[int, Entry], ...]


class StateSampler:
    """Observes a world: copies its state after every step, and hands on blocks of rows.

    Args:
        world: is sampled from now until `stop`; its present state is the first row
        take: gets rows, and (row that it came before, entry) of each command and event
    """

    def __init__(self, world: World, take: Callable[[Rows, Entries], None]) -> None:
        self._world, self._take = world, take
        self._block = max(1, round(BLOCK_S / world.timestep))
        self._entries: list[tuple[int, Entry]] = []
        self._filled = 0
        #: Rows so far.
        self.count = 0
        #: The meaning of the rows as they are now.
        self.layout = layout_of(world, 0)
        self._new_base = False
        self._gains = effective_gains(world)
        self._revision: int = world.servos.revision
        self._new_block()
        self._stops = world.listen(self._note), world.observe(self._sample)
        self._sample()

    def stop(self) -> None:
        """Leave the world and hand on the last rows."""
        for stop in self._stops:
            stop()
        self._hand_over()

    def _note(self, entry: Entry) -> None:
        self._entries.append((self.count, entry))
        if entry.name in MOVES_BASES:
            self._new_base = True

    def _sample(self) -> None:
        world = self._world
        if self._new_base or world.mj_model is not self.layout.model:
            self._hand_over()
            self._new_base = False
            self.layout = layout_of(world, self.layout.number + 1)
            self._gains, self._revision = effective_gains(world), world.servos.revision
            self._new_block()
        elif world.servos.revision != self._revision:
            self._revision, gains = world.servos.revision, effective_gains(world)
            if not np.array_equal(gains, self._gains):
                self._hand_over()
                self._gains = gains
        row = self._rows[self._filled]
        mujoco.mj_getState(world.mj_model, world.mj_data, row, STATE)
        if world.servos.errors is not None:
            world.servos.report(row[1:])
        self._filled += 1
        self.count += 1
        if self._filled == self._block:
            self._hand_over()

    def _new_block(self) -> None:
        """Allocate rows; those handed over belong to the other thread."""
        size = mujoco.mj_stateSize(self.layout.model, STATE)
        self._states = np.empty((self._block, size))
        self._rows = list(self._states)  # an index into an array takes longer (measured)

    def _hand_over(self) -> None:
        if not self._filled and not self._entries:
            return
        states, self._filled = self._states[: self._filled], 0
        entries, self._entries = tuple(self._entries), []
        self._new_block()
        self._take(Rows(self.layout, self._gains, self.count - len(states), states), entries)


class Recorder:
    """Records a world from when it is made until `stop`, or for a `with` block; see `record`.

    After the recording has failed, as on a full disk, the world's `step` and `stop` raise a
    RecordingError: a run that should be recorded does not go on unrecorded.

    Attributes:
        file: the file's name
        failure: why the file could not be written to its end; "" while all is well
        left_out: messages of other sources that were left out
    """

    def __init__(
        self, world: World, file: str | Path | IO[bytes], *, overwrite: bool = False
    ) -> None:
        mcap_library("recording")
        self.file = (
            str(file)
            if isinstance(file, str | Path)
            else str(getattr(file, "name", "the recording"))
        )
        other = recorder_of(world)
        if other is not None:
            raise InputError(f"{self.file}: the world is recorded into {other.file} now")
        stream = locked_stream(file, overwrite) if isinstance(file, str | Path) else file
        past = () if world.past.incomplete else tuple(world.past.entries)
        try:
            self._mcap = McapFile(stream, world_metadata(world), past)
        except OSError as error:
            with contextlib.suppress(OSError):
                stream.close()
            if isinstance(file, str | Path) and Path(file).is_file():
                Path(file).unlink()  # this call made or emptied it
            reason = error.strerror or str(error)
            raise InputError(f"{self.file}: cannot be written: {reason}") from error
        self.failure = ""
        self.left_out = 0
        self._world, self._stopped = world, False
        self._error: Exception | None = None
        self._room = threading.Semaphore(MOST_BLOCKS)
        self._queue: queue.SimpleQueue[tuple[Rows, Entries] | Extra | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="trocar-recording", daemon=True)
        self._thread.start()
        self._sampler = StateSampler(world, self._take)
        world.recorder = self
        atexit.register(self._stop_at_exit)

    @property
    def rows(self) -> int:
        """Physics steps recorded so far, the state at the beginning included."""
        return self._sampler.count

    def add(self, extra: Extra) -> bool:
        """Write a message of another source, from any thread.

        Returns:
            False where the recording has ended or cannot follow: the message is left out
        """
        left_out = self._stopped or self._queue.qsize() >= MOST_WAITING
        if left_out:
            self.left_out += 1
        else:
            self._queue.put(extra)
        return not left_out

    def stop(self) -> None:
        """End the recording and close the file; a second time nothing happens.

        Raises:
            RecordingError: the file ends before the recording does
        """
        if self._stopped:
            return
        self._stopped = True
        atexit.unregister(self._stop_at_exit)
        self._world.recorder = None
        self._sampler.stop()
        self._queue.put(None)
        self._thread.join()
        if self.failure:
            raise self._failed() from self._error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.stop()
        except RecordingError:
            if error is None:
                raise

    def _take(self, rows: Rows, entries: Entries) -> None:
        if self.failure and not self._stopped:
            raise self._failed() from self._error
        self._room.acquire()
        self._queue.put((rows, entries))

    def _write(self) -> None:
        """Write in a thread until the recording stops; after a failure, only empty the queue."""
        while True:
            item = self._queue.get()
            try:
                if self.failure:
                    pass
                elif item is None:
                    self._mcap.finish()
                elif isinstance(item, Extra):
                    self._mcap.add(item)
                else:
                    self._mcap.write(*item)
            except Exception as error:  # noqa: BLE001  raised in the thread that steps the world
                self._error = error
                self._mcap.cut_off()
                known = isinstance(error, OSError) and error.strerror
                self.failure = str(known or repr(error))
            if item is None:
                return
            if isinstance(item, tuple):
                self._room.release()

    def _failed(self) -> RecordingError:
        return RecordingError(self.file, self._mcap.until, self.failure)

    def _stop_at_exit(self) -> None:
        try:
            self.stop()
        except RecordingError as error:
            _log.error("%s", error)


def recorder_of(world: World) -> Recorder | None:
    """Return the recorder of a world that is recorded now, else None."""
    return world.recorder if isinstance(world.recorder, Recorder) else None


def record(world: World, file: str | Path | IO[bytes], *, overwrite: bool = False) -> Recorder:
    """Record states, commands and events of a world into an MCAP file, from now on.

    `with record(world, "run.mcap"): ...`, or keep the recorder and call its `stop`.

    Args:
        world: is recorded; motion does not depend on it
        file: a path, or a binary file that is open for writing; it is closed at the end
        overwrite: replace a file that exists

    Raises:
        InputError: the file exists, is a symbolic link, or cannot be written, or the world is
            recorded already
        MissingExtraError: the library for MCAP is not installed
    """
    return Recorder(world, file, overwrite=overwrite)
