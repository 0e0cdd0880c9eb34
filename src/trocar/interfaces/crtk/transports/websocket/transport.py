"""The transport that the core knows: it passes messages to and from the server's thread.

core's publishing thread --send--> pending --server's thread: encoded once--> every client
client --> server's thread --> core.receive; services: core.call in a few worker threads
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

from trocar.errors import InputError
from trocar.interfaces.crtk.transports.websocket.door import Door
from trocar.interfaces.crtk.transports.websocket.parcel import PACKING, Parcel
from trocar.interfaces.crtk.transports.websocket.server import Server
from trocar.interfaces.origins import PageAccess

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.transport import Batch

PORT = 9090
"""Where clients of rosbridge look by themselves."""

MOST_PENDING = 4096
"""Messages that wait for the server's thread: some 20 periods of the full cart.

Source: our own choice.
"""

WORKERS = 4
"""Threads that wait for services' answers."""

FAREWELL_S = 5.0
"""How long ending may take [s]."""

_log = logging.getLogger("trocar")


class WebSocketTransport:
    """Serve the rosbridge protocol in a thread of its own.

    Args:
        host: address to listen on
        port: port to listen on; 0 takes any free one
        token: what clients have to show; needed beyond the loopback address
        pages: which web pages may connect; when omitted, none

    Attributes:
        port: the one that is listened on, once started

    Raises:
        InputError: no token beyond the loopback address, or a short one, or no such port
    """

    name = "websocket"
    packing = PACKING

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = PORT,
        token: str | None = None,
        pages: PageAccess | None = None,
    ) -> None:
        if not 0 <= port <= 65535:
            raise InputError(f"port {port} does not exist; allowed: 0 (any free one) to 65535")
        self._door = Door(host, token, pages or PageAccess())
        self.port = port
        self._lock = threading.Lock()
        self._pending: list[Parcel] = []
        self._woken = False
        self._loop: asyncio.AbstractEventLoop | None = None
        self._server: Server | None = None
        self._thread: threading.Thread | None = None
        self._workers = ThreadPoolExecutor(WORKERS, "trocar-websocket-call")

    @property
    def address(self) -> str:
        """Where clients find it, without the token."""
        host = self._door.host
        return f"ws://{f'[{host}]' if ':' in host else host}:{self.port}"

    @property
    def greeting(self) -> str:
        """What is printed when time flows."""
        return f"{self.address}  (rosbridge{', with the token' if self._door.token else ''})"

    def start(self, core: Core) -> None:
        """Listen.

        Raises:
            InputError: the port is taken or forbidden, or the host is not this machine's
        """
        bound: Future[int] = Future()
        self._thread = threading.Thread(
            target=self._main, args=(core, bound), name="trocar-websocket", daemon=True
        )
        self._thread.start()
        try:
            self.port = bound.result()
        except OSError as error:
            raise self._cannot_listen(str(error.strerror).rpartition(": ")[2]) from error

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that some client wants now."""
        return frozenset() if self._server is None else self._server.wanted

    def send(self, batch: Batch) -> None:
        """Let the server's thread send messages as soon as it can."""
        wanted = self.wanted()
        parcels = [Parcel(topic, message) for topic, message in batch if topic.name in wanted]
        if not parcels:
            return
        with self._lock:
            self._pending += parcels
            self._make_room()
            wake, self._woken = not self._woken, True
        if wake:
            self._there(self._deliver)

    def close(self) -> None:
        """Say goodbye to all clients and end."""
        if self._server is not None:
            self._there(self._server.stop)
        if self._thread is not None:
            self._thread.join(FAREWELL_S)
        self._workers.shutdown(wait=False, cancel_futures=True)

    def _make_room(self) -> None:
        """Throw away older states when the server's thread is too far behind."""
        if len(self._pending) > MOST_PENDING:
            events = [parcel for parcel in self._pending if not parcel.replaceable]
            states = {p.topic.name: p for p in self._pending if p.replaceable}
            self._pending = [*events[-MOST_PENDING // 2 :], *states.values()]

    def _cannot_listen(self, why: str) -> InputError:
        return InputError(
            f"the WebSocket cannot listen on {self._door.host} port {self.port}: {why}: choose "
            "another (--websocket-port, 0 for any free one), or do without (--no-websocket)"
        )

    def _there(self, work: Callable[[], object]) -> None:
        """Let the server's thread do something."""
        try:
            if self._loop is not None:
                self._loop.call_soon_threadsafe(work)
        except RuntimeError:  # it has ended in between
            return

    # What happens in the server's thread.

    def _main(self, core: Core, bound: Future[int]) -> None:
        try:
            asyncio.run(self._serve(core, bound))
        except Exception as error:  # noqa: BLE001  handed over whole to whoever waits for the port
            if bound.done():
                _log.exception("websocket: ended")
            else:
                bound.set_exception(error)

    async def _serve(self, core: Core, bound: Future[int]) -> None:
        self._loop = asyncio.get_running_loop()
        self._server = Server(core, self._door, self._workers)
        await self._server.run(self.port, bound.set_result)

    def _deliver(self) -> None:
        with self._lock:
            parcels, self._pending = self._pending, []
            self._woken = False
        if self._server is not None:
            self._server.deliver(parcels)
