"""A side lane for large messages: images must not hold up the states behind them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

#: Time from one large message to the next: two at once may be more than a subscriber's socket
#: holds, and what is lost there comes late. Source: our own choice, by the images that
#: `python -m benchmarks interface --transport ros2` counts. [s]
APART_S = 0.002


class Lane:
    """Hand on, in a thread of its own, the newest parcel of each name.

    Args:
        deliver: what to do with a parcel

    Attributes:
        overtaken: parcels that a newer one replaced
    """

    def __init__(self, deliver: Callable[[Any], None]) -> None:
        self._deliver = deliver
        self._waiting: dict[str, Any] = {}
        self._changed = threading.Condition()
        self._open = True
        self._thread: threading.Thread | None = None
        self.overtaken = 0

    def put(self, name: str, parcel: Any) -> None:
        """Queue a parcel, without waiting."""
        with self._changed:
            self.overtaken += name in self._waiting
            self._waiting[name] = parcel
            if self._thread is None and self._open:
                self._thread = threading.Thread(target=self._run, name="trocar-images", daemon=True)
                self._thread.start()
            self._changed.notify()

    def close(self) -> None:
        """End, whatever waits."""
        with self._changed:
            self._open = False
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or not self._open)
                if not self._open:
                    return
                parcels, self._waiting = self._waiting, {}
            for parcel in parcels.values():
                self._deliver(parcel)
                time.sleep(APART_S)
