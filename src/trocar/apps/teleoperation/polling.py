"""Look at a device many times a second, in a thread of its own."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Protocol

from trocar.apps.teleoperation.drive import Drive

#: Source: our own choice, twice as often as hands tremble. [s]
PERIOD_S = 0.01
#: A device that is not there is looked for so often: listing devices takes a system's time. Source:
#: our own choice: hardly longer than somebody waits who plugs one in. [s]
RETRY_S = 1.0

_log = logging.getLogger("trocar")


class Source(Protocol):
    """A device that this machine reads itself; used in one thread."""

    def open(self) -> None:
        """Take hold of the device.

        Raises:
            OSError: it is there and cannot be used
        """
        ...

    def look(self) -> Drive | None:
        """Return what it asks for now, None while it is not there.

        Raises:
            OSError: it is there and cannot be used
        """
        ...

    def close(self) -> None:
        """Let go of it."""
        ...


class Poll:
    """Ask a source again and again and hand on what it says.

    While the device is not there nothing is said: who listens notices the silence. One that is
    there and cannot be used is told of once, until it was heard again.
    """

    def __init__(self, source: Source, hear: Callable[[Drive], object]) -> None:
        self._source, self._hear = source, hear
        self._over = threading.Event()
        self._opened = self._warned = False
        self._thread = threading.Thread(target=self._run, name="trocar-device", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, and wait for it."""
        self._over.set()
        self._thread.join(1.0)

    def _run(self) -> None:
        pause = PERIOD_S
        try:
            while not self._over.wait(pause):
                drive = self._look()
                pause = RETRY_S if drive is None else PERIOD_S
                if drive is not None:
                    self._hear(drive)
        finally:
            self._source.close()

    def _look(self) -> Drive | None:
        try:
            if not self._opened:
                self._source.open()
                self._opened = True
            drive = self._source.look()
        except OSError as problem:
            if not self._warned:
                _log.warning("the device cannot be used: %s; it is tried again", problem)
            self._warned, self._opened = True, False
            self._source.close()
            return None
        self._warned = self._warned and drive is None
        return drive
