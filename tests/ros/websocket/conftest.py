"""A PSM that is served on a real socket, and clients that talk to it."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

from trocar.live import Loop
from trocar.live.loop import SERVER_TICK_S
from trocar.ros import Core
from trocar.ros.transports.websocket import WebSocketTransport
from trocar.simulation import World

#: Longest wait for something that should come at once, on a busy machine [s].
PATIENCE_S = 20.0


class Served:
    """A world that runs in real time behind a WebSocket."""

    def __init__(self, rig: str = "psm", **options: Any) -> None:
        self.world = World(rig)
        self.loop = Loop(self.world, tick_s=SERVER_TICK_S)
        self.core = Core(self.loop)
        self.transport = WebSocketTransport(port=0, **options)
        self.core.attach(self.transport)
        self.core.start()
        self.loop.start()

    @property
    def url(self) -> str:
        return self.transport.address

    def close(self) -> None:
        self.core.close()
        self.loop.close()


class Talk:
    """A client of its own: what it sends and hears, in JSON."""

    def __init__(self, url: str, **options: Any) -> None:
        self.socket: ClientConnection = connect(url, compression=None, **options)
        self.url = url

    def send(self, **document: Any) -> None:
        self.socket.send(json.dumps(document))

    def hear(self, timeout_s: float = PATIENCE_S) -> dict[str, Any]:
        return json.loads(self.socket.recv(timeout=timeout_s))

    def hear_until(self, fits: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            heard = self.hear()
            if fits(heard):
                return heard
        raise AssertionError("nothing that fits came")

    def hear_op(self, op: str) -> dict[str, Any]:
        return self.hear_until(lambda heard: heard["op"] == op)

    def hear_on(
        self, topic: str, fits: Callable[[dict[str, Any]], bool] = lambda _: True
    ) -> dict[str, Any]:
        """Return the first message on a topic that fits."""
        heard = self.hear_until(
            lambda it: it["op"] == "publish" and it["topic"] == topic and fits(it["msg"])
        )
        return heard["msg"]

    def call(self, service: str, args: Any = None) -> dict[str, Any]:
        self.send(op="call_service", service=service, args=args, id=service)
        return self.hear_op("service_response")

    def wait_for_server(self) -> None:
        """Return when all that was sent is done."""
        self.call("/rosapi/get_time")


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    with contextlib.closing(Served()) as it:
        yield it


@pytest.fixture
def meet(served: Served) -> Iterator[Callable[..., Talk]]:
    """Return the function that makes a client; all are gone when the test ends."""
    met: list[Talk] = []

    def make(**options: Any) -> Talk:
        met.append(Talk(served.url, **options))
        return met[-1]

    yield make
    for it in met:
        it.socket.close_socket()
    assert until(lambda: not served.transport.clients)


@pytest.fixture
def talk(served: Served) -> Iterator[Talk]:
    it = Talk(served.url)
    yield it
    it.socket.close()


def until(fits: Callable[[], bool]) -> bool:
    """Wait for something; return whether it came."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if fits():
            return True
        threading.Event().wait(0.01)
    return False
