"""The part of rospy that scripts for the dVRK use, over a simulation.

An installed crtk_python_client stands on it as well. Source of names and behaviour: rospy's public
documentation (ROS 1 Noetic).
"""

# Public attributes of genpy's classes begin with an underscore.
# pyright: reportPrivateUsage=false

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from trocar.errors import TrocarError
from trocar.messages import blank, service_type
from trocar.scripts.messages import SECOND, Duration, Message, Rate, Time, fields_of, message_of
from trocar.scripts.ros2_settings import value_of
from trocar.scripts.simulation import Flow, Subscription

LEVELS = {"debug": 1, "info": 2, "warn": 4, "err": 8, "error": 8, "fatal": 16}
#: Messages of this level and up are shown. Source: rospy.
SHOWN = 2
#: Time that a subscription of a script takes [s]. On a robot the master is asked and publishers
#: connect meanwhile; `dvrk.psm` makes 15 subscriptions. Source: our own choice, the period of the
#: dVRK's states, so that one comes.
CONNECT_S = 0.01


class ROSException(Exception):  # noqa: N818  as scripts call it
    """Something of ROS failed."""


class ROSInterruptException(ROSException, KeyboardInterrupt):
    """The node ended while the script waited."""


class TransportTerminated(ROSException):
    """A connection ended; never raised here."""


class ServiceException(RuntimeError):  # noqa: N818  as scripts call it
    """A service that is not there, or that rejected a request."""


def own_arguments(argv: Sequence[str]) -> list[str]:
    """Return a command line without what is ROS's: `a:=b`, and what stands after --ros-args."""
    left: list[str] = []
    ros = False
    for word in argv:
        if word == "--ros-args":
            ros = True
        elif word == "--" and ros:
            ros = False
        elif not ros and ":=" not in word:
            left.append(word)
    return left


def own_words(argv: Sequence[str]) -> list[str]:
    """Return the words of ROS 1 in a command line, as `a:=b`."""
    return [word for word in argv[1:] if ":=" in word and not word.startswith("-")]


