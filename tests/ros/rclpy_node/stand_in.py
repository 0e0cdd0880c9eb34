"""A stand-in for rclpy with its names, signatures and refusals, over a wire in memory.

Sources: github.com/ros2/rclpy, rclpy/rclpy/ of Jazzy and Rolling: __init__.py (init, create_node),
context.py (init reads the environment), node.py (create_publisher, create_subscription,
create_service, destroy_node), publisher.py (publish, get_subscription_count), subscription.py
(callbacks of one or two arguments), parameter.py, executors.py (spin_once, shutdown; one message
of each subscription in a round), qos.py, serialization.py, exceptions.py;
src/rclpy/_rclpy_pybind11.cpp (its errors are RuntimeErrors).
"""

from __future__ import annotations

import enum
import inspect
import os
import re
import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

from trocar.messages import (
    blank,
    cdr_decode,
    cdr_encode,
    message_names,
    message_type,
    service_names,
    service_type,
)

NAME = re.compile(r"/?([A-Za-z_]\w*/)*[A-Za-z_]\w*")


# ---------------------------------------------------------------------- rclpy.exceptions, _rclpy


class NameValidationException(Exception):  # noqa: N818  rclpy's own names
    pass


class InvalidTopicNameException(NameValidationException):
    pass


class NoTypeSupportImportedException(Exception):  # noqa: N818
    pass


class RCLError(RuntimeError):
    pass


class InvalidHandle(RuntimeError):  # noqa: N818
    pass


# ---------------------------------------------------------------------- rclpy.qos


class HistoryPolicy(enum.IntEnum):
    KEEP_LAST = 1
    KEEP_ALL = 2


