"""The queue of images between the core and a transport."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

#: Time from one large message to the next: two at once may be more than a subscriber's socket
#: holds, and what is lost there comes late. Source: our own choice, by the images that
#: `trocar bench interface --transport ros2` counts. [s]
APART_S = 0.002


class ImageQueue:
    """Deliver the newest image of each name in a thread of its own, so that states do not wait.

    Args:
        deliver: what to do with an image

    Attributes:
        overtaken: images that a newer one replaced
    """

    def __init__(self, deliver: Callable[[Any], None]) -> None:
        self._deliver = deliver
        self._waiting: dict[str, Any] = {}
        self._changed = threading.Condition()
        self._open = True
        self._thread: threading.Thread | None = None
        self.overtaken = 0

    def put(self, name: str, image: Any) -> None:
        """Queue an image, without waiting."""
        with self._changed:
            self.overtaken += name in self._waiting
            self._waiting[name] = image
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
                images, self._waiting = self._waiting, {}
            for image in images.values():
                self._deliver(image)
                time.sleep(APART_S)
