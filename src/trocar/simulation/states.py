"""Operating states as CRTK names them, and which of them lets an arm move.

Source: collaborative-robotics documentation, robot operating states; dVRK arm components.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["DISABLED", "ENABLED", "PAUSED", "FAULT"]


@dataclass(frozen=True)
class OperatingState:
    """What an arm is up to at a time [s].

    Attributes:
        state: DISABLED (no power), ENABLED, PAUSED (holds, takes no commands) or FAULT
        is_homed: whether it knows where it is and was brought home
        is_busy: whether a move or the homing is under way
    """

    state: State
    is_homed: bool
    is_busy: bool
    time: float

    @property
    def ready(self) -> bool:
        """Whether motion commands are accepted."""
        return self.state == "ENABLED" and self.is_homed


class States:
    """The state machine of one arm; it knows nothing of motors.

    Attributes:
        state: the operating state
        homed: whether the arm was homed
    """

    def __init__(self) -> None:
        self.state: State = "DISABLED"
        self.homed = False

    def begin(self, ready: bool) -> None:
        """Start anew: enabled and homed, or as the hardware does after power-on."""
        self.state = "ENABLED" if ready else "DISABLED"
        self.homed = ready

    @property
    def powered(self) -> bool:
        """Whether the motors have power."""
        return self.state in ("ENABLED", "PAUSED")

    def why_not_ready(self) -> str:
        """Say why motion commands are refused, "" when they are not."""
        if self.state == "PAUSED":
            return "the arm is PAUSED; resume it first"
        if self.state != "ENABLED":
            return f"the arm is {self.state}; enable it first"
        return "" if self.homed else "the arm is not homed; home it first"

    def why_not(self, command: str) -> str:
        """Say why a state command is refused, "" when it is not."""
        wanted: dict[str, tuple[State, ...]] = {
            "pause": ("ENABLED",),
            "resume": ("PAUSED",),
            "home": ("DISABLED", "ENABLED"),
        }
        allowed = wanted.get(command, (self.state,))
        if self.state in allowed:
            return ""
        return f"the arm is {self.state}; allowed when {' or '.join(allowed)}"
