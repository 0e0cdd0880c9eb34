"""What a program on the other side of a transport is to the benchmark."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

STATE, JOINTS, ORDER, SERVO = (
    f"/PSM1/{key}" for key in ("operating_state", "measured_js", "state_command", "servo_jp")
)


#: Takes a topic, a message and when it arrived [ns].
Told = Callable[[str, Any, int], None]


class Peer(Protocol):
    """A program on the other side of a transport."""

    def hear(self, topics: Sequence[str], told: Told) -> None:
        """Call `told` with each topic's messages, in whatever form, and when they arrived [ns]."""
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
