"""How much a client may send and how much may wait for it: nothing here grows without end."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable


class Bucket:
    """Allow so much a second, and a burst after a rest.

    Args:
        rate: how much a second in the long run
        burst: how much at once
    """

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._left = burst
        self._then = 0.0

    def take(self, amount: float, now: float) -> bool:
        """Take an amount at a moment [s] if it is allowed; return whether it was."""
        self._left = min(self._burst, self._left + self._rate * (now - self._then))
        self._then = now
        allowed = amount <= self._left
        if allowed:
            self._left -= amount
        return allowed


class Throttle:
    """Let a topic's messages pass no more often than asked [s]."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self._due = 0.0

    def passes(self, now: float) -> bool:
        """Whether a message may go at a moment [s]; if so, the next one has to wait."""
        if now < self._due:
            return False
        late = now - self._due
        self._due = self._due + self.period_s if late < self.period_s else now + self.period_s
        return True


class Outbox:
    """Keep what a slow reader has not taken yet, in order, without growing.

    States of one topic replace each other; events and answers all count until `capacity` of them
    wait, then the oldest goes. What goes is counted.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._waiting: OrderedDict[Hashable, bytes] = OrderedDict()
        self._ordered: OrderedDict[int, None] = OrderedDict()
        self._posted = 0
        self.lost = 0

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def put_state(self, topic: str, frame: bytes) -> None:
        """Let the newest state of a topic wait in place of an older one."""
        if self._waiting.pop(topic, None) is not None:
            self.lost += 1
        self._waiting[topic] = frame

    def put(self, frame: bytes) -> None:
        """Let an event or an answer wait."""
        if len(self._ordered) >= self._capacity:
            oldest, _ = self._ordered.popitem(last=False)
            del self._waiting[oldest]
            self.lost += 1
        self._posted += 1
        self._ordered[self._posted] = None
        self._waiting[self._posted] = frame

    def take(self, most: int) -> list[bytes]:
        """Take the oldest up to about so many bytes, and at least one."""
        taken: list[bytes] = []
        size = 0
        while self._waiting and size < most:
            key, frame = self._waiting.popitem(last=False)
            if isinstance(key, int):
                del self._ordered[key]
            taken.append(frame)
            size += len(frame)
        return taken
