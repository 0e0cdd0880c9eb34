"""Log a repeated complaint once in a while only, with the number of those left out."""

from __future__ import annotations

import contextlib
import logging
import re
import threading
import time
from collections.abc import Hashable, Iterator

REFUSAL_PERIOD_S = 2.0
"""Wall time between two refusals of a kind, of which clients are told [s]. Source: as the
simulation's own."""

LOG_PERIOD_S = 60.0
"""Wall time between two lines of a kind that strangers or a slow machine cause [s]. Source: our own
choice; a line a second hid everything else in ten minutes of abuse."""

KINDS = 1000
"""Kinds that are kept apart, which bounds memory. Source: our own choice."""


class RateLimit:
    """Decide which complaints are due; from any thread.

    Args:
        period_s: time between two complaints of a kind [s]
    """

    def __init__(self, period_s: float = REFUSAL_PERIOD_S) -> None:
        self._period = period_s
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
            if last_s is not None and now_s - last_s < self._period:
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


class Repeats(logging.Filter):
    """Let a line of a library pass once a minute, with the number of those left out.

    Lines that differ in numbers only, as in addresses, are the same. trocar limits its own lines.
    """

    def __init__(self) -> None:
        super().__init__()
        self._limit = RateLimit(LOG_PERIOD_S)

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a line may pass; add the number of those before it."""
        if record.name.partition(".")[0] == "trocar":
            return True
        decided = record.__dict__
        if "passes" not in decided:  # no other handler's filter has seen it
            text = record.getMessage()
            unsaid = self._limit.due((record.name, re.sub(r"\d+", "", text)), time.monotonic())
            decided["passes"] = unsaid is not None
            record.msg, record.args = text + suffix(unsaid or 0), ()
        return decided["passes"]


@contextlib.contextmanager
def without_repeats() -> Iterator[None]:
    """Limit the lines of libraries, in every handler of the root logger, while the block lasts."""
    repeats, handlers = Repeats(), list(logging.getLogger().handlers)
    for handler in handlers:
        handler.addFilter(repeats)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(repeats)