class ReliabilityPolicy(enum.IntEnum):
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(enum.IntEnum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class QoSProfile:
    def __init__(self, **kwargs: Any) -> None:
        known = {"history", "depth", "reliability", "durability"}
        assert kwargs.keys() <= known, f"Invalid arguments passed to constructor: {kwargs.keys()}"
        assert isinstance(kwargs["depth"], int)
        self.depth: int = kwargs["depth"]
        self.history = HistoryPolicy(kwargs.get("history", 1))
        self.reliability = ReliabilityPolicy(kwargs.get("reliability", 1))
        self.durability = DurabilityPolicy(kwargs.get("durability", 2))


# ---------------------------------------------------------------------- the wire


@dataclass
class Wire:
    """All that the nodes of one test share.

    Attributes:
        domain: ROS_DOMAIN_ID
        broken: makes every publisher fail
        without_support: packages whose libraries cannot be loaded
    """

    domain: int = 0
    broken: bool = False
    without_support: tuple[str, ...] = ()
    nodes: list[Node] = field(default_factory=list)
    contexts: list[Context] = field(default_factory=list)
    bell: threading.Condition = field(default_factory=threading.Condition)

    def topic(self, name: str) -> Publisher:
        return next(p for node in self.nodes for p in node.publishers if p.topic == name)

    def subscription(self, name: str) -> Subscription:
        return next(s for node in self.nodes for s in node.subscriptions if s.topic == name)

    def listen(self, name: str) -> list[bytes]:
        """Subscribe as another program, with a depth of 10 and transient-local."""
        found: list[bytes] = []
        publisher = self.topic(name)
        if publisher.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            found += list(publisher.history)
        publisher.readers.append(found)
        return found

    def write(self, name: str, data: bytes, written_ns: int = 0) -> None:
        """Publish as another program."""
        subscription = self.subscription(name)
        with self.bell:
            subscription.waiting.append((data, {"source_timestamp": written_ns}))
            self.bell.notify_all()

    def call(self, name: str, **fields: Any) -> Call:
        """Call a service as another program."""
        server = next(s for node in self.nodes for s in node.services if s.srv_name == name)
        request = server.srv_type.Request()
        for key, value in fields.items():
            setattr(request, key, value)
        call = Call(request)
        with self.bell:
            server.waiting.append(call)
            self.bell.notify_all()
        return call


class Call:
    """A call that waits for its answer."""

    def __init__(self, request: Any) -> None:
        self.request = request
        self.response: Any = None
        self.done = threading.Event()

    def result(self) -> Any:
        assert self.done.wait(10.0), "no answer"
        return self.response


# ---------------------------------------------------------------------- rclpy


class Context:
    wire: Wire

    def __init__(self) -> None:
        self._state = "new"
        self.wire.contexts.append(self)

    def init(self, args: list[str] | None = None, *, domain_id: int | None = None) -> None:
        assert args is not None, "it would read this process's command line"
        assert domain_id is None
        if self._state != "new":
            raise RuntimeError("Context.init() must only be called once")
        self._state = "ok"
        self.range = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")

    def ok(self) -> bool:
        return self._state == "ok"

    def get_domain_id(self) -> int:
        return self.wire.domain

    def try_shutdown(self) -> None:
        if self.ok():
            with self.wire.bell:
                self._state = "over"
                self.wire.bell.notify_all()


class Publisher:
    def __init__(self, msg_type: Any, topic: str, qos_profile: QoSProfile, wire: Wire) -> None:
        self.msg_type, self.topic, self.qos_profile = msg_type, topic, qos_profile
        self.history: deque[bytes] = deque(maxlen=qos_profile.depth)
        self.readers: list[list[bytes]] = []
        self.destroyed = False
        self._wire = wire

    def publish(self, msg: Any) -> None:
        self._check()
        if isinstance(msg, self.msg_type):
            raise AssertionError("bytes are cheaper")
        if not isinstance(msg, bytes):
            raise TypeError(f"Expected {self.msg_type}, got {type(msg)}")
        if self._wire.broken:
            raise RCLError("Failed to publish")
        self.history.append(msg)
        for reader in self.readers:
            reader.append(msg)

    def get_subscription_count(self) -> int:
        self._check()
        return len(self.readers)

    def _check(self) -> None:
        if self.destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")


class Subscription:
    def __init__(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., None],
        qos_profile: QoSProfile,
        raw: bool,
    ) -> None:
        self.msg_type, self.topic, self.qos_profile, self.raw = msg_type, topic, qos_profile, raw
        self.callback = callback
        self.with_info = False
        try:
            inspect.signature(callback).bind(object())
        except TypeError:
            inspect.signature(callback).bind(object(), object())
            self.with_info = True
        self.waiting: deque[tuple[bytes, dict[str, int]]] = deque(maxlen=qos_profile.depth)

    def take(self) -> Callable[[], None]:
        data, info = self.waiting.popleft()
        assert self.raw
        return lambda: self.callback(data, info) if self.with_info else self.callback(data)


class Service:
    def __init__(self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any]) -> None:
        self.srv_type, self.srv_name, self.callback = srv_type, srv_name, callback
        self.waiting: deque[Call] = deque(maxlen=10)

    def take(self) -> Callable[[], None]:
        call = self.waiting.popleft()

        def answer() -> None:
            response = self.callback(call.request, self.srv_type.Response())
            if not isinstance(response, self.srv_type.Response):
                raise TypeError
            call.response = response
            call.done.set()

        return answer


class Parameter:
    def __init__(self, name: str, type_: Any = None, value: Any = None) -> None:  # noqa: ARG002
        self.name, self.value = name, value


class SetParametersResult:
    def __init__(self, *, successful: bool = True, reason: str = "") -> None:
        self.successful, self.reason = successful, reason


