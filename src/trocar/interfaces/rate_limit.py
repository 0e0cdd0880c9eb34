"""Log a repeated complaint once in a while only, with the number of those left out."""

from __future__ import annotations

import threading
from collections.abc import Hashable

PERIOD_S = 2.0
"""Wall time between two complaints of a kind [s]. Source: as the simulation's own."""

KINDS = 1000
"""Kinds that are kept apart, which bounds memory. Source: our own choice."""


class RateLimit:
    """Decide which complaints are due; from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: dict[Hashable, tuple[float, int]] = {}

    def __len__(self) -> int:
        """Return how many kinds are remembered."""
        return len(self._last)

    def due(self, kind: Hashable, now_s: float) -> int | None:
        """Return how many of a kind were left out since the last, None to leave this one out."""
        with self._lock:
            if len(self._last) >= KINDS:
                self._last.clear()
            last_s, left_out = self._last.get(kind, (None, 0))
            if last_s is not None and now_s - last_s < PERIOD_S:
                self._last[kind] = last_s, left_out + 1
                return None
            self._last[kind] = now_s, 0
            return left_out

    def forget(self) -> None:
        """Forget every complaint."""
        with self._lock:
            self._last.clear()


def suffix(left_out: int) -> str:
    """Return the end of a complaint that was left out a few times."""
    return f" ({left_out} more such since)" if left_out else ""
