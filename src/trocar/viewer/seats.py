"""The browser that drives, while the others watch."""

from __future__ import annotations

import time
from collections.abc import Callable

ANSWER_S = 10.0
"""Time after which a request that the driver does not answer is granted [s]. Source: our own
choice."""


class Seats:
    """Keep which browser drives; in viser's thread.

    The first browser drives; when it leaves, the one that came next does.

    Args:
        now: wall time [s]

    Attributes:
        driver: number of the browser that drives; None without a browser
        asking: number of the one that requests control; None: none does
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._present: list[int] = []
        self._asked_s = 0.0
        self.driver: int | None = None
        self.asking: int | None = None

    @property
    def count(self) -> int:
        """Number of browsers."""
        return len(self._present)

    def come(self, who: int) -> None:
        """Let a browser in."""
        self._present.append(who)
        if self.driver is None:
            self.driver = who

    def leave(self, who: int) -> None:
        """Let a browser go."""
        self._present.remove(who)
        if self.asking == who:
            self.asking = None
        if self.driver == who:
            self.driver = self.asking or next(iter(self._present), None)
            self.asking = None

    def request(self, who: int) -> None:
        """Ask the driver for control."""
        if who != self.driver and self.asking is None:
            self.asking, self._asked_s = who, self._now()

    def answer(self, *, granted: bool) -> None:
        """Give control to the one that requests it, or keep it."""
        if self.asking is not None and granted:
            self.driver = self.asking
        self.asking = None

    def follow(self) -> None:
        """Grant a request that was not answered in time."""
        if self.asking is not None and self._now() - self._asked_s > ANSWER_S:
            self.answer(granted=True)

    def blocked(self, who: int) -> str:
        """Return the reason that keeps a browser from driving; "" for the driver."""
        if who == self.driver:
            return ""
        return f"browser {self.number(self.driver)} drives; Request control above"

    def number(self, who: int | None) -> int:
        """Return the number of a browser for people: 1 for the one that is here longest."""
        return self._present.index(who) + 1 if who in self._present else 0
