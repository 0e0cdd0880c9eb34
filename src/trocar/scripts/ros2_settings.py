"""Qualities of service, parameters and loggers of rclpy.

Source of names and values: rclpy's public documentation (ROS 2 Humble and Jazzy).
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum, IntFlag
from typing import Any, ClassVar, cast

from trocar.scripts.ros2_time import RclDuration
from trocar.scripts.simulation import Flow


class HistoryPolicy(IntEnum):
    """Messages that are kept."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2


class ReliabilityPolicy(IntEnum):
    """Whether lost messages are sent again."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(IntEnum):
    """Whether late subscribers get messages of before."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class LivelinessPolicy(IntEnum):
    """Signs of life of a publisher."""

    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_TOPIC = 3


@dataclass
class QoSProfile:
    """Quality of service of a topic or a service; reliable and volatile by default."""

    history: HistoryPolicy = HistoryPolicy.KEEP_LAST
    depth: int = 10
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
    lifespan: RclDuration = field(default_factory=RclDuration)
    deadline: RclDuration = field(default_factory=RclDuration)
    liveliness: LivelinessPolicy = LivelinessPolicy.SYSTEM_DEFAULT
    liveliness_lease_duration: RclDuration = field(default_factory=RclDuration)
    avoid_ros_namespace_conventions: bool = False

    @classmethod
    def of(cls, given: Any) -> QoSProfile:
        """Return a profile; a number is its depth.

        Raises:
            TypeError: neither a profile nor a number
        """
        if isinstance(given, QoSProfile):
            return given
        if isinstance(given, int) and given >= 0:
            return cls(depth=given)
        raise TypeError(
            f"Expected QoSProfile or int, but received {type(given)!r}: got {given!r} as QoS"
        )


def sensor_data() -> QoSProfile:
    """Return the profile of sensors: best effort, five messages."""
    return QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


class ParameterKind(Enum):
    """Type of a parameter."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @classmethod
    def from_parameter_value(cls, value: Any) -> ParameterKind:
        """Return the type of a value.

        Raises:
            TypeError: no parameter can have it
        """
        if value is None:
            return cls.NOT_SET
        for kind, name in SINGLE.items():
            if type(value) is kind:
                return cls[name]
        if isinstance(value, Sequence) or hasattr(value, "typecode"):
            values = list(cast(Sequence[Any], value))
            for kind, name in SINGLE.items():
                if values and all(type(one) is kind for one in values):
                    return cls[f"{name}_ARRAY"]
            if not values or all(isinstance(one, bytes) for one in values):
                return cls.BYTE_ARRAY
        raise TypeError(f"the value {value!r} does not match any parameter type")


SINGLE: dict[type, str] = {bool: "BOOL", int: "INTEGER", float: "DOUBLE", str: "STRING"}


class RclParameter:
    """A parameter of a node.

    Args:
        name: its name
        type_: its type; of the value, when omitted
        value: its value
    """

    Type = ParameterKind

    def __init__(self, name: str, type_: ParameterKind | None = None, value: Any = None) -> None:
        found = ParameterKind.from_parameter_value(value)
        if type_ is not None and value is not None and type_ is not found:
            raise ValueError(f"Type '{type_}' and value '{value}' do not agree")
        self.name, self.value, self.type_ = name, value, type_ or found

    def get_parameter_value(self) -> Any:
        """Return its value as an rcl_interfaces/ParameterValue."""
        made = ParameterValue(type=self.type_.value)
        if self.type_ is not ParameterKind.NOT_SET:
            setattr(made, f"{self.type_.name.lower()}_value", self.value)
        return made


class Record:
    """A message of rcl_interfaces: fields by name."""

    _fields: ClassVar[dict[str, Any]] = {}

    def __init__(self, **named: Any) -> None:
        for name, value in {**self._fields, **named}.items():
            setattr(self, name, list(cast(list[Any], value)) if value == [] else value)

    def __repr__(self) -> str:
        inside = ", ".join(f"{name}={value!r}" for name, value in vars(self).items())
        return f"{type(self).__name__}({inside})"


class ParameterValue(Record):
    """rcl_interfaces/ParameterValue."""

    _fields: ClassVar[dict[str, Any]] = {
        "type": 0, "bool_value": False, "integer_value": 0, "double_value": 0.0, "string_value": "",
        "byte_array_value": [], "bool_array_value": [], "integer_array_value": [],
        "double_array_value": [], "string_array_value": [],
    }  # fmt: skip


class ParameterDescriptor(Record):
    """rcl_interfaces/ParameterDescriptor."""

    _fields: ClassVar[dict[str, Any]] = {
        "name": "", "type": 0, "description": "", "additional_constraints": "", "read_only": False,
        "dynamic_typing": False, "floating_point_range": [], "integer_range": [],
    }  # fmt: skip


class SetParametersResult(Record):
    """rcl_interfaces/SetParametersResult."""

    _fields: ClassVar[dict[str, Any]] = {"successful": False, "reason": ""}


class NumberRange(Record):
    """rcl_interfaces/FloatingPointRange and IntegerRange."""

    _fields: ClassVar[dict[str, Any]] = {"from_value": 0, "to_value": 0, "step": 0}


class ParameterType:
    """rcl_interfaces/ParameterType."""


for _kind in ParameterKind:
    setattr(ParameterType, f"PARAMETER_{_kind.name}", _kind.value)


def value_of(text: str) -> Any:
    """Return a parameter's value of a word on the command line, as YAML reads it."""
    words = {"true": True, "false": False, "null": None}
    if text.lower() in words:
        return words[text.lower()]
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


