"""Who talks to the simulation: the real-time loop, and the interfaces that post commands to it.

`loop.py` owns the only thread boundary and the wall clock. Interfaces (the browser page, CRTK,
later gym) know the loop and the World's frozen answers; they never touch the physics itself.
"""

from trocar.interfaces.commands import (
    Brakes,
    Command,
    ExchangeTool,
    GripperSqueezeTo,
    Hold,
    JawMove,
    JawServo,
    JawServoJf,
    MoveJp,
    MoveTo,
    Pause,
    Reset,
    Resume,
    ServoJf,
    ServoJp,
    SetGains,
    SetGravityCompensation,
    SetMode,
    Step,
    Verb,
)
from trocar.interfaces.loop import Loop
from trocar.interfaces.state import LoopState

__all__ = [
    "Brakes",
    "Command",
    "ExchangeTool",
    "GripperSqueezeTo",
    "Hold",
    "JawMove",
    "JawServo",
    "JawServoJf",
    "Loop",
    "LoopState",
    "MoveJp",
    "MoveTo",
    "Pause",
    "Reset",
    "Resume",
    "ServoJf",
    "ServoJp",
    "SetGains",
    "SetGravityCompensation",
    "SetMode",
    "Step",
    "Verb",
]
