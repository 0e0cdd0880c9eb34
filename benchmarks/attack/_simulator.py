"""Run `trocar` with a wall clock that SIGUSR1 sets back by an hour.

The machine's clock belongs to every program on it and is left alone: set back is what Python code
in this process reads from `time.time` and `time.time_ns`. Libraries in C read the machine's.
rospy, which belongs to the system's Python, can be imported behind everything else.

    python -m benchmarks.attack._simulator sim --ros1
"""

from __future__ import annotations

import signal
import sys
import time

HOUR_NS = 3_600_000_000_000
ROSPY = "/usr/lib/python3/dist-packages"


def main() -> int:
    """Run the command line, and return its exit status."""
    machine_ns, back_ns = time.time_ns, 0

    def set_back(*_: object) -> None:
        nonlocal back_ns
        back_ns += HOUR_NS

    time.time_ns = lambda: machine_ns() - back_ns
    time.time = lambda: 1e-9 * time.time_ns()
    signal.signal(signal.SIGUSR1, set_back)
    sys.path.append(ROSPY)
    from trocar.cli import main as trocar  # after the clock: it keeps references to it

    return trocar(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
