"""Time from starting the program to its help, and to the first motion."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

from benchmarks.served import served
from trocar.robot.verification.figures import Figure

#: Source: the project's own goals. [s]
HELP_S, FIRST_MOTION_S = 0.3, 5.0


def startup() -> list[Figure]:
    """Start the program a few times as a person would, and return the medians."""
    helps, moves = [], []
    for _ in range(5):
        before = time.perf_counter()
        subprocess.run([sys.executable, "-m", "trocar", "--help"], check=True, capture_output=True)
        helps.append(time.perf_counter() - before)
    for _ in range(3):
        before = time.perf_counter()
        with served(["--port", "0", "--websocket-port", "0"], ".+"):
            moves.append(time.perf_counter() - before)
    return [
        Figure("trocar --help", statistics.median(helps), "s", HELP_S),
        Figure("trocar sim to the first motion", statistics.median(moves), "s", FIRST_MOTION_S),
    ]
