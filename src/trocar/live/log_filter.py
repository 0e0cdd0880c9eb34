"""Let a library's repeated log line pass once a minute, with the number of those left out."""

from __future__ import annotations

import contextlib
import logging
import re
import time
from collections.abc import Iterator

from trocar.simulation.rate_limit import RateLimit, suffix

LOG_PERIOD_S = 60.0
"""Wall time between two lines of a kind that strangers or a slow machine cause [s]. Source: our own
choice; a line a second hid everything else in ten minutes of abuse."""


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
