"""The transport to a script in this process: its publishers, its subscribers, what they connect."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from trocar.interfaces.crtk.scripts.message_classes import Message, fields_of, message_of
from trocar.interfaces.crtk.topics import Topic
from trocar.interfaces.crtk.transport import Batch

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core

_log = logging.getLogger("trocar")

#: Who the core says that a refused message came from.
PEER = "the script"
Call = Callable[[Callable[[], None]], None]


class Listener:
    """A subscription.

    Args:
        name: of the topic, without the first slash
        kind: class of the messages
        heard: called with each message
        size: how many messages may wait; the oldest are lost beyond
        at_once: called in the publishing thread, where the simulation waits for it
    """

    def __init__(
        self,
        name: str,
        kind: type[Message],
        heard: Callable[[Any], None],
        size: int | None = None,
        at_once: bool = False,
    ) -> None:
        self.name, self.kind, self.at_once = name, kind, at_once
        self._heard = heard
        self._waiting: deque[Any] = deque(maxlen=size or None)
        self._busy = False

    def put(self, message: Any, later: Call) -> None:
        """Have the function called with a message, once those before are done with."""
        if self.at_once:
            self._heard(message)
            return
        self._waiting.append(message)
        if not self._busy:
            self._busy = True
            later(self._work)

    def _work(self) -> None:
        try:
            while self._waiting:
                self._heard(self._waiting.popleft())
        finally:
            self._busy = False


class Bus:
    """Carries messages between the core and a script, and from the script to itself.

    Args:
        later: has a function called where the script's functions may be called

    Attributes:
        posted: whether something was published that the simulation has not obeyed yet
    """

    name = "script"
    packing = None

    def __init__(self, later: Call) -> None:
        self._later = later
        self._lock = threading.Lock()
        self._listeners: dict[str, tuple[Listener, ...]] = {}
        self._speakers: dict[str, int] = {}
        self._wanted: frozenset[str] = frozenset()
        self.posted = False

    def start(self, core: Core) -> None:
        """Begin."""
        self._core = core

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that the script subscribes to."""
        return self._wanted

    def send(self, batch: Batch) -> None:
        """Hand messages on: events first, as they came, then states by name."""
        events = [pair for pair in batch if pair[0].rate == "event"]
        states = sorted((p for p in batch if p[0].rate != "event"), key=lambda pair: pair[0].name)
        for topic, message in (*events, *states):
            self._tell(topic.name, message)

    def close(self) -> None:
        """End."""
        self._listeners = {}

    # ------------------------------------------------------------------ what the script calls

    def subscribe(self, listener: Listener) -> None:
        """Listen to a topic; one that is latched tells its last message."""
        with self._lock:
            before = self._listeners.get(listener.name, ())
            self._listeners[listener.name] = (*before, listener)
            self._count()
        topic = self._served(listener.name, listener.kind, "pub")
        last = self._core.latched(listener.name) if topic is not None and topic.latched else None
        if last is not None:
            listener.put(message_of(listener.kind, last), self._later)

    def unsubscribe(self, listener: Listener) -> None:
        """Listen no longer."""
        with self._lock:
            left = tuple(x for x in self._listeners.get(listener.name, ()) if x is not listener)
            self._listeners[listener.name] = left
            self._count()

    def advertise(self, name: str, kind: type[Message]) -> None:
        """Note that the script may publish to a topic."""
        self._speakers[name] = self._speakers.get(name, 0) + 1
        self._served(name, kind, "sub")

    def publish(self, name: str, message: Message) -> None:
        """Publish a message of the script's."""
        fields = fields_of(message)
        if self._served(name, type(message), "sub", complain=False) is not None:
            self.posted |= self._core.receive(name, fields, PEER)
        for listener in self._listeners.get(name, ()):
            if listener.kind is type(message):
                listener.put(message_of(listener.kind, fields), self._later)

    def heard(self, name: str, kind: type[Message]) -> int:
        """Count who listens to what the script publishes."""
        own = len(self._listeners.get(name, ()))
        return own + (self._served(name, kind, "sub", complain=False) is not None)

    def told(self, name: str, kind: type[Message]) -> int:
        """Count who publishes what the script listens to."""
        own = self._speakers.get(name, 0)
        return own + (self._served(name, kind, "pub", complain=False) is not None)

    # ------------------------------------------------------------------ inside

    def _count(self) -> None:
        self._wanted = frozenset(name for name, found in self._listeners.items() if found)

    def _tell(self, name: str, fields: dict[str, Any]) -> None:
        for listener in self._listeners.get(name, ()):
            topic = self._core.topics[name]
            if listener.kind._type == topic.type:
                listener.put(message_of(listener.kind, fields), self._later)

    def _served(
        self, name: str, kind: type[Message], direction: str, *, complain: bool = True
    ) -> Topic | None:
        """Return the simulator's end of a topic, None where it has none of that type."""
        topic = self._core.topics.get(name)
        if topic is None or topic.later or topic.direction != direction:
            return None
        if topic.type == kind._type:
            return topic
        if complain:
            _log.warning("/%s is %s here; the script says %s", name, topic.type, kind._type)
        return None