class Node:
    """The one node that a script is; its public names are those that a script finds in rospy.

    Args:
        flow: the simulation beneath
        thread: the class of the script's own threads

    Attributes:
        ended: whether the node has been shut down
    """

    Duration = Duration
    ROSException = ROSException
    ROSInterruptException = ROSInterruptException
    ServiceException = ServiceException
    TransportTerminated = TransportTerminated
    DEBUG, INFO, WARN, ERROR, FATAL = 1, 2, 4, 8, 16

    def __init__(self, flow: Flow, thread: type[threading.Thread] = threading.Thread) -> None:
        self.flow, self.ended = flow, False
        self._name, self._begun = "trocar_script", False
        self._parameters: dict[str, Any] = {}
        self._remaps: dict[str, str] = {}
        self._given: dict[str, str] = {}
        self._farewells: list[Callable[[], object]] = []
        self._logged: set[tuple[str, str]] = set()
        own = {"node": self}
        self.Publisher = type("Publisher", (Publisher,), own)
        self.Subscriber = type("Subscriber", (Subscriber,), own)
        self.ServiceProxy = type("ServiceProxy", (ServiceProxy,), own)
        self.Time = type("Time", (Time,), {"__slots__": (), "now": staticmethod(self.get_rostime)})
        self.Timer = _timer_class(self, thread)
        for level in LEVELS:
            setattr(self, f"log{level}", self._logger(level))
            setattr(self, f"log{level}_once", self._logger(level, once=True))
            setattr(self, f"log{level}_throttle", self._throttled(level))

    def names(self) -> dict[str, Any]:
        """Return {name: what a script finds under it in rospy}."""
        own = ("flow", "ended", "names", "key", "check", "wait", "remap")
        found = [name for name in dir(self) if not name.startswith("_") and name not in own]
        return {name: getattr(self, name) for name in found}

    def key(self, name: str) -> str:
        """Return a topic's name without the first slash; "~x" is below the node's own."""
        below = f"{self._name}/{name[1:]}" if name.startswith("~") else name
        found = below.strip("/")
        return self._remaps.get(found, found)

    def remap(self, argv: Sequence[str]) -> None:
        """Take names and private parameters of a command line: `a:=b`, `_gain:=2`."""
        for word in own_words(argv):
            name, _, value = word.partition(":=")
            if name.startswith("_"):
                self._given[name[1:]] = value
            else:
                self._remaps[name.strip("/")] = value.strip("/")

    def check(self) -> None:
        """Raise an error once the node has been shut down."""
        if self.ended:
            raise RuntimeError("cannot send: this script has shut ROS down")

    def wait(self, ready: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Wait until something holds or the node ends; return whether it holds."""
        found = self.flow.wait(lambda: self.ended or ready(), timeout_s)
        return found and not self.ended

    def init_node(self, name: str, *_: Any, **__: Any) -> None:
        """Name the node; set its private parameters of the command line."""
        self._name, self._begun = self._given.get("_name", name), True
        for own, value in self._given.items():
            if not own.startswith("_"):
                self.set_param(f"~{own}", value_of(value))

    def get_name(self) -> str:
        """Return the node's name."""
        return f"/{self._name}"

    get_caller_id = get_name

    def get_namespace(self) -> str:
        """Return the root."""
        return "/"

    def get_node_uri(self) -> str | None:
        """Return a URI once the node is named, None before."""
        return "http://localhost:0/" if self._begun else None

    def resolve_name(self, name: str, *_: Any) -> str:
        """Return a whole name."""
        return f"/{self.key(name)}"

    def myargv(self, argv: Sequence[str] | None = None) -> list[str]:
        """Return a command line without ROS's own words."""
        return own_arguments(sys.argv if argv is None else argv)

    def is_shutdown(self) -> bool:
        """Return whether the node has ended."""
        self.flow.look()
        return self.ended

    def on_shutdown(self, h: Callable[[], object]) -> None:
        """Have a function called at the end."""
        self._farewells.append(h)

    def signal_shutdown(self, reason: str = "") -> None:  # noqa: ARG002
        """End the node: no more messages, and no wait succeeds."""
        if self.ended:
            return
        self.ended = True
        farewells, self._farewells = self._farewells, []
        for farewell in farewells:
            farewell()

    def spin(self) -> None:
        """Wait until the node ends."""
        self.wait(lambda: False)

    def get_rostime(self) -> Time:
        """Return the time of stamps now."""
        self.flow.look()
        return Time.of(self.flow.now_ns())

    def get_time(self) -> float:
        """Return the time now [s]."""
        return self.get_rostime().to_sec()

    def sleep(self, duration: float | Duration) -> None:
        """Let some time pass [s].

        Raises:
            ROSInterruptException: the node has ended
        """
        if self.ended:
            raise ROSInterruptException("ROS shutdown request")
        self.flow.sleep(duration.to_sec() if isinstance(duration, Duration) else duration)

    def Rate(self, hz: float, reset: bool = False) -> Rate:  # noqa: ARG002
        """Return a rate that keeps a loop to a frequency [Hz]."""
        return Rate(hz, self.flow.now_ns, self.sleep)

    def wait_for_message(self, topic: str, topic_type: Any, timeout: Any = None) -> Any:
        """Return the next message of a topic.

        Raises:
            ROSException: none came in time [s]
        """
        came: list[Any] = []
        subscriber = self.Subscriber(topic, topic_type, came.append, at_once=True)
        try:
            patience = timeout.to_sec() if isinstance(timeout, Duration) else timeout
            if not self.wait(lambda: bool(came), patience):
                raise ROSException(f"timeout exceeded while waiting for message on topic {topic}")
        finally:
            subscriber.unregister()
        return came[0]

    def wait_for_service(self, service: str, timeout: float | None = None) -> None:
        """Return when a service is there.

        Raises:
            ROSException: it is not, in time [s]
        """
        if not self.wait(lambda: self.key(service) in self.flow.core.services, timeout):
            raise ROSException(f"timeout exceeded while waiting for service {service}")

    def get_param(self, param_name: str, *default: Any) -> Any:
        """Return a parameter that the script has set, or the default.

        Raises:
            KeyError: the parameter is not set, and no default is given
        """
        if self.has_param(param_name) or not default:
            return self._parameters[self.key(param_name)]
        return default[0]

    def set_param(self, param_name: str, param_value: Any) -> None:
        """Set a parameter."""
        self._parameters[self.key(param_name)] = param_value

    def has_param(self, param_name: str) -> bool:
        """Return whether a parameter was set."""
        return self.key(param_name) in self._parameters

    def _logger(self, level: str, *, once: bool = False) -> Callable[..., None]:
        def log(text: Any, *args: Any, **_: Any) -> None:
            line = str(text) % args if args else str(text)
            if once and (level, line) in self._logged:
                return
            self._logged.add((level, line))
            if LEVELS[level] >= SHOWN:
                out = sys.stderr if LEVELS[level] > SHOWN else sys.stdout
                out.write(f"[{level.upper()}] [{self.get_time():.6f}]: {line}\n")

        return log

    def _throttled(self, level: str) -> Callable[..., None]:
        """Return a function that logs a text once in a period [s]."""
        log_now, last = self._logger(level), dict[str, float]()

        def log(period: float, text: Any, *args: Any) -> None:
            now = self.get_time()
            if now - last.get(str(text), -period) >= period:
                last[str(text)] = now
                log_now(text, *args)

        return log


class _End:
    """One end of a topic.

    Attributes:
        name, topic_name: of the topic, with the first slash
        type, data_class: of its messages
    """

    node: Node

    def _connect(self, name: str, data_class: Any) -> None:
        self._key = self.node.key(name)
        self.name = self.topic_name = f"/{self._key}"
        if not (isinstance(data_class, type) and issubclass(data_class, Message)):
            wrong = f"{self.name}: got {data_class!r}; allowed: a class of messages, as JointState"
            raise TypeError(wrong)
        self.type, self.data_class = data_class._type, data_class

    def unregister(self) -> None:
        """Do nothing: it ends with the script."""


class Publisher(_End):
    """Publishes to a topic."""

    def __init__(self, name: str, data_class: Any, *_: Any, **__: Any) -> None:
        self._connect(name, data_class)
        self.node.flow.bus.advertise(self._key, self.data_class)

    def publish(self, *values: Any, **named: Any) -> None:
        """Publish a message, or one that is made of these values."""
        self.node.check()
        message: Any = values[0] if len(values) == 1 and not named else None
        if isinstance(message, Message):
            if type(message) is not self.data_class:
                raise TypeError(f"{self.name} is of {self.type}, got {message._type}")
        else:
            message = self.data_class(*values, **named)
        self.node.flow.bus.publish(self._key, message)

    def get_num_connections(self) -> int:
        """Count the subscribers."""
        return self.node.flow.bus.subscribers(self._key, self.data_class)

    get_subscription_count = get_num_connections


class Subscriber(_End):
    """Has a function called with each message of a topic.

    Time passes while a subscription is made, as on a robot: it begins with the newest message.

    Args:
        name, data_class, callback, callback_args, queue_size: as rospy's
        at_once: call it in the publishing thread, where the simulation waits for it; no time passes
    """

    def __init__(
        self,
        name: str,
        data_class: Any,
        callback: Callable[..., None] | None = None,
        callback_args: Any = None,
        queue_size: int | None = None,
        *_: Any,
        at_once: bool = False,
        **__: Any,
    ) -> None:
        self._connect(name, data_class)
        call: Callable[..., None] = callback or (lambda *_: None)
        heard: Callable[[Any], None] = call
        if callback_args is not None:
            heard = lambda m: call(m, callback_args)  # noqa: E731
        flow = self.node.flow
        self._subscription = Subscription(self._key, self.data_class, heard, queue_size, at_once)
        flow.bus.subscribe(self._subscription)
        if not at_once:
            flow.sleep(CONNECT_S)

    def get_num_connections(self) -> int:
        """Count the publishers."""
        return self.node.flow.bus.publishers(self._key, self.data_class)

    get_publisher_count = get_num_connections

    def unregister(self) -> None:
        """Unsubscribe."""
        self.node.flow.bus.unsubscribe(self._subscription)


class Latest(_End):
    """The newest message of a topic; made only when it is looked at, where that can be.

    Attributes:
        fresh: whether it is of the very moment when it is looked at
    """

    def __init__(self, node: Node, name: str, data_class: Any) -> None:
        self.node, self._message = node, None
        self._connect(name, data_class)
        topic = node.flow.core.topics.get(self._key)
        served = topic is not None and topic.type == self.type and topic.direction == "pub"
        self.fresh = served and node.flow.virtual and node.flow.peek(self._key) is not None
        if not self.fresh:
            node.Subscriber(name, data_class, self._put, at_once=True)

    def _put(self, message: Any) -> None:
        self._message = message

    def get(self) -> Any:
        """Return the newest message, None before the first."""
        if self.fresh:
            fields = self.node.flow.peek(self._key)
            return None if fields is None else message_of(self.data_class, fields)
        return self._message

    def get_num_connections(self) -> int:
        """Count the publishers."""
        return self.node.flow.bus.publishers(self._key, self.data_class)


class ServiceProxy:
    """Calls a service; `proxy(a, b)`, `proxy(request)` and `proxy.call(request)` do the same."""

    node: Node

    def __init__(self, name: str, service_class: Any, *_: Any, **__: Any) -> None:
        self._key = self.node.key(name)
        self.resolved_name = f"/{self._key}"
        self._type = service_type(getattr(service_class, "_type", str(service_class)))
        self.request_class: Any = getattr(service_class, "_request_class", None)
        self._response: Any = getattr(service_class, "_response_class", None)

    def call(self, *values: Any, **named: Any) -> Any:
        """Return the answer.

        Raises:
            ServiceException: there is no such service, or it rejected the request
        """
        self.node.check()
        request: Any = values[0] if len(values) == 1 and not named else None
        if not isinstance(request, self.request_class):
            request = self.request_class(*values, **named)
        core = self.node.flow.core
        served = core.services.get(self._key)
        if served is None or served.type != self._type.name:
            raise ServiceException(f"service [{self.resolved_name}] unavailable")
        try:
            answer = core.call(self._key, fields_of(request))
        except TrocarError as problem:
            raise ServiceException(f"service [{self.resolved_name}]: {problem}") from problem
        return message_of(self._response, {**blank(self._type.response), **answer})

    __call__ = call

    def wait_for_service(self, timeout: float | None = None) -> bool:
        """Wait until the service is there."""
        return self.node.wait(lambda: self._key in self.node.flow.core.services, timeout)

    def close(self) -> None:
        """Do nothing: it ends with the script."""


@dataclass(frozen=True)
class TimerEvent:
    """The argument of a timer's callback.

    Attributes:
        last_expected: when the call before was due, None at the first
        last_real: when it came, None at the first
        current_expected: when this one is due
        current_real: when it comes
        last_duration: how long the call before took, None at the first [s]
    """

    last_expected: Time | None
    last_real: Time | None
    current_expected: Time
    current_real: Time
    last_duration: float | None


def _timer_class(node: Node, thread: type[threading.Thread]) -> type:
    """Return rospy's Timer: a thread of the script that calls a function again and again."""
    # rospy measures durations by the wall clock; a script whose time is stepped has none
    clock_ns = node.flow.now_ns if node.flow.virtual else time.perf_counter_ns

    class Timer(thread):
        """Calls a function after each period, or once."""

        def __init__(
            self,
            period: Duration,
            callback: Callable[[TimerEvent], object],
            oneshot: bool = False,
            **_: Any,
        ) -> None:
            super().__init__(daemon=True)
            self._over, self._oneshot = False, oneshot
            self._period, self._callback = period, callback
            self._rate = node.Rate(1.0 / period.to_sec())
            self._expected = Time.of(node.flow.now_ns()) + period
            self.start()

        def shutdown(self) -> None:
            """End the calls."""
            self._over = True

        def run(self) -> None:
            """Call it until the end."""
            expected, last_expected, last_real, took_s = self._expected, None, None, None
            while not (self._over or node.ended):
                self._rate.sleep()
                if self._over or node.ended:
                    return
                real, begun_ns = Time.of(node.flow.now_ns()), clock_ns()
                self._callback(TimerEvent(last_expected, last_real, expected, real, took_s))
                took_s = (clock_ns() - begun_ns) / SECOND
                last_expected, last_real, expected = expected, real, expected + self._period
                self._over |= self._oneshot

    return Timer
