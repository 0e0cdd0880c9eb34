"""A bar that shows how far something is, where somebody watches."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

WIDTH = 32
WIPE = "\r\x1b[K"


@contextmanager
def progress_bar(unit: str, wanted: bool = True) -> Iterator[Callable[[int, int], None] | None]:
    """Hand out what draws a bar on stderr, told (done, all); None where nobody watches.

    Args:
        unit: what is counted
        wanted: no bar else
    """

    def draw(done: int, total: int) -> None:
        filled = WIDTH * done // total
        bar = "#" * filled + "." * (WIDTH - filled)
        sys.stderr.write(f"\r[{bar}] {done} of {total} {unit}")
        sys.stderr.flush()

    watched = wanted and sys.stderr.isatty()
    try:
        yield draw if watched else None
    finally:
        if watched:
            sys.stderr.write(WIPE)
