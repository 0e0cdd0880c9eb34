"""Workers in a thread of their own: one drops items that newer ones overtook, one is waited for."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

Item = TypeVar("Item")


class LatestOnly(Generic[Item]):
    """Pass the newest item of each key to a function, in a thread of its own.

    `put` never waits: an item that still waits when the next one of its key comes is dropped and
    counted. Items of several keys that wait together are worked on together, so that a newer one
    never parts the images of a pair.

    Args:
        work: called with each item in the thread, which starts with the first one
        name: of the thread
        end: called in the thread after the last item

    Attributes:
        dropped: items that a newer one replaced
    """

    def __init__(
        self, work: Callable[[Item], None], name: str, end: Callable[[], None] | None = None
    ) -> None:
        self._work, self._name, self._end = work, name, end
        self._waiting: dict[str, Item] = {}
        self._changed = threading.Condition()
        self._open, self._working = True, False
        self._thread: threading.Thread | None = None
        self.dropped = 0

    @property
    def waiting(self) -> bool:
        """Whether an item waits."""
        return bool(self._waiting)

    @property
    def idle(self) -> bool:
        """Whether no item waits or is worked on."""
        with self._changed:
            return not self._waiting and not self._working

    def put(self, item: Item, key: str = "") -> bool:
        """Hand in an item without waiting; return whether it replaced one that waited."""
        with self._changed:
            overtaken = key in self._waiting
            self.dropped += overtaken
            self._waiting[key] = item
            if self._thread is None and self._open:
                self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()
            self._changed.notify()
        return overtaken

    def close(self, timeout_s: float | None = None) -> None:
        """End after the item in work; drop those that wait, and join the thread."""
        with self._changed:
            self._open = False
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(timeout_s)

    def _run(self) -> None:
        try:
            while items := self._taken():
                for item in items:
                    self._work(item)
        finally:
            self._working = False
            if self._end is not None:
                self._end()

    def _taken(self) -> list[Item]:
        """Wait for items and take them; none when closed."""
        with self._changed:
            self._working = False
            self._changed.wait_for(lambda: self._waiting or not self._open)
            items = list(self._waiting.values()) if self._open else []
            self._waiting.clear()
            self._working = bool(items)
        return items


class InTurn(Generic[Item]):
    """Pass each item to a function in a thread of its own, and wait for it.

    Args:
        work, name, end: as of a `LatestOnly`
    """

    waiting = False
    idle = True
    dropped = 0

    def __init__(
        self, work: Callable[[Item], None], name: str, end: Callable[[], None] | None = None
    ) -> None:
        self._work, self._end = work, end
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)

    def put(self, item: Item, key: str = "") -> bool:  # noqa: ARG002  each is worked on
        """Return False once the item is worked on."""
        self._pool.submit(self._work, item).result()
        return False

    def close(self, timeout_s: float | None = None) -> None:  # noqa: ARG002  nothing waits
        """End the thread."""
        if self._end is not None:
            self._pool.submit(self._end).result()
        self._pool.shutdown()
