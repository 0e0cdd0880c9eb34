"""Stamps of headers: monotonic, and never zero."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Literal

from trocar.errors import UnknownNameError
from trocar.live.state import Elapsed
from trocar.messages.types import SECOND
from trocar.ros.message_fields import RefusedError, shown

#: (seconds, nanoseconds), as messages carry times.
Stamp = tuple[int, int]
Mode = Literal["wall", "sim"]
MODES: tuple[Mode, ...] = ("wall", "sim")

#: Simulated time begins here, since a zero stamp means "invalid". Source: dVRK 2.4. [ns]
FIRST_NS = SECOND
#: A stream without an accepted message for this long may begin anew with older stamps, as a bag
#: does that is played again, or a client whose clock was set back. Source: our own choice, so that
#: such a client is back within 5 s. [s]
SILENCE_S = 2.0
#: Streams that are remembered. Source: our own choice: many times what a lab has.
STREAMS = 1024


class Stamper:
    """Turn a loop's time into stamps.

    Args:
        mode: "wall": the wall clock when time began to pass, plus simulated time, plus the time
            spent in pauses; "sim": simulated time from `first_ns`. No reset turns it back.
        wall_ns: the wall clock [ns since 1970]
        first_ns: where simulated time begins [ns]
    """

    def __init__(
        self,
        mode: Mode = "wall",
        wall_ns: Callable[[], int] = time.time_ns,
        first_ns: int = FIRST_NS,
    ) -> None:
        if mode not in MODES:
            raise UnknownNameError("clock", mode, MODES)
        self.mode, self._wall_ns = mode, wall_ns
        self._lock = threading.Lock()
        self._first = wall_ns() if mode == "wall" else first_ns
        self._began_s = 0.0
        self._last = 0
        self._idle_s = 0.0
        self._seen_s: float | None = None
        self._now = self._first
        #: Time that has passed, pauses included [s].
        self.elapsed_s = 0.0

    def advance(self, elapsed: Elapsed, wall_s: float) -> None:
        """Advance to the loop's time; pauses are measured by `wall_s`, from any zero [s]."""
        first = self._seen_s is None
        if elapsed.paused and self._seen_s is not None:
            self._idle_s += max(0.0, wall_s - self._seen_s)
        self._seen_s = wall_s
        self.elapsed_s = elapsed.simulated_s + elapsed.let_go_s + self._idle_s
        if first and self.mode == "wall":  # it may have taken long until time passes
            self._first = self._wall_ns() - round(self.elapsed_s * SECOND)
            self._began_s = wall_s - self.elapsed_s
        passed = self.elapsed_s if self.mode == "wall" else elapsed.simulated_s
        self._now = self._first + round(passed * SECOND)

    def now(self) -> Stamp:
        """Return the time that every stamp from now on is later than; from any thread."""
        with self._lock:
            self._last = max(self._now, self._last)
            return divmod(self._last, SECOND)

    def stamp(self, wall_s: float | None = None) -> Stamp:
        """Return a stamp later than all before, a nanosecond at least.

        Args:
            wall_s: the wall time of something that a client waits for [s]: where simulated time
                lags behind a little, its stamp is not before the command that brought it about
        """
        now = self._now
        if wall_s is not None and self.mode == "wall" and self._seen_s is not None:
            now = max(now, self._first + round((wall_s - self._began_s) * SECOND))
        with self._lock:
            self._last = max(now, self._last + 1)
            return divmod(self._last, SECOND)


class Beat:
    """A periodic event on absolute time, so that no error adds up.

    Args:
        rate_hz: how often
    """

    #: A tick that is this much early is in time. [s]
    SLACK_S = 1e-6

    def __init__(self, rate_hz: float) -> None:
        self._rate, self._count = rate_hz, -1

    def due(self, elapsed_s: float) -> bool:
        """Return whether the next one is due; missed ones are left out."""
        count = int((elapsed_s + self.SLACK_S) * self._rate)
        if count <= self._count:
            return False
        self._count = count
        return True

    def since(self, elapsed_s: float) -> float:
        """Return the time since the last one was due [s]."""
        return elapsed_s - self._count / self._rate

    def left(self, elapsed_s: float) -> float:
        """Return the time until the next one is due [s]."""
        return (self._count + 1) / self._rate - elapsed_s - self.SLACK_S


class StampCheck:
    """Reject messages of a stream (a topic and its sender) whose stamps go back."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: OrderedDict[tuple[str, str], tuple[Stamp, float]] = OrderedDict()

    def __len__(self) -> int:
        """Count the streams that are remembered."""
        return len(self._newest)

    def check(self, stream: tuple[str, str], sent: Stamp, now_s: float) -> None:
        """Check a stamp against the newest of its stream.

        Raises:
            RefusedError: it is older
        """
        with self._lock:
            newest, when_s = self._newest.get(stream, ((0, 0), 0.0))
        if sent < newest and now_s - when_s < SILENCE_S:
            raise RefusedError(
                "stamp",
                f"got the stamp {shown(sent)}, older than the previous {shown(newest)}; allowed: "
                "non-decreasing stamps, or zero",
            )

    def remember(self, stream: tuple[str, str], sent: Stamp, now_s: float) -> None:
        """Note a stamp whose message was accepted."""
        with self._lock:
            self._newest[stream] = sent, now_s
            self._newest.move_to_end(stream)
            if len(self._newest) > STREAMS:
                self._newest.popitem(last=False)
