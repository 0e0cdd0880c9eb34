"""Interfaces to a running simulation: the real-time loop, CRTK, and the web viewer.

`loop.py` owns the only thread boundary and the wall clock. Interfaces post commands to the loop and
read its frozen states; they never touch the physics.
"""

from trocar.interfaces.inbox import Command
from trocar.interfaces.loop import Loop
from trocar.interfaces.state import LoopState

__all__ = ["Command", "Loop", "LoopState"]
