"""Whether arms are ready for teleoperation, and asking them to be."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trocar.simulation.arm import Arm


def why_arm_not_ready(arm: Arm) -> str:
    """Return what keeps an arm from being used, "" when nothing does."""
    state = arm.operating_state()
    if state.state != "ENABLED":
        return f'{arm.name} is not in state "ENABLED" but "{state.state}"'
    return "" if state.is_homed else f"{arm.name} is not homed"


def ask_to_be_ready(arm: Arm) -> None:
    """Enable and home an arm where it needs that; homing takes a while."""
    state = arm.operating_state()
    if state.state == "PAUSED":
        arm.resume()
    elif state.state != "ENABLED":
        arm.enable()
    if not state.is_homed and not state.is_busy:
        arm.home()
