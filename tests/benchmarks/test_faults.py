"""`python -m benchmarks attack --only faults`: how it judges, and the faults that it makes."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.attack import faults
from benchmarks.attack.faults import Commander, FaultError, Outcome

ROOT = Path(__file__).parents[2]
CLOCK = """
import os, signal, time
import trocar.cli
from benchmarks.attack import _simulator

def shown(_):
    before = time.time(), time.time_ns(), time.monotonic()
    os.kill(os.getpid(), signal.SIGUSR1)
    after = time.time(), time.time_ns(), time.monotonic()
    print(*(b - a for a, b in zip(before, after)))
    return 0

trocar.cli.main = shown
_simulator.main()
"""


def commander(*came: tuple[float, int, int]) -> Commander:
    """Return a client that has no thread, with states that came."""
    made = Commander.__new__(Commander)
    made.came = list(came)
    return made


def test_the_wall_clock_of_a_simulator_is_set_back_an_hour_and_no_other() -> None:
    words = [sys.executable, "-c", CLOCK]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    seconds, nanoseconds, monotonic = map(float, done.stdout.split())
    assert seconds == pytest.approx(-3600.0, abs=10.0)
    assert nanoseconds == pytest.approx(-3600e9, abs=10e9)
    assert 0.0 <= monotonic < 10.0


def test_a_small_disk_fills_up_and_its_file_is_kept(tmp_path: Path) -> None:
    folder = tmp_path / "small"
    folder.mkdir()
    fill = (
        "import signal, sys\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"f = open('{folder}/full.mcap', 'wb', buffering=0)\n"
        "try:\n    while True: f.write(bytes(100_000))\nexcept OSError: sys.exit(7)"
    )
    words = [*faults.small_disk(folder), sys.executable, "-c", fill]
    assert subprocess.run(words, check=False).returncode == 7
    assert 3_000_000 < (tmp_path / "full.mcap").stat().st_size <= faults.DISK


def test_the_longest_time_without_a_state_is_found() -> None:
    now = time.monotonic()
    client = commander((now - 5.0, 1, 1), (now - 4.0, 2, 2), (now - 1.0, 3, 3), (now, 4, 4))
    assert client.gap_s(now - 4.5) == pytest.approx(3.0, abs=0.01)
    assert client.gap_s(now - 0.5) == pytest.approx(0.5, abs=0.01)


def test_stamps_that_go_back_are_found() -> None:
    assert commander((0.0, 10, 1), (0.1, 20, 2)).backward_ns() == 0
    assert commander((0.0, 10, 1), (0.1, 20, 2), (0.2, 5, 3)).backward_ns() == 15


def test_of_several_rounds_the_worst_is_shown() -> None:
    found = [
        Outcome("disk full", "end", lost_s=0.2),
        Outcome("disk full", "end", lost_s=0.9),
        Outcome("disk full", "end", lost_s=0.4),
        Outcome("port stolen", "nothing", 0.1, 0.2, problem="lost"),
        Outcome("port stolen", "nothing", 0.1, 4.0),
    ]
    _, disk, port = faults.rows(found)
    assert disk[-2:] == ["0.90", "met"]
    assert port[-1] == "FAILED" and "0.20" in port


def test_a_service_that_does_not_come_is_named() -> None:
    def absent() -> None:
        raise ConnectionRefusedError("nobody")

    with pytest.raises(FaultError, match=r"no web viewer after 0.05 s \(ConnectionRefusedError"):
        faults.seconds_until(absent, "web viewer", 0.05)
