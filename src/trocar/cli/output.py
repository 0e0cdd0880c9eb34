"""Output of the command line: tables for people, one JSON document for programs, progress bars."""

from __future__ import annotations

import math
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any

from trocar.outputs import json_text

if TYPE_CHECKING:
    from trocar.descriptions import ArmDescription

#: Minimum time between redraws of a progress bar; one takes about 1 ms. [s]
REFRESH_S = 0.1
#: Time to the first line of progress where stderr is no terminal, and the longest time between two
#: lines; it doubles from line to line. Source: our own choice. [s]
LINE_S, MOST_S = 1.0, 30.0


def print_result(args: Namespace, record: Any, text: Callable[[], str]) -> None:
    """Print a result: the record as JSON with --json, else the text."""
    if args.json:
        print_json(record)
    else:
        print(text())


def print_json(record: Any) -> None:
    """Print a record as one JSON document (`trocar.outputs.document`)."""
    print(json_text(record))


def warn(message: str) -> None:
    """Print a warning on stderr."""
    print(f"trocar: warning: {message}", file=sys.stderr)


def title(arm: ArmDescription) -> str:
    """Return the names of an arm and its tool as a title."""
    return f"{arm.name} with {arm.tool}" if arm.tool else arm.name


def fixed(value: float, decimals: int = 9) -> str:
    """Format with a fixed number of decimals; no sign on 0, - for NaN and infinity."""
    if not math.isfinite(value):
        return "-"
    return f"{round(float(value), decimals) + 0.0:.{decimals}f}"


def short(value: float | None) -> str:
    """Format with up to seven digits; rounding errors as 0; - for None, NaN and infinity."""
    if value is None or not math.isfinite(value):
        return "-"
    return "0" if abs(value) < 1e-12 else f"{value:.7g}"


def leaning(up: Iterable[float]) -> str:
    """Return the direction of gravity in an arm's base, "" where the arm stands upright."""
    down = [-value for value in up]
    if down[2] < -1.0 + 1e-9:
        return ""
    shown = ", ".join(f"{round(value, 3) + 0.0:.3f}" for value in down)  # no -0.000
    return f", gravity along ({shown}) of its base"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], indent: str = "  ") -> str:
    """Lay out rows under a head; right-align columns of numbers.

    Unlike a table of rich, line widths do not depend on a terminal, and nothing is imported.

    Args:
        head: column names with units
        rows: cells, one per column
        indent: start of each line
    """
    body = [list(row) for row in rows]
    numbers = set("0123456789+-.e ")
    right = [all(row[i] and set(row[i]) <= numbers for row in body) for i in range(len(head))]
    widths = [max(len(line[i]) for line in [head, *body]) for i in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        padded = (
            cell.rjust(width) if flush else cell.ljust(width)
            for cell, width, flush in zip(cells, widths, right, strict=True)
        )
        return (indent + "  ".join(padded)).rstrip()

    return "\n".join([line(head), *(line(row) for row in body)])


@contextmanager
def progress_bar(unit: str) -> Generator[Callable[[int, int | None], None]]:
    """Yield a function (done, total) that shows progress on stderr; total None: unknown.

    A bar on a terminal; elsewhere a line now and then.

    Args:
        unit: name of the counted items, plural
    """
    drawn = float("-inf")

    def announce(done: int, total: int | None) -> None:
        nonlocal drawn
        if (now := time.monotonic()) >= drawn + REFRESH_S or done == total:
            drawn = now
            draw(f"{done} {unit}" if total is None else f"{done} of {total} {unit}", done, total)

    with _display() as draw:
        yield announce


@contextmanager
def progress_steps(verb: str = "", count: int | None = None) -> Generator[Callable[[str], None]]:
    """Yield a function (step) that shows the step that begins on stderr.

    A bar on a terminal; elsewhere a line per step with a verb, which is for commands that always
    take long; without, a line now and then.

    Args:
        verb: stands before the step
        count: number of steps, to estimate the remaining time; None: unknown
    """
    if verb and not _on_terminal():
        yield lambda step: _say(f"{verb} {step} ...")
        return
    begun = -1

    def announce(step: str) -> None:
        nonlocal begun
        begun += 1
        draw(f"{verb} {step}".strip(), begun, None if count is None else max(count, begun + 1))

    with _display() as draw:
        yield announce


Draw = Callable[[str, int, int | None], None]


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def _say(text: str) -> None:
    if sys.stderr is not None:
        print(f"trocar: {text}", file=sys.stderr, flush=True)


def _display() -> AbstractContextManager[Draw]:
    return _bar() if _on_terminal() else _lines()


@contextmanager
def _lines() -> Generator[Draw]:
    """Yield a function (text, done, total) whose newest text is printed on stderr now and then."""
    newest = ""
    over = threading.Event()

    def draw(text: str, _done: int, _total: int | None) -> None:
        nonlocal newest
        newest = text

    def work() -> None:
        printed, pause_s = "", LINE_S
        while not over.wait(pause_s):
            pause_s = min(2.0 * pause_s, MOST_S)
            if newest != printed:
                printed = newest
                _say(f"{printed} ...")

    thread = threading.Thread(target=work, name="trocar-progress", daemon=True)
    thread.start()
    try:
        yield draw
    finally:
        over.set()
        thread.join()


@contextmanager
def _bar() -> Generator[Draw]:
    """Yield a function (text, done, total) that draws a bar on stderr until the block ends."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(32),
        TextColumn("{task.description}", markup=False),
        TimeElapsedColumn(),
        TextColumn("elapsed,"),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    # No redraw thread: some commands measure time.
    with Progress(
        *columns, console=Console(stderr=True), auto_refresh=False, transient=True
    ) as bar:
        task = bar.add_task("", total=None)
        yield lambda text, done, total: bar.update(
            task, description=text, completed=done, total=total, refresh=True
        )
