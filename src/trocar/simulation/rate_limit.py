"""Let a repeated complaint pass once in a while only, with the number of those left out."""

from __future__ import annotations

import threading
from collections.abc import Hashable

WARNING_PERIOD_S = 2.0
"""Time between two warnings of a kind [s]. Source: our own choice."""

BURST = 10
"""Rejected commands of a kind that are all reported within a period, unless they are streamed
set-points: a person or a script learns of each, and a flood does not fill the log. Source: our own
choice."""

KINDS = 1000
"""Kinds that are kept apart, which bounds memory. Source: our own choice."""

Remembered = dict[Hashable, tuple[float, int, int]]
"""{kind: (since when [s], how many passed, how many were left out)}."""


class RateLimit:
    """Decide which complaints are due; from any thread.

    Args:
        period_s: time between two complaints of a kind [s]
    """

    def __init__(self, period_s: float = WARNING_PERIOD_S) -> None:
        self._period = period_s
        self._lock = threading.Lock()
        self._last: Remembered = {}

    def __len__(self) -> int:
        """Return the number of kinds that are remembered."""
        return len(self._last)

    def due(self, kind: Hashable, now_s: float, burst: int = 1) -> int | None:
        """Return the number left out of a kind since the last, None to leave this one out.

        Args:
            kind: what counts as a repetition
            now_s: the time [s]
            burst: complaints that pass within a period
        """
        with self._lock:
            if len(self._last) >= KINDS:
                self._last.clear()
            since_s, passed, left_out = self._last.get(kind, (now_s, 0, 0))
            if now_s - since_s >= self._period:
                since_s, passed = now_s, 0
            if passed >= burst:
                self._last[kind] = since_s, passed, left_out + 1
                return None
            self._last[kind] = since_s, passed + 1, 0
            return left_out

    def forget(self) -> None:
        """Forget every complaint."""
        with self._lock:
            self._last.clear()

    def save(self) -> Remembered:
        """Return a copy of its memory, for `load`."""
        return dict(self._last)

    def load(self, saved: Remembered) -> None:
        """Restore what `save` returned."""
        self._last = dict(saved)


def burst(kind: str) -> int:
    """Return the number of reports of a rejection (its verb first) that a period allows."""
    return 1 if "servo_" in kind else BURST


def suffix(left_out: int) -> str:
    """Return the end of a complaint that was left out a few times."""
    return f" ({left_out} more such since)" if left_out else ""
