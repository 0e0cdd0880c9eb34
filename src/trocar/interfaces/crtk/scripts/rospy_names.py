"""The part of rospy that scripts for the dVRK use, over the node of a run.

An installed crtk_python_client stands on it as well. Source of names and behaviour: rospy's public
documentation (ROS 1 Noetic).
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from trocar.interfaces.crtk.scripts.node import Node, Publisher, ServiceError, Subscriber
from trocar.interfaces.crtk.scripts.ral import own_arguments
from trocar.interfaces.crtk.scripts.timers import timer_class
from trocar.interfaces.crtk.scripts.times import Duration, Rate, Time

LEVELS = {"debug": 1, "info": 2, "warn": 4, "err": 8, "error": 8, "fatal": 16}
#: What is said of each level and up; ROS shows from INFO on. Source: rospy.
SHOWN = 2


class ROSException(Exception):  # noqa: N818  as scripts call it
    """Something of ROS failed."""


class ROSInterruptException(ROSException, KeyboardInterrupt):
    """The node ended while the script waited."""


class TransportTerminated(ROSException):
    """A connection ended; never raised here."""


def rospy_names(node: Node, thread: type[threading.Thread]) -> dict[str, Any]:
    """Return {name: what a script finds under it in rospy}; `thread` is the script's own."""
    ros = _Rospy(node)
    classes = _classes(ros)
    said = {f"log{word}": ros._logger(word) for word in LEVELS}
    for word in LEVELS:
        said[f"log{word}_once"] = ros._logger(word, once=True)
        said[f"log{word}_throttle"] = ros._throttled(word)
    return {
        **{name: getattr(ros, name) for name in dir(ros) if not name.startswith("_")},
        **classes,
        **said,
        "Timer": timer_class(node, thread),
        "ROSException": ROSException,
        "ROSInterruptException": ROSInterruptException,
        "ServiceException": ServiceError,
        "TransportTerminated": TransportTerminated,
        "Duration": Duration,
        "DEBUG": 1,
        "INFO": 2,
        "WARN": 4,
        "ERROR": 8,
        "FATAL": 16,
    }


def key(name: str, own: str = "") -> str:
    """Return a topic's name without the first slash; "~x" is below the node's own."""
    return f"{own}/{name[1:]}".strip("/") if name.startswith("~") else name.strip("/")


