"""When a picture is taken: once one is due, and so that it is drawn soon.

A snapshot that waited for the picture before it would only make its own older.
"""

from __future__ import annotations

import time

#: A snapshot that waits no longer than this to be drawn is taken. Source: our own choice: images
#: are taken with states, every 4.5 ms, and drawing is not to wait long for the next one. [s]
SOON_S = 0.005
#: How much of a new figure the usual one takes over: how long drawing takes. Source: our own
#: choice.
LEARNT = 0.1


class Shutter:
    """Asked in the loop's thread, told by the drawing thread.

    Attributes:
        owed: whether a picture was due and is not taken yet
    """

    def __init__(self) -> None:
        self.owed = False
        self._usual_s = 0.0
        self._began: float | None = None

    def takes(self, due: bool, free: bool = True) -> bool:
        """Tell whether to take a picture now.

        Args:
            due: whether the next one is due since the last call
            free: whether none waits to be drawn
        """
        self.owed = self.owed or due
        taken = self.owed and free and self._soon_free()
        self.owed = self.owed and not taken
        return taken

    def begin(self) -> None:
        """Note that drawing begins."""
        self._began = time.perf_counter()

    def end(self) -> None:
        """Note that it is done."""
        began, self._began = self._began, None
        if began is not None:
            self._usual_s += LEARNT * (time.perf_counter() - began - self._usual_s)

    def _soon_free(self) -> bool:
        began = self._began
        return began is None or self._usual_s - (time.perf_counter() - began) < SOON_S
