"""Who listens to what; the SDK's threads tell it."""

from __future__ import annotations

import threading
from typing import Protocol


class Client(Protocol):
    """A client, as the SDK has it."""

    id: int


class Channel(Protocol):
    """A channel, as the SDK shows it."""

    topic: str


class Listener:
    """Keep who listens to what.

    Attributes:
        wanted: the names of the topics that somebody listens to, without a leading slash
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listening: set[tuple[int, str]] = set()
        self._new: list[str] = []
        self.wanted: frozenset[str] = frozenset()

    def on_subscribe(self, client: Client, channel: Channel) -> None:
        """Note one more; called by the SDK."""
        name = channel.topic.removeprefix("/")
        with self._lock:
            self._listening.add((client.id, name))
            self.wanted |= {name}
            self._new.append(name)

    def on_unsubscribe(self, client: Client, channel: Channel) -> None:
        """Forget one, also where a client has gone; called by the SDK."""
        with self._lock:
            self._listening.discard((client.id, channel.topic.removeprefix("/")))
            self.wanted = frozenset(name for _, name in self._listening)

    def newly(self) -> list[str]:
        """Return the topics that somebody came to since this was asked last."""
        if not self._new:
            return []
        with self._lock:
            new, self._new = self._new, []
        return list(dict.fromkeys(new))
