"""Who writes while the simulation goes on: a process for a file, a thread for an open stream.

A thread shares Python's interpreter with the simulation and takes a tenth of its time; a process
of its own takes what copying the rows through a pipe costs.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import pickle
import queue
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.journal import Entry
from trocar.simulation.recording.extras import Extra
from trocar.simulation.recording.sampler import Block, Buffer, Shape
from trocar.simulation.recording.scribe import Scribe

if sys.platform == "linux":
    import fcntl

Array = NDArray[np.float64]
Recycle = Callable[[Buffer], None]

_log = logging.getLogger("trocar")

CHILD = "from trocar.simulation.recording.child import main; main()"
LENGTH = struct.Struct("<Q")
#: Blocks and other messages that may wait. Source: our own choice: two seconds of two cameras.
MOST_WAITING = 256
#: A block of the largest rig fits. Source: what Linux lets every user have.
PIPE_BYTES = 1 << 20


class Writer:
    """Takes blocks in their order and hands their buffers back; a thread does the work.

    Attributes:
        recycle: gets buffers back
        failure: why nothing more is written, "" while all is well
    """

    def __init__(self, label: str) -> None:
        self.recycle: Recycle = lambda _: None
        self.failure = ""
        self._label = label
        self._error: Exception | None = None
        self._queue: queue.SimpleQueue[tuple[Block, Buffer] | Extra | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._main, name="trocar-recording", daemon=True)

    def take(self, block: Block, buffer: Buffer) -> None:
        """Queue a block."""
        self._queue.put((block, buffer))

    def add(self, extra: Extra) -> bool:
        """Queue a message of somebody else; return False where too much waits already."""
        if self._queue.qsize() >= MOST_WAITING:
            return False
        self._queue.put(extra)
        return True

    def close(self) -> None:
        """Write what is queued and the summary, and close the file.

        Raises:
            Exception: what stopped the thread and was nobody's disk
        """
        self._queue.put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error

    @property
    def size(self) -> int:
        """Bytes written so far."""
        raise NotImplementedError

    def _main(self) -> None:
        while (item := self._queue.get()) is not None:
            try:
                if self.failure:
                    continue
                if isinstance(item, Extra):
                    self._write_extra(item)
                else:
                    self._write(item[0])
            except Exception as error:  # noqa: BLE001  handed over whole to whoever closes
                self._error = error
                self._give_up(repr(error))
            finally:
                if not isinstance(item, Extra):
                    self.recycle(item[1])
        self._finish()

    def _write(self, block: Block) -> None:
        raise NotImplementedError

    def _write_extra(self, extra: Extra) -> None:
        raise NotImplementedError

    def _finish(self) -> None:
        raise NotImplementedError

    def _give_up(self, why: str) -> None:
        if self.failure:
            return
        self.failure = why
        _log.warning(
            "%s: cannot be written any further: %s; the simulation goes on unrecorded, and what was"
            " written until then can be read",
            self._label,
            why,
        )


class ThreadWriter(Writer):
    """Writes to a stream that is open already; it is closed at the end."""

    def __init__(
        self, stream: IO[bytes], label: str, about: dict[str, str], start: float, timestep: float
    ) -> None:
        super().__init__(label)
        self._scribe = Scribe(stream, about, start, timestep, self._give_up)
        self._thread.start()

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._scribe.size

    def past(self, entries: Sequence[Entry]) -> None:
        """Write the commands that came before the first row; called before any block is."""
        self._scribe.past(entries)

    def _write(self, block: Block) -> None:
        self._scribe.write(block)

    def _write_extra(self, extra: Extra) -> None:
        self._scribe.add(extra)

    def _finish(self) -> None:
        self._scribe.finish()


class ProcessWriter(Writer):
    """Writes to a path, in a process of its own.

    Raises:
        FileExistsError: the file exists and is not to be replaced
        OSError: the file cannot be opened, or the process did not start
    """

    def __init__(
        self,
        path: Path,
        about: dict[str, str],
        start: float,
        timestep: float,
        *,
        overwrite: bool,
    ) -> None:
        super().__init__(str(path))
        device = path.exists() and not path.is_file()  # nothing is lost there
        path.open("wb" if overwrite or device else "xb").close()
        self._path = path
        self._shape: Shape | None = None
        self._child = subprocess.Popen(
            [sys.executable, "-c", CHILD],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            start_new_session=True,  # an interrupt from the keyboard is for the simulation
        )
        self._widen()
        self._send(("begin", str(path), about, start, timestep))
        if not self._answer().get("ready"):
            raise OSError(f"the process that writes it ended with status {self._child.wait()}")
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        self._thread.start()

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._path.stat().st_size

    def past(self, entries: Sequence[Entry]) -> None:
        """Write the commands that came before the first row; called before any block is."""
        self._send(("past", tuple(entries)))

    def _write(self, block: Block) -> None:
        try:
            self._hand_on(block)
        except OSError:  # the disk's errors come back as answers; this is the pipe's
            self._give_up("the process that writes it has ended")

    def _write_extra(self, extra: Extra) -> None:
        try:
            self._send(("extra", extra))
        except OSError:
            self._give_up("the process that writes it has ended")

    def _hand_on(self, block: Block) -> None:
        if block.shape is not self._shape:
            self._shape = block.shape
            self._send(("shape", block.shape))
        told = block.inputs
        shapes = block.rows.shape, told.ctrl.shape
        about = block.first, block.times, block.laws, block.entries, told.first, shapes
        # Few long writes: whatever the interpreter does here, it does not do for the simulation.
        self._send(("block", *about), block.rows.data, told.ctrl.data)

    def _finish(self) -> None:
        with contextlib.suppress(OSError):  # a process that is gone is told of below
            self._pipe().close()
        self._listener.join()
        if self._child.stdout is not None:
            self._child.stdout.close()
        status = self._child.wait()
        if status:
            self._give_up(f"the process that writes it ended with status {status}")

    def _send(self, message: object, *numbers: memoryview) -> None:
        data = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
        pipe = self._pipe()
        for part in (memoryview(LENGTH.pack(len(data)) + data), *numbers):
            left = part.cast("B")
            while left:
                left = left[pipe.write(left) :]

    def _widen(self) -> None:
        """Let the pipe take a whole block at once, where the system can."""
        if sys.platform == "linux":
            with contextlib.suppress(OSError):  # more than this user may have; slower, no worse
                fcntl.fcntl(self._pipe().fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    def _pipe(self) -> IO[bytes]:
        assert self._child.stdin is not None  # noqa: S101  it was asked for
        return self._child.stdin

    def _answer(self) -> dict[str, Any]:
        assert self._child.stdout is not None  # noqa: S101  it was asked for
        line = self._child.stdout.readline()
        return json.loads(line) if line else {}

    def _listen(self) -> None:
        while answer := self._answer():
            self._give_up(str(answer["failure"]))
