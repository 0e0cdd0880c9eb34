"""What a program on the other side of a transport is to the benchmark."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

STATE, JOINTS, ORDER, SERVO = (
    f"/PSM1/{key}" for key in ("operating_state", "measured_js", "state_command", "servo_jp")
)


class Peer(Protocol):
    """A program on the other side of a transport."""

    def hear(self, topic: str, told: Callable[[Any, int], None]) -> None:
        """Call `told` with each message, in whatever form, and when it arrived [ns]."""
        ...

    def stamp(self, message: Any) -> int:
        """Return a message's header stamp [ns]."""
        ...

    def joints(self, message: Any) -> Sequence[float]:
        """Return the positions of a JointState."""
        ...

    def homed(self, message: Any) -> bool:
        """Return is_homed of an OperatingState."""
        ...

    def order(self, verb: str) -> None:
        """Send PSM1 a state_command."""
        ...

    def servo(self, position: Sequence[float]) -> None:
        """Send PSM1 a servo_jp."""
        ...
