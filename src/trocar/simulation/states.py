"""Operating states as CRTK names them, which of them lets an arm move, and homing.

Source: collaborative-robotics documentation, robot operating states; dVRK arm components.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.moves import Motion

Array = NDArray[np.float64]

#: How near measured positions must be. Source: mtsIntuitiveResearchKitPSM.cpp (3 degrees); our own
#: choice for slides. [rad], [m]
NEAR_RAD = float(np.deg2rad(3.0))
NEAR_M = 0.003
#: How long they may take after the set-points arrived. Source: our own choice. [s]
PATIENCE_S = 2.0

State = Literal["DISABLED", "ENABLED", "PAUSED", "FAULT"]


@dataclass(frozen=True)
class OperatingState:
    """What an arm is up to at a time [s].

    Attributes:
        state: DISABLED (no power), ENABLED, PAUSED (holds, takes no commands) or FAULT
        is_homed: whether its position is known and it was brought home
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
    """The state machine of one arm; it is independent of motors.

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

    @property
    def ready(self) -> bool:
        """Whether motion commands are accepted."""
        return self.homed and self.state == "ENABLED"

    def why_not_ready(self) -> str:
        """Return why motion commands are rejected, "" when they are not."""
        if self.state == "PAUSED":
            return "the arm is PAUSED; resume it first"
        if self.state != "ENABLED":
            return f"the arm is {self.state}; enable it first"
        return "" if self.homed else "the arm is not homed; home it first"

    def why_not(self, command: str) -> str:
        """Return why a state command is rejected, "" when it is not."""
        required: dict[str, tuple[State, ...]] = {
            "pause": ("ENABLED",),
            "resume": ("PAUSED",),
            "home": ("DISABLED", "ENABLED"),
        }
        allowed = required.get(command, (self.state,))
        if self.state in allowed:
            return ""
        return f"the arm is {self.state}; allowed when {' or '.join(allowed)}"


class Homing:
    """A homing under way.

    Attributes:
        motion: what the caller waits for
        way: the move of the set-points
    """

    def __init__(self, motion: Motion, way: Motion, slides: NDArray[np.bool_]) -> None:
        self.motion = motion
        self.way = way
        self._near = np.where(slides, NEAR_M, NEAR_RAD)
        self._arrived = np.inf

    def look(self, measured: Array, time: float) -> Literal["", "home", "stopped", "late"]:
        """Return how it ended, "" while it has not. `measured` is (n,) [rad or m]."""
        if not self.way.done:
            return ""
        if not self.way.goal_reached:
            return "stopped"
        self._arrived = min(self._arrived, time)
        if not self.far(measured).any():
            return "home"
        return "late" if time - self._arrived > PATIENCE_S else ""

    def far(self, measured: Array) -> NDArray[np.bool_]:
        """Return which joints are not home, (n,)."""
        return np.abs(measured - self.way.goal) > self._near
