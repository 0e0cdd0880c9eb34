"""Interfaces to a running simulation: the real-time loop, CRTK, and the web viewer.

`loop.py` owns the only thread boundary and the wall clock. Interfaces post commands to the loop and
read its frozen states; they never touch the physics.
"""

from trocar.live.inbox import Command
from trocar.live.loop import Loop
from trocar.live.state import LoopState

__all__ = ["Command", "Loop", "LoopState"]
