"""The connections of a WebSocket server: limited in number, closed without progress.

websockets' own keepalive waits until a client reads before it pings, so a client that never reads
stays for ever (websockets 16.1). Here every client is pinged, and every second its buffer is looked
at: a pong and a buffer that shrank are progress.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from functools import partial
from http import HTTPStatus
from typing import Any, cast

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Response
from websockets.protocol import State

from trocar.live.pace import LOG_PERIOD_S
from trocar.simulation.rate_limit import RateLimit, suffix

_log = logging.getLogger("trocar")

# Source: our own choice.
MOST_CLIENTS = 64
#: Connections that have sent no request yet, besides clients.
MOST_STRANGERS = 64
#: Period of the check of a client, and time between a pong and the next ping. [s]
LOOK_S = 1.0
#: A client without progress for so long gives way to a new one, where there is no other place. [s]
STALE_S = 3.0
#: A client without progress for so long is disconnected. [s]
GONE_S = 15.0
#: Bytes buffered per connection before its client counts as slow; the system buffers as many:
#: about 0.1 s of the full cart at 220 Hz; Linux's 4 MB are two seconds of it. [bytes]
MOST_BUFFERED = SEND_BUFFER = 256 * 1024
#: Larger messages end the connection. [bytes]
LARGEST_MESSAGE = 1_000_000


class Connections:
    """The connections of one server; touched in the server's own thread only.

    Args:
        server: name of the server in the log
    """

    def __init__(self, server: str) -> None:
        self._server = server
        self._strangers: dict[Connection, None] = {}
        self._clients: dict[Connection, None] = {}
        self._rate_limit = RateLimit(LOG_PERIOD_S)

    @property
    def options(self) -> dict[str, Any]:
        """Keyword arguments of websockets' `serve`."""
        return {
            "create_connection": partial(Connection, self),
            "compression": None,
            "max_size": LARGEST_MESSAGE,
            "ping_interval": None,
        }

    def arrive(self, connection: Connection) -> None:
        """Note a new connection; beyond MOST_STRANGERS without a request, the oldest is closed."""
        self._strangers[connection] = None
        if len(self._strangers) > MOST_STRANGERS:
            oldest = next(iter(self._strangers))
            del self._strangers[oldest]
            oldest.transport.abort()

    def admit(self, connection: ServerConnection) -> Response | None:
        """Let a connection become a client, or return the answer that there are too many."""
        if len(self._clients) >= MOST_CLIENTS:
            idlest = max(self._clients, key=lambda client: client.idle_s)
            if idlest.idle_s < STALE_S:
                return connection.respond(
                    HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_CLIENTS} clients are connected\n"
                )
            self.disconnect(idlest)
        client = cast(Connection, connection)
        self._strangers.pop(client, None)
        self._clients[client] = None
        return None

    def disconnect(self, idle: Connection) -> None:
        """Close a connection without progress; log a client's."""
        unsaid = None
        if idle in self._clients:
            unsaid = self._rate_limit.due("idle", idle.loop.time())
        if unsaid is not None:
            peer = "{}:{}".format(*idle.remote_address[:2])
            text = "%s: disconnected %s, which read nothing for %.0f s%s"
            _log.warning(text, self._server, peer, idle.idle_s, suffix(unsaid))
        self.leave(idle)
        idle.transport.abort()

    def leave(self, connection: Connection) -> None:
        """Forget a connection."""
        self._strangers.pop(connection, None)
        self._clients.pop(connection, None)


class Connection(ServerConnection):
    """A connection with the time of its client's last progress.

    Attributes:
        paused: whether so much is buffered that the client has to read first
    """

    def __init__(self, connections: Connections, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._connections = connections
        self._unread = 0
        self._progress_s = self.loop.time()
        self._ping = self._watch = None

    @property
    def idle_s(self) -> float:
        """Time since the client last answered a ping or read what is buffered [s]."""
        return self.loop.time() - self._progress_s

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Bound what is buffered, and begin to look after the client."""
        super().connection_made(transport)
        wire: socket.socket = self.transport.get_extra_info("socket")
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self.transport.set_write_buffer_limits(MOST_BUFFERED, MOST_BUFFERED // 2)
        self._connections.arrive(self)
        self._watch = self.loop.create_task(self._look_after())

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the client."""
        super().connection_lost(exc)
        self._connections.leave(self)
        if self._watch is not None:
            self._watch.cancel()

    def resume_writing(self) -> None:
        """Note that the client reads on."""
        super().resume_writing()
        self._progress_s = self.loop.time()

    async def _look_after(self) -> None:
        while True:
            looked_s = self.loop.time()
            await asyncio.sleep(LOOK_S)
            # While this process itself stood still no client could make progress.
            self._progress_s += max(0.0, self.loop.time() - looked_s - LOOK_S)
            unread = self.transport.get_write_buffer_size()
            if unread < self._unread:
                self._progress_s = self.loop.time()
            self._unread = unread
            if self.idle_s > GONE_S:
                self._connections.disconnect(self)
            elif self.state is State.OPEN and (self._ping is None or self._ping.done()):
                self._ping = self.loop.create_task(self._ask())

    async def _ask(self) -> None:
        """Ping the client and wait for its pong, which it sends once it has read all before."""
        with contextlib.suppress(ConnectionClosed):
            await (await self.ping())
            self._progress_s = self.loop.time()
