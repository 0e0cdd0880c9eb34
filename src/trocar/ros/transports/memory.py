"""A transport that keeps messages in lists, for tests."""

from __future__ import annotations

from collections.abc import Iterable

from trocar.ros.core import Batch, Core
from trocar.ros.topic import Message


class MemoryTransport:
    """Keep messages by topic.

    Args:
        wanted: names of the topics to subscribe to; None: all

    Attributes:
        received: {topic: its messages, oldest first}
        batches: how many batches came
    """

    name = "memory"

    def __init__(self, wanted: Iterable[str] | None = None) -> None:
        self._wanted = None if wanted is None else frozenset(wanted)
        self.received: dict[str, list[Message]] = {}
        self.batches = 0
        self.closed = False

    def start(self, core: Core) -> None:
        """Subscribe to these topics, by default to all."""
        if self._wanted is None:
            self._wanted = frozenset(core.topics)

    def want(self, *names: str) -> None:
        """Subscribe to these topics from now on, and no other."""
        self._wanted = frozenset(names)

    def wanted(self) -> frozenset[str]:
        """Return the names of the subscribed topics."""
        return self._wanted or frozenset()

    def send(self, batch: Batch) -> None:
        """Keep messages."""
        self.batches += 1
        for topic, message in batch:
            self.received.setdefault(topic.name, []).append(message)

    def last(self, name: str) -> Message:
        """Return the newest message of a topic."""
        return self.received[name][-1]

    def close(self) -> None:
        """End."""
        self.closed = True
