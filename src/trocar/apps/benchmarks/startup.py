"""How soon trocar answers: from the command to its help, and to the first motion."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable

from trocar.apps.benchmarks.figure import Figure

HELP_S = 0.3
FIRST_MOTION_S = 5.0
RUNS = 5


def startup(watch: Callable[[str], None] | None = None) -> list[Figure]:
    """Start the program as a person would, a few times, and return the medians."""
    if watch is not None:
        watch("start-up")
    helps = [_seconds_until_end(["--help"]) for _ in range(RUNS)]
    moves = [_seconds_until_line(["sim", "--port", "0"]) for _ in range(3)]
    return [
        Figure("trocar --help", statistics.median(helps), "s", HELP_S),
        Figure("trocar sim to the first motion", statistics.median(moves), "s", FIRST_MOTION_S),
    ]


def _seconds_until_end(words: list[str]) -> float:
    before = time.perf_counter()
    subprocess.run([sys.executable, "-m", "trocar", *words], check=True, capture_output=True)
    return time.perf_counter() - before


def _seconds_until_line(words: list[str]) -> float:
    """Return the time until a command prints its first line, then stop it."""
    before = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-m", "trocar", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        line = process.stdout.readline() if process.stdout else ""
        seconds = time.perf_counter() - before
        process.terminate()
    if not line:
        raise RuntimeError(f"trocar {' '.join(words)} printed nothing")
    return seconds
