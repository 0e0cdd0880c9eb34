"""The server's own thread: an event loop that listens, hands messages out and takes them in.

asyncio turns Nagle's algorithm off on every TCP connection, so what is written leaves at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from typing import TYPE_CHECKING

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response

from trocar.errors import TrocarError
from trocar.interfaces.crtk.transports.websocket.client import Client
from trocar.interfaces.crtk.transports.websocket.conversation import Conversation
from trocar.interfaces.crtk.transports.websocket.door import Door
from trocar.interfaces.crtk.transports.websocket.parcel import Parcel

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core

MOST_CLIENTS = 64
"""Source: our own choice."""

MOST_STRANGERS = 64
"""Connections, beyond the clients', that have said nothing yet. Source: our own choice."""

LARGEST_MESSAGE = 1_000_000
"""Bytes of a message; a client that sends a larger one is disconnected. Source: our own choice."""

TEND_S = 0.01
"""Time between two looks at what clients have not taken yet [s]."""

PING_S, PONG_S, CLOSE_S, OPEN_S = 5.0, 10.0, 1.0, 5.0
"""A client is asked whether it lives, and has so long to answer, to say goodbye, to say hello [s].

Source: our own choice: a half-open connection is gone after 15 s.
"""

BREATH_S, BREATH_EVERY = 0.001, 16
"""Pause after so many messages beyond a client's rate, so that a flood costs little [s]."""

_log = logging.getLogger("trocar")


class Guarded(ServerConnection):
    """A connection that ends at once when too many others have said nothing yet."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin, or end."""
        super().connection_made(transport)
        if len(self.server.handlers) > MOST_CLIENTS + MOST_STRANGERS:
            self.transport.abort()


class Server:
    """Serve clients; everything but `wanted` belongs to the thread that runs it.

    Args:
        core: who takes messages and answers services
        door: who may come in
        workers: the threads in which services are waited for

    Attributes:
        wanted: names of the topics that some client wants now; any thread may read it
    """

    def __init__(self, core: Core, door: Door, workers: Executor) -> None:
        self._door = door
        self._conversation = Conversation(core, workers)
        self._clients: set[Client] = set()
        self._stopping = asyncio.Event()
        self.wanted: frozenset[str] = frozenset()

    async def run(self, port: int, ready: Callable[[int], None]) -> None:
        """Serve until stopped; `ready` is called with the port once clients may come.

        Raises:
            OSError: the host or the port cannot be listened on
        """
        async with serve(
            self._listen,
            self._door.host,
            port,
            create_connection=Guarded,
            process_request=self._admit,
            compression=None,
            max_size=LARGEST_MESSAGE,
            ping_interval=PING_S,
            ping_timeout=PONG_S,
            close_timeout=CLOSE_S,
            open_timeout=OPEN_S,
            server_header="trocar",
            logger=_silence(),
        ) as listening:
            ready(next(iter(listening.sockets)).getsockname()[1])
            tending = asyncio.create_task(self._tend())
            await self._stopping.wait()
            tending.cancel()

    def stop(self) -> None:
        """Say goodbye to everybody."""
        self._stopping.set()

    def deliver(self, parcels: Iterable[Parcel]) -> None:
        """Hand messages to all who want them."""
        now = time.monotonic()
        for client in self._clients:
            with _telling():
                client.deliver(parcels, now)

    def _admit(self, connection: ServerConnection, request: HttpRequest) -> Response | None:
        objection = self._door.objection(request.path, request.headers)
        if objection is not None:
            return connection.respond(*objection)
        if len(self._clients) >= MOST_CLIENTS:
            return connection.respond(503, f"{MOST_CLIENTS} clients are connected already\n")
        return None

    async def _listen(self, connection: ServerConnection) -> None:
        client = Client(connection)
        self._clients.add(client)
        try:
            async for text in connection:
                await self._hear(client, text)
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(client)
            self._see_what_is_wanted()

    async def _hear(self, client: Client, text: str | bytes) -> None:
        if not client.may_send(len(text)):
            self._conversation.overhear(client, text)
            if client.refused % BREATH_EVERY == 0:
                await asyncio.sleep(BREATH_S)
            return
        before = client.changes
        with _telling():
            self._conversation.hear(client, text)
        if client.changes != before:
            self._see_what_is_wanted()

    def _see_what_is_wanted(self) -> None:
        self.wanted = frozenset[str]().union(*(client.subscriptions for client in self._clients))

    async def _tend(self) -> None:
        while True:
            await asyncio.sleep(TEND_S)
            now = time.monotonic()
            for client in self._clients:
                with _telling():
                    client.tend(now)


@contextlib.contextmanager
def _telling() -> Iterator[None]:
    """Log a message that cannot be sent, and go on with the others."""
    try:
        yield
    except TrocarError as error:
        _log.error("websocket: %s", error)


def _silence() -> logging.Logger:
    """Return a logger that keeps the library's remarks about strangers off the terminal."""
    return logging.Logger("trocar.websocket", logging.CRITICAL)
