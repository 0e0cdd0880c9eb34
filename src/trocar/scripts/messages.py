"""Messages, times and durations as scripts use them, made from the transports' definitions.

A script sees ROS 1's names and attributes; `fields_of` and `message_of` turn its messages into the
core's dicts and back. Times have rospy's attributes, and the names that ROS 2 gives them.
"""

# Public attributes of genpy's classes begin with an underscore.
# pyright: reportPrivateUsage=false

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, total_ordering
from typing import Any, ClassVar, Self, cast

import numpy as np

from trocar.messages import Field, MessageType, ServiceType, message_type, service_type
from trocar.messages.types import SECOND


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
        """Return whether it is zero, which as a stamp means "invalid"."""
        return self.nanoseconds == 0

    def _kind(self) -> type[Ticks]:
        """Return the key of comparisons."""
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
    """Keep a loop to a frequency, as rospy's does: late turns are caught up, old ones skipped.

    Args:
        rate_hz: how often
        now_ns: returns the time [ns]
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
        """Return the time until the next turn is due."""
        return Duration.of(self._period - (self._now() - self._last))

    def sleep(self) -> None:
        """Return when the next turn is due."""
        left = self._period - (self._now() - self._last)
        if left > 0:
            self._sleep(left / SECOND)
        self._last += self._period
        if self._now() - self._last > 2 * self._period:
            self._last = self._now()


TIMES = {"time": Time, "duration": Duration}
BYTES = "uint8"


class Message:
    """The base of all classes of messages; its `__slots__` are the fields."""

    __slots__ = ()
    _type: ClassVar[str] = ""
    _md5sum: ClassVar[str] = ""
    _full_text: ClassVar[str] = ""
    _kind: ClassVar[MessageType]

    def __init__(self, *values: Any, **named: Any) -> None:
        """Take every field in order, or some by name; the others are zero, empty or false."""
        names: tuple[str, ...] = self.__slots__
        if values and (named or len(values) != len(names)):
            raise TypeError(
                f"{self._type}: got {len(values)} values; allowed: one for each of"
                f" {', '.join(names) or 'no field'}, or names"
            )
        unknown = named.keys() - set(names)
        if unknown:
            raise AttributeError(
                f"{self._type} has no field {min(unknown)!r}; known: {', '.join(names)}"
            )
        given: dict[str, Any] = dict(zip(names, values, strict=True)) if values else named
        for field in self._kind.fields:
            name = field.ros1_name
            setattr(self, name, given[name] if name in given else _blank(field))

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and fields_of(self) == fields_of(other)  # type: ignore[arg-type]

    def __hash__(self) -> int:
        return id(self)

    def __repr__(self) -> str:
        return "\n".join(_lines(self, ""))

    def serialize(self, buffer: Any) -> None:
        """Raise: messages of a script are not serialised."""
        raise NotImplementedError(f"{self._type}: messages of a script are not serialised")


@cache
def message_class(name: str) -> type[Message]:
    """Return the class of a type of messages, such as "sensor_msgs/JointState".

    Raises:
        UnknownNameError: there is no such type
    """
    return _class_of(message_type(name), "msg")


@cache
def service_class(name: str) -> type:
    """Return the class of a service; `Request` and `Response` are those of its messages.

    Raises:
        UnknownNameError: there is no such type
    """
    kind: ServiceType = service_type(name)
    package, own = kind.name.split("/")
    request, response = _class_of(kind.request, "srv"), _class_of(kind.response, "srv")
    members = {
        "__module__": f"{package}.srv",
        "__doc__": f"The service {kind.name}.",
        "_type": kind.name,
        "_md5sum": kind.md5,
        **dict.fromkeys(("_request_class", "Request"), request),
        **dict.fromkeys(("_response_class", "Response"), response),
    }
    return type(own, (), members)


def _class_of(kind: MessageType, folder: str) -> type[Message]:
    package, own = kind.name.split("/")
    names = tuple(field.ros1_name for field in kind.fields)
    members = {
        **{constant.name: constant.value for constant in kind.constants},
        "__slots__": names,
        "__module__": f"{package}.{folder}",
        "__doc__": f"{kind.name}: {', '.join(names) or 'no field'}.",
        "_type": kind.name,
        "_md5sum": kind.md5,
        "_full_text": kind.text_ros1,
        "_kind": kind,
    }
    return type(own, (Message,), members)


def _blank(field: Field) -> Any:
    if field.length is None:
        if field.is_message:
            return message_class(field.type)()
        if field.type in TIMES:
            return TIMES[field.type]()
        return {"string": "", "bool": False}.get(field.type, 0.0 if "float" in field.type else 0)
    if field.is_message:
        return [message_class(field.type)() for _ in range(field.length)]
    if field.type == BYTES:
        return bytes(field.length)
    return [0.0 if "float" in field.type else 0] * field.length


def fields_of(message: Message) -> dict[str, Any]:
    """Return a message as the core has it: a dict in ROS 2's field names, unchecked."""
    return {
        field.name: _plain(field, getattr(message, field.ros1_name))
        for field in message._kind.fields
        if not field.only_ros1
    }


def _plain(field: Field, value: Any) -> Any:
    if field.type in TIMES:
        ns = getattr(value, "nanoseconds", None)
        return value if ns is None else divmod(ns, 1_000_000_000)
    if not field.is_message:
        return value.tolist() if isinstance(value, np.ndarray) else value
    if field.length is None:
        return fields_of(value) if isinstance(value, Message) else value
    return [fields_of(one) if isinstance(one, Message) else one for one in value]


def message_of(kind: type[Message], fields: Mapping[str, Any]) -> Any:
    """Return the message that the core's dict is."""
    made = kind.__new__(kind)
    for field in kind._kind.fields:
        if field.only_ros1:
            setattr(made, field.ros1_name, 0)
        else:
            setattr(made, field.ros1_name, _rich(field, fields[field.name]))
    return made


def _rich(field: Field, value: Any) -> Any:
    if field.type in TIMES:
        return TIMES[field.type](*value)
    if field.is_message:
        kind = message_class(field.type)
        if field.length is None:
            return message_of(kind, value)
        return [message_of(kind, one) for one in value]
    if field.length is not None and field.type != BYTES:
        return value.tolist() if isinstance(value, np.ndarray) else list(value)
    return value


def _lines(message: Message, indent: str) -> list[str]:
    found: list[str] = []
    for name in message.__slots__:
        value = getattr(message, name)
        if isinstance(value, Message):
            found += [f"{indent}{name}:", *_lines(value, f"{indent}  ")]
        elif isinstance(value, Sequence) and value and isinstance(value[0], Message):
            found.append(f"{indent}{name}:")
            for one in cast(Sequence[Message], value):
                found += [f"{indent}  -", *_lines(one, f"{indent}    ")]
        else:
            found.append(f"{indent}{name}: {value!r}")
    return found
