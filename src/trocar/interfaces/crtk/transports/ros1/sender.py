"""The thread that writes what the core publishes to its subscribers."""

from __future__ import annotations

import logging
import os
import select
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING

from trocar.interfaces.crtk.messages import MessageError

if TYPE_CHECKING:
    from trocar.interfaces.crtk.transport import Batch
    from trocar.interfaces.crtk.transports.ros1.outlets import Outlet

_log = logging.getLogger("trocar")

WAITING = 32
"""How many periods may wait to be written. Source: our own choice, a seventh of a second at
220 Hz; beyond it states are left out and events kept."""


class Sender:
    """Write batches to subscribers, in a thread of its own.

    Args:
        outlets: topics that are published, by name

    Attributes:
        dropped: how many messages were left out since somebody, or all, could not keep up
    """

    def __init__(self, outlets: Mapping[str, Outlet]) -> None:
        self._outlets = outlets
        self._batches: deque[Batch] = deque()
        self._bell, self._ring = os.pipe()
        for end in (self._bell, self._ring):
            os.set_blocking(end, False)
        self._stopping = False
        self._complained: set[str] = set()
        self._thread = threading.Thread(target=self._run, name="trocar-ros1", daemon=True)
        self.dropped = 0

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def put(self, batch: Batch) -> None:
        """Let a batch be written; returns at once."""
        if len(self._batches) >= WAITING:
            kept = [(topic, message) for topic, message in batch if topic.rate == "event"]
            self.dropped += len(batch) - len(kept)
            batch = kept
        if batch:
            self._batches.append(batch)
            self._wake()

    def close(self) -> None:
        """End; what waits is not written."""
        self._stopping = True
        self._wake()
        if self._thread.is_alive():
            self._thread.join()
        os.close(self._bell)
        os.close(self._ring)

    def _wake(self) -> None:
        with suppress(BlockingIOError):  # it rings already
            os.write(self._ring, b"\0")

    def _run(self) -> None:
        late: list[Outlet] = []
        while True:
            self._wait(late)
            if self._stopping:
                return
            for outlet in late:
                outlet.catch_up()
            while self._batches:
                self._write(self._batches.popleft())
            late = [outlet for outlet in self._outlets.values() if outlet.late]

    def _wait(self, late: list[Outlet]) -> None:
        """Wait for a batch, or for a subscriber that is late to take more."""
        poll = select.poll()
        poll.register(self._bell, select.POLLIN)
        for outlet in late:
            for descriptor in outlet.descriptors():
                poll.register(descriptor, select.POLLOUT)
        poll.poll()
        with suppress(BlockingIOError):
            os.read(self._bell, 4096)

    def _write(self, batch: Batch) -> None:
        for topic, message in batch:
            outlet = self._outlets.get(topic.name)
            if outlet is None:
                continue
            try:
                self.dropped += outlet.send(message)
            except MessageError as error:
                if topic.name not in self._complained:
                    self._complained.add(topic.name)
                    _log.warning("ROS 1: %s cannot be published: %s", topic.name, error)
