"""What a script has of ROS: publishers, subscribers, services, time, and an end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trocar.errors import TrocarError
from trocar.interfaces.crtk.messages import service_type
from trocar.interfaces.crtk.scripts.bus import Listener
from trocar.interfaces.crtk.scripts.flow import Flow
from trocar.interfaces.crtk.scripts.message_classes import (
    Message,
    complete,
    fields_of,
    message_of,
)
from trocar.interfaces.crtk.scripts.times import Duration, Rate, Time


class ServiceError(RuntimeError):
    """A service that is not there, or that refused a request."""


class Node:
    """The one node that a script is.

    Args:
        flow: the simulation beneath
    """

    def __init__(self, flow: Flow) -> None:
        self.flow = flow
        self.parameters: dict[str, Any] = {}
        self._ended = False
        self._farewells: list[Callable[[], object]] = []

    # ------------------------------------------------------------------ time

    def now(self) -> Time:
        """Return the time that stamps tell."""
        self.flow.look()
        return Time.of(self.flow.now_ns())

    def rate(self, rate_hz: float) -> Rate:
        """Return what keeps a loop to a frequency."""
        return Rate(rate_hz, self.flow.now_ns, self.sleep)

    def sleep(self, seconds: float | Duration) -> None:
        """Let some time pass [s]."""
        self.check()
        self.flow.sleep(seconds.to_sec() if isinstance(seconds, Duration) else seconds)

    def wait(self, ready: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Wait until something holds or the node ends; return whether it holds."""
        found = self.flow.wait(lambda: self._ended or ready(), timeout_s)
        return found and not self._ended

    # ------------------------------------------------------------------ end

    @property
    def ended(self) -> bool:
        """Whether the node has been shut down."""
        return self._ended

    def on_shutdown(self, farewell: Callable[[], object]) -> None:
        """Have a function called at the end."""
        self._farewells.append(farewell)

    def shutdown(self) -> None:
        """End: no more messages, and no wait succeeds."""
        if self._ended:
            return
        self._ended = True
        farewells, self._farewells = self._farewells, []
        for farewell in farewells:
            farewell()

    def check(self) -> None:
        """Refuse what a node cannot do that was shut down."""
        if self._ended:
            raise RuntimeError("ROS was shut down by this script before: nothing can be sent")

    # ------------------------------------------------------------------ connections

    def publisher(self, name: str, kind: type[Message]) -> Publisher:
        """Return what publishes to a topic."""
        return Publisher(self, name, kind)

    def subscriber(
        self, name: str, kind: type[Message], heard: Callable[[Any], None], size: int | None = None
    ) -> Subscriber:
        """Have a function called with each message of a topic."""
        return Subscriber(self, name, kind, heard, size)

    def listener(self, name: str, kind: type[Message], heard: Callable[[Any], None]) -> Subscriber:
        """Have a function called with each message of a topic at once, wherever it comes from."""
        return Subscriber(self, name, kind, heard, at_once=True)

    def service(self, name: str, kind: type) -> ServiceProxy:
        """Return what calls a service."""
        return ServiceProxy(self, name, kind)

    def latest(self, name: str, kind: type[Message]) -> Latest:
        """Return what has the newest message of a topic."""
        return Latest(self, name, kind)


class Publisher:
    """Publishes to a topic.

    Attributes:
        name, topic_name: of the topic, with the first slash
    """

    def __init__(self, node: Node, name: str, kind: type[Message]) -> None:
        _check_class(name, kind)
        self.name = self.topic_name = f"/{name}"
        self.type, self.data_class = kind._type, kind
        self._node, self._key = node, name
        node.flow.bus.advertise(name, kind)

    def publish(self, *values: Any, **named: Any) -> None:
        """Publish a message, or one that is made of these values."""
        self._node.check()
        message: Any = values[0] if len(values) == 1 and not named else None
        if isinstance(message, Message):
            if type(message) is not self.data_class:
                raise TypeError(f"{self.name} is of {self.type}, got {message._type}")
        else:
            message = self.data_class(*values, **named)
        self._node.flow.bus.publish(self._key, message)

    def get_num_connections(self) -> int:
        """Count who listens."""
        return self._node.flow.bus.heard(self._key, self.data_class)

    get_subscription_count = get_num_connections

    def unregister(self) -> None:
        """Do nothing: it ends with the script."""


