"""The browser that drives, while the others watch."""

from __future__ import annotations

import time
from collections.abc import Callable

ANSWER_S = 10.0
"""Time after which a request that the driver does not answer is granted to a console, and forgotten
of any other browser [s]. Source: our own choice."""


class Seats:
    """Keep which browser drives; in viser's thread.

    The first console drives; when it leaves, the one that came next does. A console is a browser of
    the machine that runs the simulator; any other watches until it is given control.

    Args:
        now: wall time [s]

    Attributes:
        driver: number of the browser that drives; None without a console
        asking: number of the one that requests control; None: none does
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._present: list[int] = []
        self._consoles: set[int] = set()
        self._asked_s = 0.0
        self.driver: int | None = None
        self.asking: int | None = None

    @property
    def shown(self) -> bool:
        """Whether it matters who drives."""
        return len(self._present) > 1 or self.driver is None

    def come(self, who: int, *, console: bool = True) -> None:
        """Let a browser in."""
        self._present.append(who)
        if console:
            self.admit(who)

    def admit(self, who: int) -> None:
        """Let a browser drive as a console does."""
        self._consoles.add(who)
        if self.driver is None:
            self.driver = who

    def leave(self, who: int) -> None:
        """Let a browser go."""
        self._present.remove(who)
        self._consoles.discard(who)
        if self.asking == who:
            self.asking = None
        if self.driver == who:
            consoles = (other for other in self._present if other in self._consoles)
            self.driver = self.asking if self.asking in self._consoles else next(consoles, None)
            self.asking = None

    def request(self, who: int) -> None:
        """Ask the driver for control; a console has it at once from a browser that is not one."""
        if who in self._consoles and self.driver not in self._consoles:
            self.driver = who
            if self.asking == who:
                self.asking = None
        elif who != self.driver and self.asking is None:
            self.asking, self._asked_s = who, self._now()

    def answers(self, who: int) -> bool:
        """Whether a browser answers the request: the driver, or a console if another asks."""
        if self.asking is None or who == self.asking:
            return False
        return who == self.driver or (who in self._consoles and self.asking not in self._consoles)

    def answer(self, *, granted: bool) -> None:
        """Give control to the one that requests it, or keep it."""
        if self.asking is not None and granted:
            self.driver = self.asking
        self.asking = None

    def follow(self) -> None:
        """Settle a request that was not answered in time."""
        if self.asking is not None and self._now() - self._asked_s > ANSWER_S:
            self.answer(granted=self.asking in self._consoles)

    def blocked(self, who: int) -> str:
        """Return the reason that keeps a browser from driving; "" for the driver."""
        if who == self.driver:
            return ""
        if self.driver is None:
            return "you watch: only a browser of the simulator's machine gives control"
        return f"browser {self.number(self.driver)} drives; Request control above"

    def number(self, who: int | None) -> int:
        """Return the number of a browser for people: 1 for the one that is here longest."""
        return self._present.index(who) + 1 if who in self._present else 0
