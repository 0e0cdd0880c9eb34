"""Threads that take turns: one runs at a time, and time passes only while all of them wait.

Which thread goes on when depends on the script and on simulated time alone, so a script with
threads of its own is as repeatable as one without.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

#: Looks at the clock or at readings in one moment before time passes by itself: a loop that only
#: looks would otherwise never end. Source: our own choice, more than a control loop makes.
LOOKS = 100


class EndedError(BaseException):
    """Ends a thread of a script whose run is over; no `except Exception` holds it back."""


@dataclass(eq=False)
class Waiter:
    """A thread that waits for its turn.

    Attributes:
        ready: tells whether what it waits for has come
        until_ns: when it gives up; None: never
        go: set when the turn is its own
    """

    ready: Callable[[], bool]
    until_ns: int | None
    go: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))


class Turns:
    """Hand the turn from thread to thread, and let time pass when nobody else can go on.

    Args:
        now_ns: tells the time [ns]
        step: lets some time pass, no more than it is given [ns] (None: as it likes), in the thread
            whose turn it is
        tick_ns: the least that passes [ns]
    """

    def __init__(
        self, now_ns: Callable[[], int], step: Callable[[int | None], None], tick_ns: int
    ) -> None:
        self._now, self._step, self._tick_ns = now_ns, step, tick_ns
        self._main = threading.get_ident()
        self._known = {self._main}
        self._waiting: list[Waiter] = []
        self._first: Waiter | None = None
        self._looks, self._looked_ns = 0, -1
        #: Why the run is over, to be raised in the script's own thread.
        self.failure: BaseException | None = None

    @property
    def in_main(self) -> bool:
        """Whether the calling thread is the script's own."""
        return threading.get_ident() == self._main

    def wait(self, ready: Callable[[], bool], timeout_ns: int | None) -> bool:
        """Give the turn away until something holds; return whether it does.

        Args:
            ready: what to wait for; is called often, and changes nothing
            timeout_ns: how long at most; None: for ever
        """
        if threading.get_ident() not in self._known:
            raise RuntimeError("only threads that `threading.Thread` started can wait here")
        me = Waiter(ready, None if timeout_ns is None else self._now() + timeout_ns)
        while True:
            self._check()
            if ready():
                return True
            if me.until_ns is not None and self._now() >= me.until_ns:
                return ready()
            other = self._next()
            if other is not None:
                self._hand_over(me, other)
            else:
                self._pass(me)

    def look(self) -> None:
        """Note that the script looks at something; time passes when it only ever does that."""
        now = self._now()
        if now != self._looked_ns:
            self._looks, self._looked_ns = 0, now
        self._looks += 1
        if self._looks > LOOKS:
            self.wait(lambda: False, self._tick_ns)

    def begin(self, body: Callable[[], None]) -> None:
        """Run a function in a thread of its own, when its turn comes."""
        me = Waiter(lambda: True, None)

        def run() -> None:
            self._known.add(threading.get_ident())
            me.go.acquire()
            try:
                body()
            except EndedError:
                pass
            finally:
                self._known.discard(threading.get_ident())
                self._leave()

        self._waiting.append(me)
        threading.Thread(target=run, name="trocar-script", daemon=True).start()

    def _check(self) -> None:
        if self.failure is not None:
            if self.in_main:
                raise self.failure
            raise EndedError

    def _most(self, *more: Waiter) -> int | None:
        """Return how much time may pass until somebody gives up waiting [ns]."""
        ends = [w.until_ns for w in (*self._waiting, *more) if w.until_ns is not None]
        return min(ends) - self._now() if ends else None

    def _pass(self, me: Waiter) -> None:
        try:
            self._step(self._most(me))
        except BaseException as failure:
            if self.in_main and isinstance(failure, KeyboardInterrupt):
                raise  # the script may still tidy up
            self.failure = failure
            if self.in_main:
                raise
            raise EndedError from None

    def _due(self, waiter: Waiter) -> bool:
        late = waiter.until_ns is not None and self._now() >= waiter.until_ns
        return late or (self.failure is not None and waiter is self._first) or waiter.ready()

    def _next(self) -> Waiter | None:
        return next((waiter for waiter in self._waiting if self._due(waiter)), None)

    def _hand_over(self, me: Waiter, other: Waiter) -> None:
        if self.in_main:
            self._first = me
        self._waiting.remove(other)
        self._waiting.append(me)
        other.go.release()
        me.go.acquire()

    def _leave(self) -> None:
        """Hand the turn on for good; the script's own thread always waits for it."""
        while True:
            if self.failure is not None and self._first in self._waiting:
                other = self._first
            else:
                other = self._next()
            if other is not None:
                self._waiting.remove(other)
                other.go.release()
                return
            try:
                self._step(self._most())
            except BaseException as failure:  # noqa: BLE001  raised in the script's own thread
                self.failure = failure
