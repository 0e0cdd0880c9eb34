"""The last minute of a loop's world as saved states, to look at and to go on from."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trocar.live.inbox import Command
from trocar.live.state import Elapsed

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.records import Snapshot
    from trocar.simulation.world import State

SPAN_S, PERIOD_S = 60.0, 0.1
"""Simulated time that is kept, and between two moments [s]. Source: our own choice; a moment of the
full cart takes 1.3 ms and 60 kB (measured), so that a minute has 36 MB."""

HALF = 0.5
"""Share of a physics step by which times may differ by rounding."""


@dataclass(frozen=True)
class Moment:
    """A moment of a world.

    Attributes:
        snapshot: where everything is
        state: from which motion goes on to the last bit
    """

    snapshot: Snapshot
    state: State

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.snapshot.time


class Timeline:
    """Keep moments of the last minute, as a watcher of the loop.

    A reset and an exchange of a tool forget everything, since states of before do not fit; a saved
    state that is loaded forgets what came after its time.

    Args:
        world: is saved, in the loop's thread only
        tick_s: simulated time between two ticks of its loop [s]
    """

    def __init__(self, world: World, tick_s: float) -> None:
        self._world, self._ticks = world, max(1, round(PERIOD_S / tick_s))
        self._timestep = world.timestep
        self._kept: deque[Moment] = deque()
        self._lock = threading.Lock()

    @property
    def moments(self) -> tuple[Moment, ...]:
        """The kept moments, the oldest first; from any thread."""
        with self._lock:
            return tuple(self._kept)

    def ticked(self, elapsed: Elapsed) -> None:  # noqa: ARG002  as of a watcher
        """Keep a moment when it is due."""
        world, slack = self._world, HALF * self._timestep
        now = world.time
        with self._lock:
            if now < slack:  # reset: a moment at 0 may be of another seed
                self._kept.clear()
            while self._kept and self._kept[-1].time > now + slack:
                self._kept.pop()
            last = self._kept[-1].time if self._kept else None
        if last is not None and now < last + PERIOD_S - slack:
            return
        snapshot = world.snapshot()
        moment = Moment(snapshot, world.save())
        with self._lock:
            if self._kept and self._kept[-1].snapshot.build != snapshot.build:
                self._kept.clear()
            self._kept.append(moment)
            while now - self._kept[0].time > SPAN_S + slack:
                self._kept.popleft()

    def patience(self) -> int:
        """Return after how many ticks to be called again."""
        return self._ticks

    def refused(self, command: Command, reason: str) -> None:
        """Ignore rejected commands."""

    def at(self, time_s: float) -> Moment | None:
        """Return the moment nearest to a time [s]; None without any."""
        return min(self.moments, key=lambda moment: abs(moment.time - time_s), default=None)
