"""A simulation that runs only while its script waits: as fast as it goes, the same each time."""

from __future__ import annotations

import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable
from math import ceil
from typing import Any

from trocar.interfaces.crtk.arm_messages import MAKERS
from trocar.interfaces.crtk.clock import SECOND, Beat, Stamp
from trocar.interfaces.crtk.core import Core
from trocar.interfaces.crtk.scripts.bus import Bus
from trocar.interfaces.crtk.scripts.flow import Parts, no_parts
from trocar.interfaces.crtk.scripts.turns import Turns
from trocar.interfaces.loop import SERVER_TICK_S, Loop
from trocar.interfaces.pace import nearest_tick
from trocar.simulation import World
from trocar.simulation.readout import Reader, Readout

#: A script's time begins here: a client that asks how old a message is that never came, with its
#: stamp of zero, has to find it older than it has patience for. Source: our own choice. [ns]
FIRST_NS = 1000 * SECOND


class TickClock:
    """A clock that stands still between ticks."""

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        """Return seconds since the first tick."""
        return self.time

    def sleep(self, seconds: float, until: threading.Event | None = None) -> None:  # noqa: ARG002
        """Let seconds pass."""
        self.time += seconds


class Stepped:
    """Steps a world in its script's thread, whenever that waits.

    Args:
        world: nobody else may call it
        limit_s: simulated time after which the script has to be over [s]; None: none
        parts: makes what is served beside the arms, of the loop
        rates: `rate_hz` and the like of the `Core`

    Attributes:
        world, core, bus: what it is made of
        steps: ticks so far; a watchdog sees by them that something goes on
    """

    virtual = True

    def __init__(
        self, world: World, limit_s: float | None = None, parts: Parts = no_parts, **rates: Any
    ) -> None:
        self.world = world
        self._clock = TickClock()
        tick_s = nearest_tick(SERVER_TICK_S, world.timestep)
        self._loop = Loop(world, speed="max", tick_s=tick_s, clock=self._clock)
        components = parts(self._loop)
        self._alone = not components
        self.core = Core(self._loop, clock="sim", first_ns=FIRST_NS, components=components, **rates)
        self.bus = Bus(self._later)
        self.core.attach(self.bus)
        self._beat = Beat(self.core.rate_hz)
        self._calls: deque[Callable[[], None]] = deque()
        self._reader = Reader(world.model)
        self._seen: tuple[Readout, Stamp] | None = None
        self._limit_s, self.steps = limit_s, 0
        self._tick_ns = round(tick_s * SECOND)
        self.turns = Turns(self.clock_ns, self._step, self._tick_ns)
        self.over: Callable[[], BaseException] = TimeoutError

    def start(self) -> None:
        """Start, and let the first tick pass, so that every topic has told something."""
        self.core.begin()
        self._step(None)

    def close(self) -> None:
        """End."""
        self.core.close()
        self._loop.close()

    @property
    def simulated_s(self) -> float:
        """Time that has passed [s]."""
        return self.core.stamper.elapsed_s

    def clock_ns(self) -> int:
        """Return the time of the last tick [ns]."""
        return FIRST_NS + self.steps * self._tick_ns

    def now_ns(self) -> int:
        """Return the time that the next stamp is not before [ns]: that, or nanoseconds later."""
        seconds, rest = self.core.stamper.now()
        return seconds * SECOND + rest

    def look(self) -> None:
        """Note that the script looks at the clock or at a reading."""
        self.turns.look()

    def wait(self, ready: Callable[[], bool], timeout_s: float | None) -> bool:
        """Let time pass until something holds; return whether it does."""
        timeout = None if timeout_s is None else max(0, round(timeout_s * SECOND))
        return self.turns.wait(ready, timeout)

    def sleep(self, seconds: float) -> None:
        """Let some time pass [s]."""
        self.turns.wait(_never, max(0, round(seconds * SECOND)))

    def peek(self, name: str) -> dict[str, Any] | None:
        """Return what a topic of an arm that is published every period would tell now."""
        topic = self.core.topics[name]
        maker = MAKERS.get(topic.key) if topic.arm else None
        if maker is None:
            return None
        if self._seen is None:
            if self._reader.model is not self.world.model:  # a tool was exchanged
                self._reader = Reader(self.world.model)
            self._seen = self._reader.read(self.world.sample()), self.core.stamper.now()
        readout, stamp = self._seen
        return maker(readout.arm(topic.arm), stamp)

    def fail(self, failure: BaseException) -> None:
        """End the run from another thread: the script meets this error when it waits next."""
        self.turns.failure = failure

    # ------------------------------------------------------------------ inside

    def _step(self, most_ns: int | None) -> None:
        """Let time pass until something was told, and call whoever subscribed to it."""
        if self._limit_s is not None and self.simulated_s >= self._limit_s:
            raise self.over()
        ticks = self._ticks(most_ns)
        self._seen = None
        self._loop.tick(ticks)
        self._clock.sleep(ticks * self._loop.tick_s)
        self.steps += ticks
        if self._beat.due(self.simulated_s):
            self.core.publish_waiting()
        while self._calls:
            call = self._calls.popleft()
            try:
                call()
            except Exception as problem:
                if problem is self.turns.failure:
                    raise
                complain()

    def _ticks(self, most_ns: int | None) -> int:
        """Return how many ticks may pass at once: commands that wait are obeyed in the first."""
        if self.bus.posted:
            self.bus.posted = False
            return 1
        sample = ceil(self._beat.left(self.simulated_s) / self._loop.tick_s)
        patience = self.core.incoming.patience() if self._alone else self._loop.quiet_ticks()
        ticks = max(1, int(min(sample, patience)))
        return ticks if most_ns is None else min(ticks, max(1, -(-most_ns // self._tick_ns)))

    def _later(self, call: Callable[[], None]) -> None:
        """Have a function of the script called when time passes next."""
        self._calls.append(call)


def complain() -> None:
    """Say that a function that was called for a message raised an error."""
    sys.stderr.write("bad callback:\n")
    traceback.print_exc()


def _never() -> bool:
    return False