class _Rospy:
    """The functions of rospy; each public method is one."""

    def __init__(self, node: Node) -> None:
        self._node, self._name = node, "trocar_script"
        self._begun = False
        self._once: set[tuple[str, str]] = set()

    # ------------------------------------------------------------------ the node

    def init_node(self, name: str, *_: Any, **__: Any) -> None:
        """Name the node."""
        self._name, self._begun = name, True

    def get_name(self) -> str:
        """Return the node's name."""
        return f"/{self._name}"

    def get_caller_id(self) -> str:
        """Return the node's name."""
        return self.get_name()

    def get_namespace(self) -> str:
        """Return the root."""
        return "/"

    def get_node_uri(self) -> str | None:
        """Return something once the node is named, None before."""
        return "http://localhost:0/" if self._begun else None

    def resolve_name(self, name: str, *_: Any) -> str:
        """Return a whole name."""
        return f"/{key(name, self._name)}"

    def myargv(self, argv: Sequence[str] | None = None) -> list[str]:
        """Return a command line without ROS's own words."""
        return own_arguments(sys.argv if argv is None else argv)

    def is_shutdown(self) -> bool:
        """Tell whether the node has ended."""
        self._node.flow.look()
        return self._node.ended

    def on_shutdown(self, h: Callable[[], object]) -> None:
        """Have a function called at the end."""
        self._node.on_shutdown(h)

    def signal_shutdown(self, reason: str = "") -> None:  # noqa: ARG002
        """End the node."""
        self._node.shutdown()

    def spin(self) -> None:
        """Wait until the node ends."""
        self._node.wait(lambda: False, None)

    # ------------------------------------------------------------------ time

    def get_rostime(self) -> Time:
        """Return the time now."""
        return self._node.now()

    def get_time(self) -> float:
        """Return the time now [s]."""
        return self._node.now().to_sec()

    def sleep(self, duration: float | Duration) -> None:
        """Let some time pass [s]."""
        if self._node.ended:
            raise ROSInterruptException("ROS shutdown request")
        self._node.sleep(duration)

    # ------------------------------------------------------------------ waiting

    def wait_for_message(self, topic: str, topic_type: Any, timeout: Any = None) -> Any:
        """Return the next message of a topic.

        Raises:
            ROSException: none came in time [s]
        """
        came: list[Any] = []
        ear = self._node.listener(key(topic, self._name), topic_type, came.append)
        try:
            patience = timeout.to_sec() if isinstance(timeout, Duration) else timeout
            if not self._node.wait(lambda: bool(came), patience):
                raise ROSException(f"timeout exceeded while waiting for message on topic {topic}")
        finally:
            ear.unregister()
        return came[0]

    def wait_for_service(self, service: str, timeout: float | None = None) -> None:
        """Return when a service is there.

        Raises:
            ROSException: it is not, in time [s]
        """
        services = self._node.flow.core.services
        if not self._node.wait(lambda: key(service) in services, timeout):
            raise ROSException(f"timeout exceeded while waiting for service {service}")

    # ------------------------------------------------------------------ parameters

    def get_param(self, param_name: str, *default: Any) -> Any:
        """Return a parameter that the script has set, or the default.

        Raises:
            KeyError: there is none, and no default
        """
        found = self._node.parameters
        if key(param_name, self._name) in found or not default:
            return found[key(param_name, self._name)]
        return default[0]

    def set_param(self, param_name: str, param_value: Any) -> None:
        """Set a parameter."""
        self._node.parameters[key(param_name, self._name)] = param_value

    def has_param(self, param_name: str) -> bool:
        """Tell whether a parameter was set."""
        return key(param_name, self._name) in self._node.parameters

    # ------------------------------------------------------------------ what is made of these

    def _logger(self, word: str, *, once: bool = False) -> Callable[..., None]:
        """Return what says something on a level."""

        def log(text: Any, *args: Any, **_: Any) -> None:
            line = str(text) % args if args else str(text)
            if once and (word, line) in self._once:
                return
            self._once.add((word, line))
            if LEVELS[word] >= SHOWN:
                out = sys.stderr if LEVELS[word] > SHOWN else sys.stdout
                out.write(f"[{word.upper()}] [{self.get_time():.6f}]: {line}\n")

        return log

    def _throttled(self, word: str) -> Callable[..., None]:
        """Return what says something on a level, once in a period [s]."""
        say, last = self._logger(word), {}

        def log(period: float, text: Any, *args: Any) -> None:
            now = self.get_time()
            if now - last.get(str(text), -period) >= period:
                last[str(text)] = now
                say(text, *args)

        return log


def _classes(ros: _Rospy) -> dict[str, type]:
    """Return rospy's classes over a node."""
    node = ros._node
    names: Mapping[str, Any] = vars(ros)

    def whole(name: str) -> str:
        return key(name, names["_name"])

    class Now(Time):
        """A moment."""

        __slots__ = ()

        @classmethod
        def now(cls) -> Time:
            """Return this one."""
            return node.now()

    class Publishes(Publisher):
        """Publishes to a topic."""

        def __init__(self, name: str, data_class: Any, *_: Any, **__: Any) -> None:
            super().__init__(node, whole(name), data_class)

    class Subscribes(Subscriber):
        """Has a function called with each message of a topic."""

        def __init__(
            self,
            name: str,
            data_class: Any,
            callback: Callable[..., None] | None = None,
            callback_args: Any = None,
            queue_size: int | None = None,
            *_: Any,
            **__: Any,
        ) -> None:
            call = callback or (lambda *_: None)
            told = call if callback_args is None else lambda m: call(m, callback_args)
            super().__init__(node, whole(name), data_class, told, queue_size)

    class Keeps(Rate):
        """Keeps a loop to a frequency [Hz]."""

        def __init__(self, hz: float, reset: bool = False) -> None:  # noqa: ARG002
            super().__init__(hz, node.flow.now_ns, ros.sleep)

    return {
        "Time": Now,
        "Rate": Keeps,
        "Publisher": Publishes,
        "Subscriber": Subscribes,
        "ServiceProxy": type("ServiceProxy", (), {"__new__": _proxy(node, whole)}),
    }


def _proxy(node: Node, whole: Callable[[str], str]) -> Callable[..., Any]:
    def make(_: type, name: str, service_class: Any, *__: Any, **___: Any) -> Any:
        return node.service(whole(name), service_class)

    return make
