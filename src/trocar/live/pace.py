"""When the next tick is due, and how fast time really flows."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from typing import Protocol

from trocar.errors import InputError
from trocar.simulation.rate_limit import RateLimit, suffix

_log = logging.getLogger("trocar")

LOG_PERIOD_S = 60.0
"""Wall time between two log lines of a kind that other programs or a slow machine cause [s].
Source: our own choice; a line a second hid everything else in ten minutes of abuse."""

GIVE_UP_S = 1.0
"""Lag beyond which lost time is skipped [s]. Source: our own choice: longer than any hiccup of a
busy machine, shorter than what a person would like to see replayed in fast motion."""

EARLY_S = 1e-6
"""A tick that is this much early is due [s]. Source: our own choice, for rounding."""

LATE = 2
"""So many ticks that are due are not waited with. Source: our own choice."""

RATE_WINDOW_S = 2.0
"""Span over which the real-time factor is measured [s]. Source: our own choice."""


class Clock(Protocol):
    """A clock that can be waited on; a test brings its own."""

    def now(self) -> float:
        """Return seconds since some fixed moment."""
        ...

    def sleep(self, seconds: float, until: threading.Event | None = None) -> None:
        """Return after about this many seconds, or as soon as an event is set."""
        ...


class Wakeup(threading.Event):
    """An event that one thread waits for, set in one call in place of six."""

    def __init__(self) -> None:
        super().__init__()
        self._lock = threading.Lock()
        self._lock.acquire()
        self._on = False

    def is_set(self) -> bool:
        """Return whether it was set since it was cleared."""
        return self._on

    def set(self) -> None:
        """Wake the thread that waits, or let its next wait return at once; from any thread."""
        self._on = True
        try:
            self._lock.release()
        except RuntimeError:  # it was set already
            return

    def clear(self) -> None:
        """Let the next wait last; in the waiting thread."""
        self._on = False
        self._lock.acquire(blocking=False)

    def wait(self, timeout: float | None = None) -> bool:
        """Return whether it was set, then or within a time [s]."""
        if not self._on and self._lock.acquire(timeout=-1 if timeout is None else timeout):
            self._on = True
        return self._on


class WallClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Return seconds since some fixed moment."""
        return time.perf_counter()

    def sleep(self, seconds: float, until: threading.Event | None = None) -> None:
        """Return after about this many seconds, or as soon as an event is set."""
        if seconds <= 0.0:
            return
        if until is None:
            time.sleep(seconds)
        else:
            until.wait(seconds)


class Pace:
    """Schedule ticks on absolute time: late ticks are caught up, errors never add up.

    Tick k is due at start + k * period, whatever happened to the ticks before it.

    Args:
        clock: where time comes from
        period_s: time between two ticks [s]
    """

    def __init__(self, clock: Clock, period_s: float) -> None:
        self._clock = clock
        self._period = period_s
        self.let_go_s = 0.0
        self._rate_limit = RateLimit(LOG_PERIOD_S)
        self.restart()

    def restart(self) -> None:
        """Call now the moment at which the next tick is due."""
        self._start = self._clock.now()
        self._ticks = 0

    def wait(self, most: int = 1, until: threading.Event | None = None) -> int:
        """Wait until `most` ticks are due, not at all if several are late; return their number.

        Args:
            most: how many to wait for, and the most that are returned
            until: an event that ends the wait for several as soon as one is due
        """
        due = self._due()
        if due < min(most, LATE):
            self._clock.sleep(self._due_s(most - 1) - self._clock.now(), until)
            due = self._due()
            if due < 1:
                self._clock.sleep(self._due_s(0) - self._clock.now())
                due = 1
        due = min(due, most)
        self._ticks += due
        return due

    @property
    def due_s(self) -> float:
        """When the last tick was due, by the clock [s]."""
        return self._due_s(-1)

    def _due_s(self, ahead: int) -> float:
        """Return when the next tick is due, or one so many ahead of it [s]."""
        return self._start + (self._ticks + ahead) * self._period

    def _due(self) -> int:
        """Count the ticks that are due now; skip a lag beyond GIVE_UP_S."""
        lag = self._clock.now() - self._due_s(0)
        if lag > GIVE_UP_S:
            self.let_go_s += lag
            self._start += lag
            unsaid = self._rate_limit.due("lag", self._clock.now())
            if unsaid is not None:
                text = "%.1f s behind real time: skipping the delay%s"
                _log.warning(text, lag, suffix(unsaid))
            lag = 0.0
        return int((lag + EARLY_S) // self._period) + 1


class Speedometer:
    """Measure the real-time factor over the last seconds of wall time."""

    def __init__(self) -> None:
        self._marks: deque[tuple[float, float]] = deque()

    def restart(self) -> None:
        """Forget everything, after a pause or a reset."""
        self._marks.clear()

    def mark(self, wall_s: float, simulated_s: float) -> None:
        """Note how much was simulated up to a moment of wall time [s]."""
        self._marks.append((wall_s, simulated_s))
        while len(self._marks) > 2 and wall_s - self._marks[0][0] > RATE_WINDOW_S:
            self._marks.popleft()

    @property
    def factor(self) -> float:
        """Simulated seconds per second of wall time; 0 before two marks."""
        if len(self._marks) < 2:
            return 0.0
        (wall_a, sim_a), (wall_b, sim_b) = self._marks[0], self._marks[-1]
        return (sim_b - sim_a) / (wall_b - wall_a) if wall_b > wall_a else 0.0


def nearest_tick(wanted_s: float, timestep_s: float) -> float:
    """Return the whole multiple of the timestep that is nearest to a tick [s], one at least."""
    return max(1, round(wanted_s / timestep_s)) * timestep_s


def whole_steps(tick_s: float, timestep_s: float) -> int:
    """Count the physics steps in a tick; refuse a tick that is no whole multiple of them."""
    steps = round(tick_s / timestep_s)
    if steps < 1 or abs(steps * timestep_s - tick_s) > 1e-9 * tick_s:
        raise InputError(
            f"got a tick of {tick_s} s; allowed: a whole multiple of the timestep, {timestep_s} s"
        )
    return steps