class Node:
    def __init__(self, node_name: str, context: Context) -> None:
        self.name, self.context = node_name, context
        self.publishers: list[Publisher] = []
        self.subscriptions: list[Subscription] = []
        self.services: list[Service] = []
        self.parameters: dict[str, Any] = {}
        self.callbacks: list[Callable[..., Any]] = []
        self.destroyed = False
        context.wire.nodes.append(self)

    def create_publisher(
        self,
        msg_type: Any,
        topic: str,
        qos_profile: QoSProfile | int,
        *,
        callback_group: Any = None,  # noqa: ARG002
    ) -> Publisher:
        assert isinstance(qos_profile, QoSProfile)
        self._check(msg_type, topic)
        self.publishers.append(Publisher(msg_type, topic, qos_profile, self.context.wire))
        return self.publishers[-1]

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., None],
        qos_profile: QoSProfile | int,
        *,
        callback_group: Any = None,  # noqa: ARG002
        raw: bool = False,
    ) -> Subscription:
        assert isinstance(qos_profile, QoSProfile)
        self._check(msg_type, topic)
        self.subscriptions.append(Subscription(msg_type, topic, callback, qos_profile, raw))
        return self.subscriptions[-1]

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        qos_profile: QoSProfile | None = None,  # noqa: ARG002
        callback_group: Any = None,  # noqa: ARG002
    ) -> Service:
        self._check(srv_type, srv_name)
        self.services.append(Service(srv_type, srv_name, callback))
        return self.services[-1]

    def declare_parameter(self, name: str, value: Any) -> None:
        assert name not in self.parameters, "ParameterAlreadyDeclaredException"
        assert self._allowed([Parameter(name, value=value)]).successful
        self.parameters[name] = value

    def add_on_set_parameters_callback(self, callback: Callable[..., Any]) -> None:
        self.callbacks.append(callback)

    def set_parameters(self, given: list[Parameter]) -> list[SetParametersResult]:
        results: list[SetParametersResult] = []
        for one in given:
            assert one.name in self.parameters, "ParameterNotDeclaredException"
            results.append(self._allowed([one]))
            if results[-1].successful:
                self.parameters[one.name] = one.value
        return results

    def _allowed(self, given: list[Parameter]) -> SetParametersResult:
        found = [callback(given) for callback in self.callbacks]
        return next((r for r in found if not r.successful), SetParametersResult())

    def destroy_node(self) -> None:
        self.destroyed = True
        for publisher in self.publishers:
            publisher.destroyed = True

    def _check(self, made: Any, name: str) -> None:
        if made.package in self.context.wire.without_support:
            raise NoTypeSupportImportedException
        if not NAME.fullmatch(name):
            raise InvalidTopicNameException(name)


class SingleThreadedExecutor:
    def __init__(self, *, context: Context | None = None) -> None:
        assert context is not None
        self._context, self._wire = context, context.wire
        self._nodes: list[Node] = []
        self._round: list[Callable[[], None]] = []
        self._is_shutdown = False

    def add_node(self, node: Node) -> bool:
        self._nodes.append(node)
        return True

    def spin_once(self, timeout_sec: float | None = None) -> None:
        assert timeout_sec is None
        if not self._round:
            with self._wire.bell:
                self._wire.bell.wait_for(
                    lambda: self._is_shutdown or not self._context.ok() or any(self._ready())
                )
                if self._is_shutdown:
                    return
                if not self._context.ok():
                    raise ExternalShutdownException
                self._round = [end.take() for end in self._ready()]
        self._round.pop(0)()

    def shutdown(self, timeout_sec: float | None = None) -> bool:  # noqa: ARG002
        with self._wire.bell:
            self._is_shutdown = True
            self._wire.bell.notify_all()
        return True

    def _ready(self) -> list[Any]:
        ends = [end for node in self._nodes for end in (*node.subscriptions, *node.services)]
        return [end for end in ends if end.waiting]


class ExternalShutdownException(Exception):  # noqa: N818
    pass


# ---------------------------------------------------------------------- messages


def message(name: str) -> type:
    """Return a class as rosidl makes it, fields filled with nothing."""
    kind = message_type(name)
    names = [f.name for f in kind.fields if not f.only_ros1]

    def fill(self: Any) -> None:
        self.__dict__.update(blank(kind))

    return type(
        kind.ros2_name.split("/")[-1],
        (),
        {
            "kind": kind,
            "package": name.split("/")[0],
            "__init__": fill,
            "get_fields_and_field_types": classmethod(lambda _: dict.fromkeys(names, "")),
        },
    )


