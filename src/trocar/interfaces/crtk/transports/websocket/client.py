"""One connected client: what it wants, what waits for it, and how much it sends."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

from websockets.asyncio.server import ServerConnection
from websockets.protocol import State

from trocar.interfaces.crtk.transports.websocket.flow import Bucket, Outbox, Throttle
from trocar.interfaces.crtk.transports.websocket.parcel import Parcel
from trocar.interfaces.crtk.transports.websocket.replies import status
from trocar.interfaces.crtk.transports.websocket.requests import Id, Level, Subscribe

MOST_BUFFERED = 256 * 1024
"""Bytes that the system has not taken yet before messages wait in the outbox.

Source: our own choice, about 0.1 s of everything that the full cart tells at 220 Hz.
"""

SEND_BUFFER = 256 * 1024
"""Bytes that the system keeps for a client that is slow: what it has not read cannot grow old.

Source: our own choice. Left alone, Linux keeps 4 MB, two seconds of everything.
"""

MOST_WAITING = 256
"""Events and answers that wait for a slow client. Source: our own choice."""

MOST_SUBSCRIPTIONS = 1024
"""Topics that a client may want. Source: our own choice, three times those of the full cart."""

MESSAGES_PER_S = 5000.0
"""Messages that a client may send in the long run, and at once.

Source: our own choice: five arms driven at 1 kHz.
"""

BYTES_PER_S = 8e6
"""Bytes that a client may send in the long run, and at once. Source: our own choice."""

TOLD_EVERY_S = 1.0
"""Shortest time between two complaints of one kind to one client [s]."""

LEVELS: tuple[Level, ...] = ("none", "error", "warning", "info")
"""Each wants all before it, too."""


@dataclass
class Subscription:
    """What a client wants of one topic, all its requests together.

    Args:
        name: the topic as the client spells it
        throttles: shortest time between two messages of each request [s]
    """

    name: str
    throttles: dict[Id, float] = field(default_factory=dict)
    throttle: Throttle | None = None
    held: Parcel | None = None

    def settle(self) -> None:
        """Obey the request that wants the most."""
        period = min(self.throttles.values())
        if period <= 0.0:
            self.throttle = None
        elif self.throttle is None or self.throttle.period_s != period:
            self.throttle = Throttle(period)


class Client:
    """One connection, touched in the server's own thread only."""

    def __init__(self, connection: ServerConnection) -> None:
        self._connection = connection
        wire: socket.socket = connection.transport.get_extra_info("socket")
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self.peer = "{}:{}".format(*connection.remote_address[:2])
        self.subscriptions: dict[str, Subscription] = {}
        self.changes = 0
        self.calls = 0
        self.level: Level = "warning"
        self.refused = 0
        self._messages = Bucket(MESSAGES_PER_S, MESSAGES_PER_S)
        self._bytes = Bucket(BYTES_PER_S, BYTES_PER_S)
        self._outbox = Outbox(MOST_WAITING)
        self._told: dict[str, float] = {}

    def may_send(self, size: int) -> bool:
        """Whether a message of so many bytes is within the client's rates; count it if not."""
        now = time.monotonic()
        allowed = self._messages.take(1.0, now) and self._bytes.take(float(size), now)
        self.refused += not allowed
        return allowed

    def subscribe(self, topic: str, request: Subscribe) -> bool:
        """Note what is wanted; return False when it is too much."""
        if topic not in self.subscriptions and len(self.subscriptions) >= MOST_SUBSCRIPTIONS:
            return False
        wanted = self.subscriptions.setdefault(topic, Subscription(request.topic))
        if len(wanted.throttles) >= MOST_SUBSCRIPTIONS and request.id not in wanted.throttles:
            return False
        self.changes += 1
        wanted.name = request.topic
        wanted.throttles[request.id] = request.throttle_s
        wanted.settle()
        return True

    def unsubscribe(self, topic: str, id: Id) -> None:  # noqa: A002  the protocol's word
        """Forget one request, or all to the topic when no id is given."""
        wanted = self.subscriptions.get(topic)
        if wanted is None:
            return
        self.changes += 1
        if id is not None:
            wanted.throttles.pop(id, None)
        if id is None or not wanted.throttles:
            del self.subscriptions[topic]
        else:
            wanted.settle()

    def deliver(self, parcels: Iterable[Parcel], now: float) -> None:
        """Send what the client wants of a batch, in one write."""
        ready: list[tuple[Parcel, str]] = []
        for parcel in parcels:
            wanted = self.subscriptions.get(parcel.topic.name)
            if wanted is None:
                continue
            if wanted.throttle is None or wanted.throttle.passes(now):
                wanted.held = None
                ready.append((parcel, wanted.name))
            else:
                wanted.held = parcel
        if ready:
            self._send(ready)

    def send(self, frame: bytes) -> None:
        """Send one answer, or let it wait its turn."""
        if self._open and not self._outbox and self._room > 0:
            self._connection.transport.write(frame)
        else:
            self._outbox.put(frame)

    def tell(self, level: Level, text: str, id: Id = None) -> None:  # noqa: A002
        """Send a remark, if the client wants that kind."""
        if LEVELS.index(level) <= LEVELS.index(self.level):
            self.send(status(level, text, id))

    def tell_now_and_then(self, kind: str, text: str) -> bool:
        """Send a warning unless one of its kind was sent a moment ago; return whether it was."""
        now = time.monotonic()
        if now < self._told.get(kind, 0.0) + TOLD_EVERY_S:
            return False
        self._told[kind] = now
        self.tell("warning", text)
        return True

    def tend(self, now: float) -> None:
        """Send what waited long enough, and complain about what did not fit."""
        due = [w for w in self.subscriptions.values() if w.held and w.throttle]
        for wanted in due:
            if wanted.held and wanted.throttle and wanted.throttle.passes(now):
                parcel, wanted.held = wanted.held, None
                self._send([(parcel, wanted.name)])
        while self._outbox and self._open and self._room > 0:
            self._connection.transport.write(b"".join(self._outbox.take(self._room)))
        if self._outbox.lost and self.tell_now_and_then(
            "slow", f"you read too slowly: {self._outbox.lost} messages were left out"
        ):
            self._outbox.lost = 0

    @property
    def _open(self) -> bool:
        return self._connection.state is State.OPEN

    @property
    def _room(self) -> int:
        return MOST_BUFFERED - self._connection.transport.get_write_buffer_size()

    def _send(self, parcels: list[tuple[Parcel, str]]) -> None:
        if self._open and not self._outbox and self._room > 0:
            self._connection.transport.write(b"".join([p.frame(name) for p, name in parcels]))
            return
        for parcel, name in parcels:
            if parcel.replaceable:
                self._outbox.put_state(parcel.topic.name, parcel.frame(name))
            else:
                self._outbox.put(parcel.frame(name))
