"""A world, its loop and its core in one thread, with a clock that only a test moves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

from trocar.live import Loop
from trocar.live.loop import SERVER_TICK_S
from trocar.ros import Core
from trocar.ros.core import Transport
from trocar.ros.transports.memory import MemoryTransport
from trocar.simulation import World

Own = TypeVar("Own", bound=Transport)


@contextmanager
def running(transport: Own, rig: str = "psm") -> Iterator[tuple[Core, Own]]:
    """Run a rig in real time on a transport for as long as the block."""
    loop = Loop(World(rig), tick_s=SERVER_TICK_S)
    core = Core(loop)
    core.attach(transport)
    core.start()
    loop.start()
    try:
        yield core, transport
    finally:
        loop.stop()
        core.close()


class HandClock:
    """A wall clock that stands until it is told to go on."""

    def __init__(self) -> None:
        self.time = 100.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float, until: object = None) -> None:  # noqa: ARG002
        self.time += seconds


class Served:
    """Run ticks and publish what they bring, in the thread of the test."""

    def __init__(
        self, rig: str | World = "psm", *, wanted=None, world: dict | None = None, **core
    ) -> None:
        self.world = rig if isinstance(rig, World) else World(rig, **(world or {}))
        self.clock = HandClock()
        self.loop = Loop(self.world, tick_s=SERVER_TICK_S, clock=self.clock)
        self.core = Core(self.loop, **core)
        self.transport = MemoryTransport(wanted)
        self.core.attach(self.transport)
        self.core.begin()

    def run(self, seconds: float = SERVER_TICK_S) -> None:
        for _ in range(round(seconds / SERVER_TICK_S)):
            self.loop.tick()
            self.clock.sleep(SERVER_TICK_S)
            self.core.publish_waiting()

    def messages(self, name: str) -> list[dict]:
        return self.transport.received.get(name, [])

    def last(self, name: str) -> dict:
        return self.transport.last(name)


def stamp_ns(message: dict) -> int:
    seconds, nanoseconds = message["header"]["stamp"]
    return seconds * 1_000_000_000 + nanoseconds
