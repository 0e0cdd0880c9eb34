"""The clients that command each arm."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

IDLE_S = 5.0
"""A client commands an arm until so long after its last command [s]. Source: our own choice, longer
than a script pauses between moves, shorter than it takes to start the next one by hand."""


class Commanders:
    """Keep which clients command each arm; from any thread.

    A client commands an arm from its first command until it disconnects or has sent none for
    IDLE_S. The web viewer and teleoperation belong to the simulator and are no clients.

    Args:
        now: wall time [s]

    Attributes:
        exclusive: whether an arm that a client commands is no other's
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self.exclusive, self._now = False, now
        self._lock = threading.Lock()
        self._last: dict[str, dict[str, float]] = {}

    def claim(self, arm: str, peer: str) -> Sequence[str]:
        """Note a command of a client for an arm; return the others that command it.

        Where arms are exclusive and others do, nothing is noted.
        """
        now_s = self._now()
        with self._lock:
            last = self._last.setdefault(arm, {})
            if len(last) == 1 and peer in last:  # the usual case, quickly
                last[peer] = now_s
                return ()
            for name in [name for name, at in last.items() if now_s - at >= IDLE_S]:
                del last[name]
            others = [name for name in last if name != peer]
            if not (others and self.exclusive):
                last[peer] = now_s
            return others

    def left(self, peer: str) -> None:
        """Note that a client has disconnected."""
        with self._lock:
            for last in self._last.values():
                last.pop(peer, None)

    def of(self, arm: str) -> list[str]:
        """Return the clients that command an arm."""
        now_s = self._now()
        with self._lock:
            last = self._last.get(arm, {})
            return [name for name, at in last.items() if now_s - at < IDLE_S]
