"""The messages of the page: the simulation's warnings, with their time, while they apply."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape

SHOWN = 4
"""Messages on the page at most."""

LASTS_S = 20.0
"""Time for which a message stays after it came last [s]. Source: our own choice."""

#: The end of a message of which several were held back, see `trocar.simulation.rate_limit`.
MORE = re.compile(r" \((\d+) more such since\)$")

#: Measured numbers, which may differ where a message comes again.
MEASURED = re.compile(r"\d+\.\d+")

IN_STATUS = {"in_status": True}
"""`extra` of a log record that the page shows in a status line, and not among the messages."""


@dataclass(frozen=True)
class Notice:
    """A message.

    Attributes:
        text: without the count
        count: how often it came
        at_s: when it came last, in seconds since the epoch
    """

    text: str
    count: int
    at_s: float


class Notices(logging.Handler):
    """Keep the warnings of the simulation for the page, from any thread.

    A message that comes again, also with other decimal numbers, is counted, and the newest is
    shown. It leaves `LASTS_S` after it came last; one that names an arm that cannot move stays
    until that arm can.

    Args:
        now: seconds since the epoch
    """

    def __init__(self, now: Callable[[], float] = time.time) -> None:
        super().__init__(level=logging.WARNING)
        self._now = now
        self._kept: dict[str, Notice] = {}
        self._idle: frozenset[str] = frozenset()

    @contextmanager
    def listening(self) -> Generator[None]:
        """Handle the simulation's log while the `with` block lasts."""
        log = logging.getLogger("trocar")
        log.addHandler(self)
        try:
            yield
        finally:
            log.removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a warning; called with the handler's lock."""
        if getattr(record, "in_status", False):
            return
        text = record.getMessage()
        more = MORE.search(text)
        text = MORE.sub("", text)
        kind = MEASURED.sub("", text)
        before = self._kept.pop(kind, None)
        count = 1 + (before.count if before else 0) + (int(more[1]) if more else 0)
        self._kept[kind] = Notice(text, count, self._now())

    def follow(self, ready: Mapping[str, bool]) -> None:
        """Let go of what no longer applies.

        Args:
            ready: whether each arm can move, {arm: bool}
        """
        idle = frozenset(name for name, on in ready.items() if not on)
        again, self._idle = self._idle - idle, idle
        now = self._now()
        with self._held():
            for kind, notice in tuple(self._kept.items()):
                over = now - notice.at_s > LASTS_S and not _names(notice.text, idle)
                if over or _names(notice.text, again):
                    del self._kept[kind]

    def clear(self) -> None:
        """Let go of all, as after a reset."""
        with self._held():
            self._kept.clear()

    @property
    def newest_first(self) -> tuple[Notice, ...]:
        """The messages that apply, as many as are shown."""
        with self._held():
            return tuple(reversed(self._kept.values()))[:SHOWN]

    @contextmanager
    def _held(self) -> Generator[None]:
        self.acquire()
        try:
            yield
        finally:
            self.release()


def html_of(notices: tuple[Notice, ...]) -> str:
    """Return messages as HTML, each with the time at which it came last."""
    return "".join(
        f'<div class="note"><time>{time.strftime("%H:%M:%S", time.localtime(one.at_s))}</time> '
        f"{escape(one.text)}{f' ({one.count} times)' if one.count > 1 else ''}</div>"
        for one in notices
    )


def _names(text: str, arms: frozenset[str]) -> bool:
    return any(re.search(rf"\b{re.escape(arm)}\b", text) for arm in arms)
