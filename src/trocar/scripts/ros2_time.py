"""Times, durations and clocks of rclpy, over a simulation.

Source of names and behaviour: rclpy's public documentation (ROS 2 Humble and Jazzy).
"""

from __future__ import annotations

from enum import IntEnum
from functools import total_ordering
from typing import Any, ClassVar

from trocar.messages.types import SECOND
from trocar.scripts.messages import BuiltinDuration, BuiltinTime
from trocar.scripts.simulation import Flow


class ClockType(IntEnum):
    """The clock that a time was read from."""

    UNINITIALIZED = 0
    ROS_TIME = 1
    SYSTEM_TIME = 2
    STEADY_TIME = 3


def _whole_ns(seconds: float, nanoseconds: float) -> int:
    return int(seconds * SECOND) + int(nanoseconds)


@total_ordering
class RclDuration:
    """A length of time."""

    __slots__ = ("nanoseconds",)

    def __init__(self, *, seconds: float = 0, nanoseconds: float = 0) -> None:
        self.nanoseconds = _whole_ns(seconds, nanoseconds)

    def to_msg(self) -> BuiltinDuration:
        """Return a builtin_interfaces/Duration."""
        sec, nanosec = divmod(self.nanoseconds, SECOND)
        return BuiltinDuration(sec=sec, nanosec=nanosec)

    @classmethod
    def from_msg(cls, msg: BuiltinDuration) -> RclDuration:
        """Return the duration of a builtin_interfaces/Duration."""
        return cls(nanoseconds=msg.sec * SECOND + msg.nanosec)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RclDuration) and other.nanoseconds == self.nanoseconds

    def __lt__(self, other: Any) -> bool:
        if not isinstance(other, RclDuration):
            return NotImplemented
        return self.nanoseconds < other.nanoseconds

    def __hash__(self) -> int:
        return hash(("duration", self.nanoseconds))

    def __repr__(self) -> str:
        return f"Duration(nanoseconds={self.nanoseconds})"


@total_ordering
class RclTime:
    """A moment of a clock."""

    __slots__ = ("clock_type", "nanoseconds")

    def __init__(
        self,
        *,
        seconds: float = 0,
        nanoseconds: float = 0,
        clock_type: ClockType = ClockType.SYSTEM_TIME,
    ) -> None:
        self.nanoseconds = _whole_ns(seconds, nanoseconds)
        if self.nanoseconds < 0:
            raise ValueError("Seconds value must not be negative")
        self.clock_type = clock_type

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """Return whole seconds, and nanoseconds beside them."""
        return divmod(self.nanoseconds, SECOND)

    def to_msg(self) -> BuiltinTime:
        """Return a builtin_interfaces/Time."""
        sec, nanosec = self.seconds_nanoseconds()
        return BuiltinTime(sec=sec, nanosec=nanosec)

    @classmethod
    def from_msg(cls, msg: BuiltinTime, clock_type: ClockType = ClockType.ROS_TIME) -> RclTime:
        """Return the moment of a builtin_interfaces/Time."""
        return cls(nanoseconds=msg.sec * SECOND + msg.nanosec, clock_type=clock_type)

    def __add__(self, other: Any) -> RclTime:
        if not isinstance(other, RclDuration):
            return NotImplemented
        moved = self.nanoseconds + other.nanoseconds
        return type(self)(nanoseconds=moved, clock_type=self.clock_type)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        if isinstance(other, RclTime):
            self._check(other)
            return RclDuration(nanoseconds=self.nanoseconds - other.nanoseconds)
        if isinstance(other, RclDuration):
            moved = self.nanoseconds - other.nanoseconds
            return type(self)(nanoseconds=moved, clock_type=self.clock_type)
        return NotImplemented

    def _check(self, other: RclTime) -> None:
        if other.clock_type != self.clock_type:
            raise TypeError("Can't compare times with different clock types")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RclTime):
            return NotImplemented
        self._check(other)
        return self.nanoseconds == other.nanoseconds

    def __lt__(self, other: Any) -> bool:
        if not isinstance(other, RclTime):
            return NotImplemented
        self._check(other)
        return self.nanoseconds < other.nanoseconds

    def __hash__(self) -> int:
        return hash((self.clock_type, self.nanoseconds))

    def __repr__(self) -> str:
        kind = self.clock_type.name
        return f"Time(nanoseconds={self.nanoseconds}, clock_type={kind})"


class RclClock:
    """A clock; all kinds of them show the time of stamps.

    Args:
        clock_type: as the times that it gives
    """

    run: ClassVar[Any]
    flow: ClassVar[Flow]

    def __init__(self, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> None:
        self.clock_type = clock_type
        self.ros_time_is_active = False

    def now(self) -> RclTime:
        """Return the time."""
        self.flow.look()
        return RclTime(nanoseconds=self.flow.now_ns(), clock_type=self.clock_type)

    def sleep_until(self, until: RclTime, context: Any = None) -> bool:  # noqa: ARG002
        """Wait for a moment; return whether the context was valid all the time."""
        left = (until - self.now()).nanoseconds / SECOND
        if left > 0.0:
            self.flow.wait(lambda: not self.run.default_context.valid, left)
        return self.run.default_context.valid

    def sleep_for(self, rel_time: RclDuration, context: Any = None) -> bool:
        """Let some time pass; return whether the context was valid all the time."""
        return self.sleep_until(self.now() + rel_time, context)


class RclRosClock(RclClock):
    """The clock of a node."""

    def __init__(self) -> None:
        super().__init__(clock_type=ClockType.ROS_TIME)
