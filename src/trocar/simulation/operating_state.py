"""The operating state of an arm, as the dVRK's own software has it, without motors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.moves import Motion

Array = NDArray[np.float64]

State = Literal["DISABLED", "ENABLED", "PAUSED", "FAULT"]
#: Phases of an arm within its state: ENABLED until it is homed, HOMING, then HOMED.
Phase = Literal["DISABLED", "ENABLED", "HOMING", "HOMED", "PAUSED", "FAULT"]
Desired = Literal["DISABLED", "ENABLED", "HOMED", "PAUSED", "FAULT"]

STATE_COMMANDS = ("enable", "disable", "home", "unhome", "pause", "resume")
#: {state: commands that it accepts}. Source: cisst, prmOperatingState.cpp:22-100.
ACCEPTED: Mapping[State, tuple[str, ...]] = {
    "DISABLED": ("enable", "disable", "unhome"),
    "ENABLED": ("enable", "disable", "pause", "unhome", "home"),
    "PAUSED": ("disable", "pause", "resume", "unhome"),
    "FAULT": ("enable", "disable", "unhome"),
}
#: {phase: state}. Source: SAW, mtsIntuitiveResearchKitArm.cpp:1146-1370, the Enter callbacks.
STATE: Mapping[Phase, State] = {
    "DISABLED": "DISABLED",
    "ENABLED": "ENABLED",
    "HOMING": "ENABLED",
    "HOMED": "ENABLED",
    "PAUSED": "PAUSED",
    "FAULT": "FAULT",
}
#: {phase: why no command may move the arm}, of an arm that is not HOMED.
NOT_READY: Mapping[Phase, str] = {
    "DISABLED": "the arm is DISABLED; enable and home it first",
    "ENABLED": "the arm is not homed; home it first",
    "HOMING": "the arm is on its way home; wait until it is there",
    "HOMED": "the arm was unhomed; disable, enable and home it first",
    "PAUSED": "the arm is PAUSED; resume it first",
    "FAULT": "the arm is in FAULT; disable, enable and home it first",
}


@dataclass(frozen=True)
class OperatingState:
    """CRTK's operating state of an arm at a time [s].

    Attributes:
        state: DISABLED (no power), ENABLED, PAUSED (holds, takes no commands) or FAULT
        is_homed: whether its position is known, as the robot publishes it: also on the way home
            and right after it was disabled
        is_busy: whether a move or the homing is under way
        phase: what it does within the state
    """

    state: State
    is_homed: bool
    is_busy: bool
    time: float
    phase: Phase

    @property
    def ready(self) -> bool:
        """Whether motion commands are accepted."""
        return self.phase == "HOMED" and self.is_homed


class States:
    """The state machine of one arm.

    Source: SAW, mtsIntuitiveResearchKitArm.cpp:82-182 (its states), :455-535 (commands),
    :1120-1420 (what each state publishes as it is entered); mtsIntuitiveResearchKitPSM.cpp:799.

    Attributes:
        phase: within the operating state
        desired: where the last accepted command or a fault leads, as `desired_state` has it
        known: whether positions are known: since a homing, until `unhome`
        homed: whether the arm is homed, as it is published
        ready: whether motion commands are accepted
        resumes: phase and desired state that `resume` returns to
    """

    def __init__(self) -> None:
        self.phase: Phase = "DISABLED"
        self.desired: Desired = "DISABLED"
        self.known = self.homed = self.ready = False
        self.resumes: tuple[Phase, Desired] = "DISABLED", "DISABLED"

    def begin(self, ready: bool) -> None:
        """Start anew: enabled and homed, or as the hardware does after power-on."""
        self.phase, self.desired = ("HOMED", "HOMED") if ready else ("DISABLED", "DISABLED")
        self.known = self.homed = self.ready = ready
        self.resumes = self.phase, self.desired

    @property
    def state(self) -> State:
        """The operating state."""
        return STATE[self.phase]

    @property
    def powered(self) -> bool:
        """Whether the motors have power."""
        return self.phase not in ("DISABLED", "FAULT")

    def forget(self) -> None:
        """Make positions unknown, and the arm not homed."""
        self.known = self.homed = self.ready = False

    def why_not_ready(self) -> str:
        """Return the reason to reject motion commands, "" without one."""
        if self.ready:
            return ""
        if self.phase == "ENABLED" and self.known:  # SAW, Arm.cpp:1487: moves run in HOMED only
            return (
                "the arm is not homed since it was enabled; home it first (the robot would accept"
                " the command, stay busy and never move)"
            )
        return NOT_READY[self.phase]

    def why_not(self, command: str) -> str:
        """Return the reason to reject a state command, "" without one."""
        accepted = ACCEPTED[self.state]
        if command in accepted:
            return ""
        phase = self.state if self.phase in ("ENABLED", self.state) else self.phase
        return f"not supported in state {self.state} ({phase}); allowed: {', '.join(accepted)}"

    def enter(self, phase: Phase, known: bool = False) -> None:
        """Go to a phase, and publish what it makes of `homed`; positions may be known from then on.

        The robot computes it from its power as it is before the phase is entered: an arm that is
        disabled stays homed until it is disabled again or enabled.
        """
        off = self.phase == "DISABLED"
        self.phase = phase
        self.known |= known
        self.homed = self.known and not off
        self.ready = phase == "HOMED" and self.known


#: Tolerances of measured positions. Source: mtsIntuitiveResearchKitPSM.cpp (3 degrees); our own
#: choice for slides. [rad], [m]
NEAR_RAD = float(np.deg2rad(3.0))
NEAR_M = 0.003
#: Time from the begin of a homing to the release of an arm's brakes. Source: SAW,
#: mtsIntuitiveResearchKitArm.cpp:1381; brakeReleaseTime of dvrk-io-config-generator.py. [s]
RELEASE_S = 0.5
#: Longest time to reach them after the set-points arrived. Source: our own choice. [s]
PATIENCE_S = 2.0


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

    def look(self, measured: Array, time: float) -> Literal["", "home", "late"]:
        """Return the outcome, "" while under way. `measured` is (n,) [rad or m]."""
        if not self.way.done:
            return ""
        self._arrived = min(self._arrived, time)
        if not self.far(measured).any():
            return "home"
        return "late" if time - self._arrived > PATIENCE_S else ""

    def far(self, measured: Array) -> NDArray[np.bool_]:
        """Return a mask of the joints that are not home, (n,)."""
        return np.abs(measured - self.way.goal[: len(measured)]) > self._near
