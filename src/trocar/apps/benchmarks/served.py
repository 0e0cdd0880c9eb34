"""A simulator in a process of its own, as `trocar sim` serves it, for the benchmarks."""

from __future__ import annotations

import os
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, cast

from trocar.errors import TrocarError

#: A simulator that serves nothing by then never will. Source: our own choice. [s]
READY_S = 60.0
#: Clock ticks of a process's times. Source: POSIX.
TICKS_PER_SECOND = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100
SIMULATE = "import sys; from trocar.cli import main; sys.exit(main())"


class Served:
    """A running simulator.

    Attributes:
        address: where it serves, as it printed it
    """

    def __init__(self, process: subprocess.Popen[str], address: str) -> None:
        self._process, self.address = process, address

    def processor_s(self) -> float:
        """Return the processor time that it has used [s]; 0 where the system does not tell."""
        stat = Path(f"/proc/{self._process.pid}/stat")
        if not stat.is_file():
            return 0.0
        fields = stat.read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS_PER_SECOND

    def memory_mb(self) -> float:
        """Return the memory that it holds [MB]; 0 where the system does not tell."""
        status = Path(f"/proc/{self._process.pid}/status")
        if not status.is_file():
            return 0.0
        held = re.search(r"VmRSS:\s+(\d+) kB", status.read_text(encoding="utf-8"))
        return float(held.group(1)) / 1024.0 if held else 0.0


@contextmanager
def served(
    words: Sequence[str], address: str, environment: Mapping[str, str] | None = None
) -> Iterator[Served]:
    """Run `trocar sim` with some options until the block ends.

    Args:
        words: options
        environment: is added to this process's
        address: a regular expression; the first line of stdout that it is found in has the address

    Raises:
        TrocarError: it ended, or printed no address in time
    """
    process = subprocess.Popen(
        [sys.executable, "-c", SIMULATE, "sim", *words],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **(environment or {})},
    )
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    out = cast(IO[str], process.stdout)  # it is a pipe
    reader = threading.Thread(target=lambda: [lines.put(line) for line in out], daemon=True)
    reader.start()
    try:
        yield Served(process, _address(lines, process, address))
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        reader.join()
        out.close()


def _address(lines: queue.SimpleQueue[str], process: subprocess.Popen[str], form: str) -> str:
    end = time.monotonic() + READY_S
    while time.monotonic() < end:
        try:
            line = lines.get(timeout=0.1)
        except queue.Empty:
            if process.poll() is not None:
                raise TrocarError(f"trocar sim ended with exit code {process.returncode}") from None
            continue
        if found := re.search(form, line):
            return found.group(0)
    raise TrocarError(f"trocar sim printed no address like {form!r} within {READY_S:g} s")
