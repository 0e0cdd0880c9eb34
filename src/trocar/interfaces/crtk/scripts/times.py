"""Times and durations as scripts know them: rospy's attributes, and the names ROS 2 gives them."""

from __future__ import annotations

from collections.abc import Callable
from functools import total_ordering
from typing import Any, Self

SECOND = 1_000_000_000


def nanoseconds(secs: float, nsecs: float = 0) -> int:
    """Return whole nanoseconds of seconds and nanoseconds [ns]."""
    if isinstance(secs, float):
        return round(secs * SECOND) + int(nsecs)
    return int(secs) * SECOND + int(nsecs)


@total_ordering
class Ticks:
    """A number of nanoseconds.

    Args:
        secs: seconds; a float may have a fraction
        nsecs: nanoseconds more
    """

    __slots__ = ("nanoseconds",)

    def __init__(self, secs: float = 0, nsecs: float = 0) -> None:
        self.nanoseconds = nanoseconds(secs, nsecs)

    @classmethod
    def of(cls, whole_ns: int) -> Self:
        """Return one of so many nanoseconds."""
        made = cls()
        made.nanoseconds = whole_ns
        return made

    @classmethod
    def from_sec(cls, seconds: float) -> Self:
        """Return one of so many seconds."""
        return cls(float(seconds))

    @property
    def secs(self) -> int:
        """Whole seconds."""
        return self.nanoseconds // SECOND

    @secs.setter
    def secs(self, value: int) -> None:
        self.nanoseconds = int(value) * SECOND + self.nsecs

    @property
    def nsecs(self) -> int:
        """Nanoseconds beside the whole seconds."""
        return self.nanoseconds % SECOND

    @nsecs.setter
    def nsecs(self, value: int) -> None:
        self.nanoseconds = self.secs * SECOND + int(value)

    sec, nanosec = secs, nsecs

    def to_sec(self) -> float:
        """Return seconds."""
        return self.nanoseconds / SECOND

    def to_nsec(self) -> int:
        """Return nanoseconds."""
        return self.nanoseconds

    def is_zero(self) -> bool:
        """Tell whether it is zero, which as a stamp means "invalid"."""
        return self.nanoseconds == 0

    def _kind(self) -> type[Ticks]:
        """Return what it can be compared with."""
        return Duration if isinstance(self, Duration) else Time

    def __bool__(self) -> bool:
        return self.nanoseconds != 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, self._kind()) and other.nanoseconds == self.nanoseconds

    def __lt__(self, other: Any) -> bool:
        if not isinstance(other, self._kind()):
            return NotImplemented
        return self.nanoseconds < other.nanoseconds

    def __hash__(self) -> int:
        return hash((self._kind().__name__, self.nanoseconds))

    def __repr__(self) -> str:
        return f"{type(self).__name__}[{self.nanoseconds}]"


class Duration(Ticks):
    """A length of time."""

    __slots__ = ()

    def __add__(self, other: Any) -> Any:
        if isinstance(other, Ticks):
            return type(other).of(self.nanoseconds + other.nanoseconds)
        return NotImplemented

    def __sub__(self, other: Any) -> Duration:
        if isinstance(other, Duration):
            return Duration.of(self.nanoseconds - other.nanoseconds)
        return NotImplemented

    def __mul__(self, factor: float) -> Duration:
        return Duration.of(round(self.nanoseconds * factor))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        if isinstance(other, Duration):
            return self.nanoseconds / other.nanoseconds
        return Duration.of(round(self.nanoseconds / other))

    def __neg__(self) -> Duration:
        return Duration.of(-self.nanoseconds)

    def __abs__(self) -> Duration:
        return Duration.of(abs(self.nanoseconds))


class Time(Ticks):
    """A moment."""

    __slots__ = ()

    def __add__(self, other: Any) -> Time:
        if isinstance(other, Duration):
            return Time.of(self.nanoseconds + other.nanoseconds)
        return NotImplemented

    def __sub__(self, other: Any) -> Any:
        if isinstance(other, Time):
            return Duration.of(self.nanoseconds - other.nanoseconds)
        if isinstance(other, Duration):
            return Time.of(self.nanoseconds - other.nanoseconds)
        return NotImplemented


class Rate:
    """Keep a loop to a frequency, as rospy's does: late turns are caught up, old ones let go.

    Args:
        rate_hz: how often
        now_ns: tells the time [ns]
        sleep: waits for some seconds
    """

    def __init__(
        self, rate_hz: float, now_ns: Callable[[], int], sleep: Callable[[float], None]
    ) -> None:
        if not rate_hz > 0.0:
            raise ValueError(f"rate: got {rate_hz} Hz; allowed: above 0 Hz")
        self._period = round(SECOND / rate_hz)
        self._now, self._sleep = now_ns, sleep
        self._last = now_ns()

    def remaining(self) -> Duration:
        """Return how long it is until the next turn is due."""
        return Duration.of(self._period - (self._now() - self._last))

    def sleep(self) -> None:
        """Return when the next turn is due."""
        left = self._period - (self._now() - self._last)
        if left > 0:
            self._sleep(left / SECOND)
        self._last += self._period
        if self._now() - self._last > 2 * self._period:
            self._last = self._now()
