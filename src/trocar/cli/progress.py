"""A bar that shows how far something is, where somebody watches."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

WIDTH = 32
WIPE = "\r\x1b[K"
#: Each step takes this share of what is left, where nobody knows how many there will be.
STEP_SHARE = 0.12


@contextmanager
def progress_bar(unit: str, wanted: bool = True) -> Iterator[Callable[[int, int], None] | None]:
    """Hand out what draws a bar on stderr, told (done, all); None where nobody watches.

    Args:
        unit: what is counted
        wanted: no bar else
    """

    def draw(done: int, total: int) -> None:
        _draw(done / total, f"{done} of {total} {unit}")

    with _wiped(wanted) as watched:
        yield draw if watched else None


@contextmanager
def progress_steps() -> Iterator[Callable[[str], None]]:
    """Hand out what draws a bar on stderr, told what is done next; silent where nobody watches."""
    share = 0.0

    def draw(what: str) -> None:
        nonlocal share
        share += STEP_SHARE * (1.0 - share)
        _draw(share, what)

    with _wiped() as watched:
        yield draw if watched else lambda _: None


@contextmanager
def _wiped(wanted: bool = True) -> Iterator[bool]:
    """Tell whether somebody watches, and take the bar away in the end."""
    watched = wanted and sys.stderr.isatty()
    try:
        yield watched
    finally:
        if watched:
            sys.stderr.write(WIPE)
            sys.stderr.flush()


def _draw(share: float, text: str) -> None:
    filled = int(WIDTH * share)
    sys.stderr.write(f"{WIPE}[{'#' * filled}{'.' * (WIDTH - filled)}] {text}")
    sys.stderr.flush()
