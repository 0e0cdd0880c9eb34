"""Threads that let others go first."""

from __future__ import annotations

import os
import sys
import threading
from contextlib import suppress

#: How much less urgent drawing is than all else. Source: our own choice; see nice(2).
NICE = 5


def let_others_go_first() -> None:
    """Make the calling thread, and those that it starts, less urgent than the physics.

    Without a graphics card drawing takes every core that it gets, and the loop would be late.
    """
    if sys.platform == "linux":  # elsewhere this would concern the whole process
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
