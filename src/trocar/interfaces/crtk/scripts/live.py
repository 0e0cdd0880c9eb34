"""A simulation that runs at the wall clock's pace beside its script, as `trocar sim` does."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

from trocar.interfaces.crtk.clock import SECOND
from trocar.interfaces.crtk.core import Core
from trocar.interfaces.crtk.scripts.bus import Bus
from trocar.interfaces.crtk.scripts.flow import Parts, no_parts
from trocar.interfaces.crtk.scripts.stepped import complain
from trocar.interfaces.loop import SERVER_TICK_S, Loop
from trocar.interfaces.pace import nearest_tick
from trocar.simulation import World

#: How often a wait looks whether what it waits for has come [s]. Source: our own choice.
LOOK_S = 0.002


class Live:
    """Steps a world in a thread of its own; functions of the script are called in another.

    Args:
        world: nobody else may call it
        begin: starts the loop; whoever shows it as well may do so
        parts: makes what is served beside the arms, of the loop
        rates: `rate_hz` and the like of the `Core`

    Attributes:
        world, core, bus: what it is made of
        loop: the world's loop
    """

    virtual = False

    def __init__(
        self,
        world: World,
        begin: Callable[[Loop], None] = Loop.start,
        parts: Parts = no_parts,
        **rates: Any,
    ) -> None:
        self.world, self._begin = world, begin
        self.loop = Loop(world, tick_s=nearest_tick(SERVER_TICK_S, world.timestep))
        self.core = Core(self.loop, components=parts(self.loop), **rates)
        self.bus = Bus(self._later)
        self.core.attach(self.bus)
        self._calls: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="trocar-callbacks", daemon=True)
        self._failure: BaseException | None = None

    def start(self) -> None:
        """Start, and wait for the first tick."""
        self.core.start()
        self._thread.start()
        self._begin(self.loop)
        self.wait(lambda: self.core.stamper.elapsed_s > 0.0, 10.0)

    def close(self) -> None:
        """End, and let go of every thread."""
        self._calls.put(None)
        self.core.close()
        self.loop.close()

    @property
    def steps(self) -> int:
        """What a watchdog sees by that something goes on: here, nothing it could tell."""
        return 0

    @property
    def simulated_s(self) -> float:
        """Time that has passed [s]."""
        return self.core.stamper.elapsed_s

    def now_ns(self) -> int:
        """Return the time that stamps tell [ns]."""
        seconds, rest = self.core.stamper.now()
        return seconds * SECOND + rest

    def look(self) -> None:
        """Raise what ended the run, if something did."""
        if self._failure is not None:
            raise self._failure
        if not self.loop.running:
            self.loop.wait()  # raises what stopped it

    def wait(self, ready: Callable[[], bool], timeout_s: float | None) -> bool:
        """Wait until something holds; return whether it does."""
        end = float("inf") if timeout_s is None else time.monotonic() + timeout_s
        while not ready():
            self.look()
            left = end - time.monotonic()
            if left <= 0.0:
                return ready()
            time.sleep(min(LOOK_S, left))
        return True

    def sleep(self, seconds: float) -> None:
        """Wait for some time [s]."""
        self.look()
        time.sleep(max(0.0, seconds))

    def peek(self, name: str) -> dict[str, Any] | None:  # noqa: ARG002  as the stepped one has it
        """Return None: readings come as messages."""
        return None

    def fail(self, failure: BaseException) -> None:
        """End the run from another thread: the script meets this error when it waits next."""
        self._failure = failure

    def _later(self, call: Callable[[], None]) -> None:
        self._calls.put(call)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            try:
                call()
            except Exception:  # noqa: BLE001  as rospy: said, and the others go on
                complain()
