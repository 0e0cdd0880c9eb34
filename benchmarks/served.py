"""A simulator in a process of its own, as `trocar sim` serves it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, cast

from trocar.errors import TrocarError

#: Time limit of the start. [s]
READY_S = 60.0


class Served:
    """A running simulator, with the address that it printed."""

    def __init__(self, process: subprocess.Popen[str], address: str) -> None:
        self._process, self.address = process, address

    def processor_s(self) -> float:
        """Return the processor time that it has used [s]; 0 without /proc."""
        with suppress(OSError):
            stat = Path(f"/proc/{self._process.pid}/stat").read_text(encoding="utf-8")
            fields = stat.rpartition(")")[2].split()
            return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return 0.0

    def memory_mb(self) -> float:
        """Return its resident memory [MB]; 0 without /proc."""
        with suppress(OSError):
            status = Path(f"/proc/{self._process.pid}/status").read_text(encoding="utf-8")
            held = re.search(r"VmRSS:\s+(\d+) kB", status)
            return float(held.group(1)) / 1024.0 if held else 0.0
        return 0.0


@contextmanager
def served(
    words: Sequence[str], address: str, environment: Mapping[str, str] | None = None
) -> Iterator[Served]:
    """Run `trocar sim` with options `words` until the block ends.

    Args:
        words: options
        address: regular expression of the address in the first line of stdout that matches
        environment: variables added to this process's

    Raises:
        TrocarError: it ended, or printed no address in time
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "trocar", "sim", *words],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **(environment or {})},
    )
    late = threading.Timer(READY_S, process.kill)
    late.start()
    try:
        lines = cast(IO[str], process.stdout)
        found = next((match for line in lines if (match := re.search(address, line))), None)
        late.cancel()
        if found is None:
            code = process.wait()
            raise TrocarError(
                f"trocar sim ended with exit code {code} and printed no address like {address!r}"
            )
        yield Served(process, found.group(0))
    finally:
        late.cancel()
        process.terminate()
        try:
            process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