def serialize_message(message: Any) -> bytes:
    return cdr_encode(message.kind, vars(message))


def deserialize_message(serialized_message: bytes, message_type: Any) -> Any:
    assert isinstance(serialized_message, bytes)
    found = message_type()
    found.__dict__.update(cdr_decode(message_type.kind, serialized_message))
    return found


def packages(missing: Iterable[str] = ()) -> dict[str, ModuleType | None]:
    """Return the modules of every package of messages; None for those that are missing."""
    found: dict[str, ModuleType | None] = {}
    for folder, names in (("msg", message_names()), ("srv", service_names())):
        for name in names:
            package, own = name.split("/")
            if package in missing:
                found[package] = found[f"{package}.{folder}"] = None
                continue
            found.setdefault(package, ModuleType(package))
            module = found.setdefault(f"{package}.{folder}", ModuleType(f"{package}.{folder}"))
            setattr(module, own, message(name) if folder == "msg" else _service(name))
    return found


def _service(name: str) -> type:
    kind = service_type(name)
    halves = {"Request": message(kind.request.name), "Response": message(kind.response.name)}
    return type(name.split("/")[1], (), {"package": name.split("/")[0], **halves})


def modules(wire: Wire) -> dict[str, ModuleType]:
    """Return rclpy and its modules, which speak on a wire."""
    context_class = type("Context", (Context,), {"wire": wire})

    def init(
        *,
        args: list[str] | None = None,
        context: Any = None,
        domain_id: int | None = None,
        signal_handler_options: Any = None,  # noqa: ARG001
    ) -> None:
        assert context is not None, "with the default context it would take the signals"
        context.init(args, domain_id=domain_id)

    def create_node(
        node_name: str,
        *,
        context: Any = None,
        cli_args: list[str] | None = None,  # noqa: ARG001
        namespace: str | None = None,  # noqa: ARG001
        use_global_arguments: bool = True,  # noqa: ARG001
        enable_rosout: bool = True,  # noqa: ARG001
        start_parameter_services: bool = True,  # noqa: ARG001
    ) -> Node:
        if not context.ok():
            raise RCLError("cannot create node")
        return Node(node_name, context)

    found = {
        "rclpy": _module(
            "rclpy",
            init=init,
            create_node=create_node,
            get_rmw_implementation_identifier=lambda: "rmw_fastrtps_cpp",
        ),
        "rclpy.context": _module("rclpy.context", Context=context_class),
        "rclpy.node": _module("rclpy.node", Node=Node),
        "rclpy.exceptions": _module(
            "rclpy.exceptions",
            NameValidationException=NameValidationException,
            InvalidTopicNameException=InvalidTopicNameException,
            NoTypeSupportImportedException=NoTypeSupportImportedException,
        ),
        "rclpy.executors": _module(
            "rclpy.executors",
            SingleThreadedExecutor=SingleThreadedExecutor,
            ExternalShutdownException=ExternalShutdownException,
        ),
        "rclpy.parameter": _module("rclpy.parameter", Parameter=Parameter),
        "rcl_interfaces": _module("rcl_interfaces"),
        "rcl_interfaces.msg": _module(
            "rcl_interfaces.msg", SetParametersResult=SetParametersResult
        ),
        "rclpy.qos": _module(
            "rclpy.qos",
            QoSProfile=QoSProfile,
            HistoryPolicy=HistoryPolicy,
            ReliabilityPolicy=ReliabilityPolicy,
            DurabilityPolicy=DurabilityPolicy,
        ),
        "rclpy.serialization": _module(
            "rclpy.serialization",
            serialize_message=serialize_message,
            deserialize_message=deserialize_message,
        ),
    }
    for name, module in found.items():
        setattr(found["rclpy"], name.rpartition(".")[2], module)
    return found


def _module(name: str, **names: Any) -> ModuleType:
    module = ModuleType(name)
    module.__dict__.update(names)
    return module
