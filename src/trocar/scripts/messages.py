"""Messages, times and durations as scripts use them, made from the transports' definitions.

A script of ROS 1 or of ROS 2 has the names and attributes of its edition; `fields_of` and
`message_of` turn its messages into the core's dicts and back. Times of ROS 1 have rospy's
attributes, and the names that ROS 2 gives them.
"""

# Public attributes of genpy's classes begin with an underscore.
# pyright: reportPrivateUsage=false

from __future__ import annotations

import operator
from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import cache, total_ordering
from typing import Any, ClassVar, Literal, Self, cast

import numpy as np

from trocar.messages import Field, MessageType, ServiceType, service_type
from trocar.messages.types import SCALARS, SECOND
from trocar.scripts.more_types import script_type

#: Edition of ROS that a script is written for.
Edition = Literal[1, 2]


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
    _edition: ClassVar[Edition] = 1
    #: Fields with their names in this edition.
    _named: ClassVar[tuple[tuple[Field, str], ...]] = ()

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
        for field, name in self._named:
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


class Ros2Message(Message):
    """The base of messages of ROS 2: fields by name only, checked when they are set.

    Source of the checks: rosidl_generator_py of ROS 2 Humble; sequences of numbers may be arrays of
    numpy, as since Jazzy.
    """

    __slots__ = ()
    _edition: ClassVar[Edition] = 2
    #: {name: converts a value that is set}
    _checks: ClassVar[Mapping[str, Callable[[Any], Any]]]

    def __init__(self, **named: Any) -> None:
        """Take some fields by name; the others are zero, empty or false."""
        unknown = named.keys() - self._checks.keys() - {"check_fields"}
        if unknown:
            raise AssertionError(
                f"Invalid arguments passed to constructor: {self._type} has no field"
                f" {min(unknown)!r}; known: {', '.join(self.__slots__)}"
            )
        for field, name in self._named:
            if name in named:
                setattr(self, name, named[name])
            else:
                object.__setattr__(self, name, _blank_ros2(field))

    def __setattr__(self, name: str, value: Any) -> None:
        check = self._checks.get(name)
        if check is None:
            raise AttributeError(
                f"{self._type} has no field {name!r}; known: {', '.join(self.__slots__)}"
            )
        try:
            object.__setattr__(self, name, check(value))
        except (TypeError, ValueError, OverflowError) as problem:
            raise AssertionError(f"{self._type}: field {name!r}: {problem}") from problem

    def __repr__(self) -> str:
        package, _, own = self._type.partition("/")
        inside = ", ".join(f"{name}={getattr(self, name)!r}" for name in self.__slots__)
        return f"{package}.msg.{own}({inside})"

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Return {field: its type, such as "sequence<double>"}."""
        return {name: _ros2_type(field) for field, name in cls._named}


class BuiltinTime(Ros2Message):
    """builtin_interfaces/Time: seconds and nanoseconds of a stamp."""

    __slots__ = ("nanosec", "sec")
    _type = "builtin_interfaces/Time"

    def __init__(self, *, sec: int = 0, nanosec: int = 0) -> None:
        self.sec, self.nanosec = sec, nanosec

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, BuiltinTime) or other._type != self._type:
            return False
        return (other.sec, other.nanosec) == (self.sec, self.nanosec)

    __hash__ = Message.__hash__

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Return {field: its type}."""
        return {"sec": "int32", "nanosec": "uint32"}


class BuiltinDuration(BuiltinTime):
    """builtin_interfaces/Duration."""

    __slots__ = ()
    _type = "builtin_interfaces/Duration"


STAMPS = {"time": BuiltinTime, "duration": BuiltinDuration}
BuiltinTime._checks = {"sec": operator.index, "nanosec": operator.index}


def message_class(name: str, edition: Edition = 1) -> type[Message]:
    """Return the class of a type of messages, such as "sensor_msgs/JointState".

    Raises:
        UnknownNameError: there is no such type
    """
    return _message_class(name, edition)  # the same class, however it is called


@cache
def _message_class(name: str, edition: Edition) -> type[Message]:
    return _class_of(script_type(name), "msg", edition)


def service_class(name: str, edition: Edition = 1) -> type:
    """Return the class of a service; `Request` and `Response` are those of its messages.

    Raises:
        UnknownNameError: there is no such type
    """
    return _service_class(name, edition)


@cache
def _service_class(name: str, edition: Edition) -> type:
    kind: ServiceType = service_type(name)
    package, own = kind.name.split("/")
    request = _class_of(kind.request, "srv", edition)
    response = _class_of(kind.response, "srv", edition)
    members = {
        "__module__": f"{package}.srv",
        "__doc__": f"The service {kind.name}.",
        "_type": kind.name,
        "_md5sum": kind.md5,
        **dict.fromkeys(("_request_class", "Request"), request),
        **dict.fromkeys(("_response_class", "Response"), response),
    }
    return type(own, (), members)


