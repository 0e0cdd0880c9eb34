"""Look at a device many times a second, in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

from trocar.apps.teleoperation.drive import Drive

#: Source: our own choice, twice as often as hands tremble. [s]
PERIOD_S = 0.01


class Source(Protocol):
    """A device that this machine reads itself; used in one thread."""

    def open(self) -> None:
        """Take hold of the device."""
        ...

    def look(self) -> Drive | None:
        """Return what it asks for now, None while it is not there."""
        ...

    def close(self) -> None:
        """Let go of it."""
        ...


class Poll:
    """Ask a source again and again and hand on what it says.

    While the device is not there nothing is said: who listens notices the silence.
    """

    def __init__(self, source: Source, hear: Callable[[Drive], object]) -> None:
        self._source, self._hear = source, hear
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="trocar-device", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, and wait for it."""
        self._over.set()
        self._thread.join(1.0)

    def _run(self) -> None:
        self._source.open()
        try:
            while not self._over.wait(PERIOD_S):
                drive = self._source.look()
                if drive is not None:
                    self._hear(drive)
        finally:
            self._source.close()