@dataclass
class RosArguments:
    """Words after --ros-args on a command line.

    Attributes:
        parameters: {name: value}
        remaps: {name: new name}; "__node" and "__ns" name the node and its namespace
    """

    parameters: dict[str, Any] = field(default_factory=dict[str, Any])
    remaps: dict[str, str] = field(default_factory=dict[str, str])

    def read(self, words: Sequence[str]) -> None:
        """Add those of a command line."""
        ros, rest = False, iter(words)
        for word in rest:
            if word == "--ros-args":
                ros = True
            elif word == "--" and ros:
                ros = False
            elif ros and word in ("-p", "--param", "-r", "--remap"):
                name, _, value = next(rest, "").partition(":=")
                if word in ("-p", "--param"):
                    self.parameters[name.rpartition(":")[2]] = value_of(value)
                else:
                    self.remaps[name.rpartition(":")[2]] = value


class SignalHandlerOptions(IntFlag):
    """Signals that rclpy handles."""

    NO = 0
    SIGINT = 1
    SIGTERM = 2
    ALL = 3


class Severity(IntEnum):
    """Severity of a line of a log."""

    UNSET = 0
    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


class RclLogger:
    """Logs to standard error, as ROS 2 does."""

    flow: ClassVar[Flow]

    def __init__(self, name: str) -> None:
        self.name, self._level = name, Severity.INFO
        self._logged: dict[str, int] = {}

    def get_child(self, name: str) -> RclLogger:
        """Return a logger below this one."""
        return type(self)(f"{self.name}.{name}")

    def set_level(self, level: Severity) -> None:
        """Set the least severity that is shown."""
        self._level = Severity(level)

    def get_effective_level(self) -> Severity:
        """Return the least severity that is shown."""
        return self._level

    def is_enabled_for(self, severity: Severity) -> bool:
        """Return whether a severity is shown."""
        return severity >= self._level

    def log(
        self,
        message: Any,
        severity: Severity,
        *,
        once: bool = False,
        skip_first: bool = False,
        throttle_duration_sec: float | None = None,
        **_: Any,
    ) -> bool:
        """Log a line, unless it is to be left out; return whether it was."""
        if severity < self._level:
            return False
        now, text = self.flow.now_ns(), str(message)
        last = self._logged.get(text)
        period_ns = 1e9 * (throttle_duration_sec or 0.0)
        if last is None and skip_first:
            self._logged[text] = now
            return False
        if last is not None and (once or now - last < period_ns):
            return False
        if once or throttle_duration_sec:
            self._logged[text] = now
        name = Severity(severity).name
        seconds, rest = divmod(now, 1_000_000_000)
        sys.stderr.write(f"[{name}] [{seconds}.{rest:09d}] [{self.name}]: {text}\n")
        return True

    def debug(self, message: Any, **options: Any) -> bool:
        """Log a line for debugging."""
        return self.log(message, Severity.DEBUG, **options)

    def info(self, message: Any, **options: Any) -> bool:
        """Log a line."""
        return self.log(message, Severity.INFO, **options)

    def warning(self, message: Any, **options: Any) -> bool:
        """Log a warning."""
        return self.log(message, Severity.WARN, **options)

    def error(self, message: Any, **options: Any) -> bool:
        """Log an error."""
        return self.log(message, Severity.ERROR, **options)

    def fatal(self, message: Any, **options: Any) -> bool:
        """Log an error that ends the program."""
        return self.log(message, Severity.FATAL, **options)

    warn = warning