def _class_of(kind: MessageType, folder: str, edition: Edition) -> type[Message]:
    package, own = kind.name.split("/")
    if edition == 1:
        named = tuple((field, field.ros1_name) for field in kind.fields)
    else:
        named = tuple((field, field.name) for field in kind.fields if not field.only_ros1)
    names = tuple(name for _, name in named)
    members: dict[str, Any] = {
        **{constant.name: constant.value for constant in kind.constants},
        "__slots__": names,
        "__module__": f"{package}.{folder}",
        "__doc__": f"{kind.name}: {', '.join(names) or 'no field'}.",
        "_type": kind.name,
        "_md5sum": kind.md5,
        "_full_text": kind.text_ros1,
        "_kind": kind,
        "_named": named,
    }
    if edition == 1:
        return type(own, (Message,), members)
    members["_checks"] = {name: _check_of(field) for field, name in named}
    return type(own, (Ros2Message,), members)


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


def _blank_ros2(field: Field) -> Any:
    if field.type in STAMPS and field.length is None:
        return STAMPS[field.type]()
    if field.is_message:
        kind, count = message_class(field.type, 2), field.length
        return kind() if count is None else [kind() for _ in range(count)]
    if field.length is None:
        return _blank(field)
    if field.type not in CODES:
        return [_blank(field)] * field.length if field.length else []
    code = CODES[field.type]
    return np.zeros(field.length, code) if field.length else cast(Any, array)(code)


#: Codes of `array` and numpy for the numbers in sequences.
CODES = {name: code for name, code in SCALARS.items() if name != "bool"}


def _check_of(field: Field) -> Callable[[Any], Any]:
    """Return a function that converts a value to a field's, or raises a TypeError."""
    one = _check_of_one(field)
    if field.length is None:
        return one
    code = CODES.get(field.type)
    if code is None or field.is_message or field.type in STAMPS:
        return lambda values: [one(value) for value in values]
    if field.length == 0:
        return lambda values: array(code, bytes(values) if field.type == BYTES else values)

    def numbers(values: Any) -> Any:
        found = np.array(values, dtype=code)
        if found.shape != (field.length,):
            raise TypeError(f"got {found.size} numbers; allowed: {field.length}")
        return found

    return numbers


def _check_of_one(field: Field) -> Callable[[Any], Any]:
    kinds: dict[str, type] = {"string": str, "bool": bool, **STAMPS}
    if field.is_message:
        kind: type = message_class(field.type, 2)
    else:
        kind = kinds.get(field.type, float if "float" in field.type else int)

    def check(value: Any) -> Any:
        if not isinstance(value, kind):
            raise TypeError(f"got {type(value).__name__}; allowed: {kind.__name__}")
        return value

    return check


def _ros2_type(field: Field) -> str:
    words = {"float64": "double", "float32": "float", "bool": "boolean"}
    kind = field.ros2_type.removesuffix(field.brackets)
    name = words.get(kind, kind)
    if field.length is None:
        return name
    return f"{name}[{field.length}]" if field.length else f"sequence<{name}>"


def fields_of(message: Message) -> dict[str, Any]:
    """Return a message as the core has it: a dict in ROS 2's field names, unchecked."""
    return {
        field.name: _plain(field, getattr(message, name))
        for field, name in message._named
        if not field.only_ros1
    }


def _plain(field: Field, value: Any) -> Any:
    if isinstance(value, BuiltinTime):
        return value.sec, value.nanosec
    if field.type in TIMES:
        ns = getattr(value, "nanoseconds", None)
        return value if ns is None else divmod(ns, 1_000_000_000)
    if not field.is_message:
        if isinstance(value, array):
            return value.tobytes() if field.type == BYTES else cast(Any, value).tolist()
        return value.tolist() if isinstance(value, np.ndarray) else value
    if field.length is None:
        return fields_of(value) if isinstance(value, Message) else value
    return [fields_of(one) if isinstance(one, Message) else one for one in value]


def message_of(kind: type[Message], fields: Mapping[str, Any]) -> Any:
    """Return the message that the core's dict is."""
    made = kind.__new__(kind)
    put = object.__setattr__
    for field, name in kind._named:
        if field.only_ros1:
            put(made, name, 0)
        else:
            put(made, name, _rich(field, fields[field.name], kind._edition))
    return made


def _rich(field: Field, value: Any, edition: Edition) -> Any:
    if field.type in TIMES and field.length is None:
        return TIMES[field.type](*value) if edition == 1 else _stamp(field.type, value)
    if field.is_message:
        kind = message_class(field.type, edition)
        if field.length is None:
            return message_of(kind, value)
        return [message_of(kind, one) for one in value]
    if field.length is None:
        return value
    if edition == 2 and field.type in CODES:
        if field.length:
            return np.array(value, CODES[field.type])
        if field.type == BYTES:
            return array("B", bytes(value))
        return array(CODES[field.type], value)
    if field.type == BYTES:
        return bytes(cast(Any, value)) if isinstance(value, np.ndarray) else value
    return value.tolist() if isinstance(value, np.ndarray) else list(value)


def _stamp(kind: str, value: tuple[int, int]) -> BuiltinTime:
    made = STAMPS[kind].__new__(STAMPS[kind])
    object.__setattr__(made, "sec", value[0])
    object.__setattr__(made, "nanosec", value[1])
    return made


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
