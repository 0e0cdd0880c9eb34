"""The same complaint once in a while only, with how many were left unsaid."""

from __future__ import annotations

import threading
from collections.abc import Hashable

PERIOD_S = 2.0
"""The same complaint comes once in this much wall time [s]. Source: as the simulation's own."""

KINDS = 1000
"""How many kinds are kept apart. Source: our own choice; memory stays bounded."""


class Seldom:
    """Tell which complaints are due; from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._said: dict[Hashable, tuple[float, int]] = {}

    def due(self, kind: Hashable, now_s: float) -> int | None:
        """Return how many of a kind were left unsaid, None when this one is to be as well."""
        with self._lock:
            if len(self._said) >= KINDS:
                self._said.clear()
            said, unsaid = self._said.get(kind, (None, 0))
            if said is not None and now_s - said < PERIOD_S:
                self._said[kind] = said, unsaid + 1
                return None
            self._said[kind] = now_s, 0
            return unsaid

    def forget(self) -> None:
        """Say everything anew."""
        with self._lock:
            self._said.clear()


def more(unsaid: int) -> str:
    """Return what stands behind a complaint that was left unsaid a few times."""
    return f" ({unsaid} more such since)" if unsaid else ""