class Subscriber:
    """Listens to a topic; attributes as of a `Publisher`."""

    def __init__(
        self,
        node: Node,
        name: str,
        kind: type[Message],
        heard: Callable[[Any], None],
        size: int | None = None,
        at_once: bool = False,
    ) -> None:
        _check_class(name, kind)
        self.name = self.topic_name = f"/{name}"
        self.type, self.data_class = kind._type, kind
        self._bus, self._listener = node.flow.bus, Listener(name, kind, heard, size, at_once)
        late = node.flow.virtual and not at_once
        self._flow, self._made = node.flow, node.flow.steps if late else None
        self._bus.subscribe(self._listener)

    def get_num_connections(self) -> int:
        """Count who publishes; where time is stepped, nobody before some of it has passed."""
        if self._flow.steps == self._made:
            return 0
        return self._bus.told(self._listener.name, self.data_class)

    get_publisher_count = get_num_connections

    def unregister(self) -> None:
        """Listen no longer."""
        self._bus.unsubscribe(self._listener)


class Latest:
    """The newest message of a topic; made only when it is looked at, where that can be.

    Attributes:
        fresh: whether it is of the very moment when it is looked at
    """

    def __init__(self, node: Node, name: str, kind: type[Message]) -> None:
        _check_class(name, kind)
        self.name = self.topic_name = f"/{name}"
        self._node, self._key, self._kind = node, name, kind
        self._message: Any = None
        topic = node.flow.core.topics.get(name)
        served = topic is not None and topic.type == kind._type and topic.direction == "pub"
        self.fresh = served and node.flow.virtual and node.flow.peek(name) is not None
        if not self.fresh:
            Subscriber(node, name, kind, self._put, None, at_once=True)

    def _put(self, message: Any) -> None:
        self._message = message

    def get(self) -> Any:
        """Return the newest message, None before the first."""
        if self.fresh:
            fields = self._node.flow.peek(self._key)
            return None if fields is None else message_of(self._kind, fields)
        return self._message

    def get_num_connections(self) -> int:
        """Count who publishes."""
        return self._node.flow.bus.told(self._key, self._kind)

    def unregister(self) -> None:
        """Do nothing: it ends with the script."""


class ServiceProxy:
    """Calls a service; `proxy(a, b)`, `proxy(request)` and `proxy.call(request)` do the same."""

    def __init__(self, node: Node, name: str, kind: type) -> None:
        self.resolved_name = f"/{name}"
        self._node, self._key = node, name
        self._type = service_type(getattr(kind, "_type", str(kind)))
        self.request_class: Any = getattr(kind, "_request_class", None)
        self._response: Any = getattr(kind, "_response_class", None)

    def call(self, *values: Any, **named: Any) -> Any:
        """Return the answer.

        Raises:
            ServiceError: there is no such service, or it refused
        """
        self._node.check()
        request: Any = values[0] if len(values) == 1 and not named else None
        if not isinstance(request, self.request_class):
            request = self.request_class(*values, **named)
        core = self._node.flow.core
        served = core.services.get(self._key)
        if served is None or served.type != self._type.name:
            raise ServiceError(f"service [{self.resolved_name}] unavailable")
        try:
            answer = core.call(self._key, fields_of(request))
        except TrocarError as problem:
            raise ServiceError(f"service [{self.resolved_name}]: {problem}") from problem
        return message_of(self._response, complete(self._type.response, answer))

    __call__ = call

    def wait_for_service(self, timeout: float | None = None) -> bool:
        """Wait until the service is there."""
        return self._node.wait(lambda: self._key in self._node.flow.core.services, timeout)

    def close(self) -> None:
        """Do nothing: it ends with the script."""


def _check_class(name: str, kind: Any) -> None:
    if not (isinstance(kind, type) and issubclass(kind, Message)):
        raise TypeError(f"/{name}: got {kind!r}; allowed: a class of messages, as JointState")
