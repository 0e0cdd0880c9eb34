"""The part of rclpy that scripts use, over a simulation: nodes, topics, services, timers.

An installed crtk_python_client stands on it as well. Source of names and behaviour: rclpy's public
documentation (ROS 2 Humble and Jazzy).
"""

# Public attributes of our messages begin with an underscore, as genpy's.
# pyright: reportPrivateUsage=false

from __future__ import annotations

import re
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

from trocar.errors import TrocarError
from trocar.messages import blank, cdr_decode, cdr_encode, service_type
from trocar.messages.types import SECOND
from trocar.scripts import ros2_executors as executors
from trocar.scripts import ros2_settings as settings
from trocar.scripts.messages import Message, fields_of, message_of
from trocar.scripts.ros2_time import RclClock, RclDuration, RclRosClock, RclTime
from trocar.scripts.simulation import Flow, Subscription

#: A name of a topic, a service or a node. Source: ROS 2, "Topic and Service name mapping to DDS".
NAME = re.compile(r"(~/|/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")
#: A wait for a node that nothing spins is reported after so long. Source: our own choice. [s]
PATIENCE_S = 1.0


class RclInterruptException(Exception):  # noqa: N818  as scripts call it
    """The context was shut down while a rate or a clock waited."""


class NotInitializedException(Exception):  # noqa: N818  as scripts call it
    """A node was made before rclpy.init()."""


class InvalidTopicNameException(ValueError):  # noqa: N818  as scripts call it
    """A name that ROS 2 does not allow."""


class ParameterNotDeclaredException(Exception):  # noqa: N818  as scripts call it
    """A parameter that was not declared."""


class ParameterAlreadyDeclaredException(Exception):  # noqa: N818  as scripts call it
    """A parameter that was declared before."""


class RclContext:
    """Period of a script between `init` and `shutdown`.

    Attributes:
        valid: whether it was initialised, and not shut down
        ended: whether it was shut down
    """

    flow: ClassVar[Flow]

    def __init__(self) -> None:
        self.valid = self.ended = False
        self._farewells: list[Callable[[], object]] = []

    def init(self, args: Sequence[str] | None = None, **_: Any) -> None:  # noqa: ARG002
        """Make it valid.

        Raises:
            RuntimeError: it was so before
        """
        if self.valid:
            raise RuntimeError("Context.init() must only be called once")
        self.valid, self.ended = True, False

    def ok(self) -> bool:
        """Return whether it is valid."""
        self.flow.look()
        return self.valid

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """Have a function called at the end."""
        self._farewells.append(callback)

    def shutdown(self) -> None:
        """End it.

        Raises:
            RuntimeError: it is not valid
        """
        if not self.valid:
            raise RuntimeError("Context must be initialized before it can be shutdown")
        self.try_shutdown()

    def try_shutdown(self) -> None:
        """End it, if it is valid."""
        self.valid, self.ended = False, self.valid or self.ended
        farewells, self._farewells = self._farewells, []
        for farewell in farewells:
            farewell()

    def get_domain_id(self) -> int:
        """Return 0."""
        return 0


class RclTimer:
    """Calls a function after each period.

    Args:
        node: its node
        period_ns: the period [ns]
        callback: the function, without arguments
        group: of its callbacks
    """

    def __init__(
        self, node: RclNode, period_ns: int, callback: Callable[[], Any] | None, group: Any
    ) -> None:
        self._flow, self.callback_group = node.flow, group
        self.timer_period_ns, self.callback = period_ns, callback
        self.clock = node.get_clock()
        self._cancelled = False
        self.reset()

    def ready(self) -> bool:
        """Return whether it is due."""
        return not self._cancelled and self._flow.now_ns() >= self._next

    is_ready = ready

    def take(self) -> Callable[[], Any]:
        """Return its function, and count from the next period that has not passed."""
        self._last = now = self._flow.now_ns()
        self._next += self.timer_period_ns
        if self._next <= now and self.timer_period_ns:
            self._next += (now - self._next) // self.timer_period_ns * self.timer_period_ns
            self._next += self.timer_period_ns
        return self.callback or (lambda: None)

    def left_s(self) -> float | None:
        """Return the time until it is due, None of one that is cancelled [s]."""
        return None if self._cancelled else (self._next - self._flow.now_ns()) / SECOND

    def cancel(self) -> None:
        """Stop it."""
        self._cancelled = True

    def is_canceled(self) -> bool:
        """Return whether it is stopped."""
        return self._cancelled

    def reset(self) -> None:
        """Start it again, a period from now."""
        self._cancelled = False
        self._last = self._flow.now_ns()
        self._next = self._last + self.timer_period_ns

    def time_until_next_call(self) -> int | None:
        """Return the time until it is due [ns]."""
        return None if self._cancelled else self._next - self._flow.now_ns()

    def time_since_last_call(self) -> int:
        """Return the time since it was called [ns]."""
        return self._flow.now_ns() - self._last

    def destroy(self) -> None:
        """Stop it."""
        self.cancel()


class SpinRate:
    """Keeps a loop to a frequency, while another thread spins the node.

    Args:
        node: its node
        timer: of its frequency
    """

    def __init__(self, node: RclNode, timer: RclTimer) -> None:
        self._node, self._timer, self._count = node, timer, 0
        timer.callback = self._beat

    def _beat(self) -> None:
        self._count += 1

    def sleep(self) -> None:
        """Wait for the next turn.

        Raises:
            RclInterruptException: the context was shut down
        """
        before = self._count
        self._node.wait(lambda: self._count != before, "rate.sleep()", self._timer)
        if self._count == before:
            raise RclInterruptException

    def destroy(self) -> None:
        """End it."""
        self._node.destroy_timer(self._timer)


class RclEnd:
    """One end of a topic.

    Attributes:
        topic_name, topic: of the topic, with the first slash
        msg_type: class of its messages
        qos_profile: as asked for
    """

    def __init__(self, node: RclNode, msg_type: Any, topic: str, qos_profile: Any) -> None:
        self.node, self.key = node, node.key(topic)
        self.topic_name = self.topic = f"/{self.key}"
        if not (isinstance(msg_type, type) and issubclass(msg_type, Message)):
            wrong = f"{self.topic}: got {msg_type!r}; allowed: a class of messages, as JointState"
            raise TypeError(wrong)
        self.msg_type: Any = msg_type
        self.qos_profile = settings.QoSProfile.of(qos_profile)
        self._open = True

    def _incompatible(self, other: str, policy: str) -> None:
        """Warn as a middleware does; the ends are not connected."""
        self.node.get_logger().warning(
            f"{other} on topic '{self.topic_name}' offers or requests incompatible QoS. No messages"
            f" will be exchanged with it. Last incompatible policy: {policy}"
        )
        self._open = False


class RclPublisher(RclEnd):
    """Publishes to a topic."""

    def __init__(
        self, node: RclNode, msg_type: Any, topic: str, qos_profile: Any, *_: Any, **__: Any
    ) -> None:
        super().__init__(node, msg_type, topic, qos_profile)
        bus = node.flow.bus
        bus.advertise(self.key, self.msg_type)
        weak = self.qos_profile.reliability == settings.ReliabilityPolicy.BEST_EFFORT
        if weak and bus.listens(self.key, self.msg_type):
            self._incompatible("The subscription of the robot", "RELIABILITY")

    def publish(self, msg: Any) -> None:
        """Publish a message."""
        if not self.node.context.valid:
            raise RuntimeError("Failed to publish: publisher's context is invalid")
        if type(msg) is not self.msg_type:
            raise TypeError(f"Expected {self.msg_type}, got {type(msg)}")
        if self._open:
            self.node.flow.bus.publish(self.key, msg)

    def get_subscription_count(self) -> int:
        """Count the subscriptions."""
        self.node.flow.look()
        return self.node.flow.bus.subscribers(self.key, self.msg_type) if self._open else 0

    def destroy(self) -> None:
        """End it."""
        self.node.destroy_publisher(self)


class RclSubscription(RclEnd):
    """Has a function called with each message of a topic, where its node is spun."""

    def __init__(
        self,
        node: RclNode,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: Any,
        group: Any,
        raw: bool = False,
    ) -> None:
        super().__init__(node, msg_type, topic, qos_profile)
        self.callback, self.callback_group, self._raw = callback, group, raw
        profile = self.qos_profile
        every = profile.history == settings.HistoryPolicy.KEEP_ALL
        self._waiting: deque[Any] = deque(maxlen=None if every else max(1, profile.depth))
        late = profile.durability == settings.DurabilityPolicy.TRANSIENT_LOCAL
        bus = node.flow.bus
        if late and bus.speaks(self.key, self.msg_type) and not bus.latches(self.key):
            self._incompatible("The publisher of the robot", "DURABILITY")
        self._heard = Subscription(
            self.key, self.msg_type, self._waiting.append, at_once=True, late=late
        )
        if self._open:
            bus.subscribe(self._heard)

    def ready(self) -> bool:
        """Return whether a message waits."""
        return bool(self._waiting)

    def take(self) -> Callable[[], Any]:
        """Return a call with the oldest message."""
        message = self._waiting.popleft()
        if self._raw:
            message = serialize_message(message)
        return lambda: self.callback(message)

    def get_publisher_count(self) -> int:
        """Count the publishers."""
        self.node.flow.look()
        return self.node.flow.bus.publishers(self.key, self.msg_type) if self._open else 0

    def destroy(self) -> None:
        """End it."""
        self.node.destroy_subscription(self)

    def unsubscribe(self) -> None:
        """Receive no more messages."""
        self.node.flow.bus.unsubscribe(self._heard)


class RclService:
    """Answers calls of a service; those of the script's own clients, which alone can reach it."""

    def __init__(
        self, node: RclNode, srv_type: Any, srv_name: str, callback: Callable[..., Any], group: Any
    ) -> None:
        self.key, self.srv_type, self.callback = node.key(srv_name), srv_type, callback
        self.srv_name = self.service_name = f"/{self.key}"
        self.callback_group = group
        self._requests: deque[tuple[Any, Any]] = deque()

    def ask(self, request: Any, future: Any) -> None:
        """Have a request answered."""
        self._requests.append((request, future))

    def ready(self) -> bool:
        """Return whether a request waits."""
        return bool(self._requests)

    def take(self) -> Callable[[], Any]:
        """Return the answer to the oldest request."""
        request, future = self._requests.popleft()

        def answer() -> None:
            future.set_result(self.callback(request, self.srv_type.Response()))

        return answer


class RclClient:
    """Calls a service."""

    def __init__(self, node: RclNode, srv_type: Any, srv_name: str, group: Any) -> None:
        self.node, self.key, self.srv_type = node, node.key(srv_name), srv_type
        self.srv_name = self.service_name = f"/{self.key}"
        self.callback_group = group
        self._type = service_type(getattr(srv_type, "_type", str(srv_type)))
        self._answers: deque[Callable[[], None]] = deque()

    def service_is_ready(self) -> bool:
        """Return whether the service is there."""
        self.node.flow.look()
        served = self.node.flow.core.services.get(self.key)
        return self.key in self.node.run.services or (
            served is not None and served.type == self._type.name
        )

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Wait for the service; return whether it is there in time [s]."""
        self.node.flow.wait(
            lambda: self.service_is_ready() or not self.node.context.valid, timeout_sec
        )
        return self.service_is_ready()

    def call_async(self, request: Any) -> Any:
        """Return the future of the answer.

        Raises:
            TypeError: the request is of another type
        """
        if not isinstance(request, self.srv_type.Request):
            raise TypeError(f"Expected {self.srv_type.Request}, got {type(request)}")
        future = self.node.run.Future()
        own = self.node.run.services.get(self.key)
        if own is not None:
            own.ask(request, future)
            return future
        try:
            answer = self.node.flow.core.call(self.key, fields_of(request))
        except TrocarError as problem:
            self.node.get_logger().warning(f"{self.srv_name}: no answer: {problem}")
            return future
        made = message_of(self.srv_type.Response, {**blank(self._type.response), **answer})
        self._answers.append(lambda: future.set_result(made))
        return future

    def call(self, request: Any, timeout_sec: float | None = None) -> Any:
        """Return the answer, which comes while another thread spins the node."""
        future = self.call_async(request)
        self.node.wait(lambda: future.finished, f"{self.srv_name}: call()", timeout_s=timeout_sec)
        return future.result()

    def ready(self) -> bool:
        """Return whether an answer is there."""
        return bool(self._answers)

    def take(self) -> Callable[[], Any]:
        """Return a call that completes the oldest future."""
        return self._answers.popleft()

    def destroy(self) -> None:
        """End it."""
        self.node.destroy_client(self)


class RclNode:
    """A node.

    Args:
        node_name: its name
        context: that it belongs to
        cli_args: words that count beside those of the script
        namespace: of its name and of relative names
        use_global_arguments: whether the script's own words count
        parameter_overrides: parameters that replace what is declared
        allow_undeclared_parameters: whether parameters may be set that are not declared
        automatically_declare_parameters_from_overrides: declare those of the command line
    """

    run: ClassVar[Ros2]
    flow: ClassVar[Flow]

    def __init__(
        self,
        node_name: str,
        *,
        context: Any = None,
        cli_args: Sequence[str] | None = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        parameter_overrides: Iterable[settings.RclParameter] | None = None,
        allow_undeclared_parameters: bool = False,
        automatically_declare_parameters_from_overrides: bool = False,
        **_: Any,
    ) -> None:
        self.context: Any = context or self.run.default_context
        if not self.context.valid:
            raise NotInitializedException("rclpy.init() has not been called", "cannot create node")
        if not re.fullmatch(r"[A-Za-z_]\w*", node_name):
            raise ValueError(f"Invalid node name: got {node_name!r}; allowed: letters, digits, _")
        arguments = settings.RosArguments()
        if use_global_arguments:
            arguments.read(self.run.arguments)
        arguments.read(cli_args or ())
        self._remaps: Mapping[str, str] = arguments.remaps
        self._name = arguments.remaps.get("__node", node_name)
        self._namespace = arguments.remaps.get("__ns", namespace or "").strip("/")
        self._overrides = {one.name: one.value for one in parameter_overrides or ()}
        self._overrides = {**arguments.parameters, **self._overrides}
        self._parameters: dict[str, settings.RclParameter] = {}
        self._descriptors: dict[str, Any] = {}
        self._undeclared = allow_undeclared_parameters
        self._on_set: list[Callable[[list[Any]], Any]] = []
        self._timers: list[RclTimer] = []
        self._subscriptions: list[RclSubscription] = []
        self._publishers: list[RclPublisher] = []
        self._clients: list[RclClient] = []
        self._services: list[RclService] = []
        self.executor: Any = None
        self.default_callback_group = executors.MutuallyExclusiveCallbackGroup()
        self._clock = self.run.ROSClock()
        self._logger = self.run.Logger(".".join(filter(None, [self._namespace, self._name])))
        self.run.nodes.append(self)
        if automatically_declare_parameters_from_overrides:
            for name, value in self._overrides.items():
                self.declare_parameter(name, value)

    def __enter__(self) -> RclNode:
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy_node()

    # ------------------------------------------------------------------ for executors

    def entities(self) -> Iterator[Any]:
        """Yield the work of an executor: timers first."""
        for kind in (self._timers, self._subscriptions, self._clients, self._services):
            yield from tuple(kind)

    def due_s(self) -> Iterator[float]:
        """Yield the times until timers are due [s]."""
        for timer in tuple(self._timers):
            left = timer.left_s()
            if left is not None and left > 0.0:
                yield left

    def wait(
        self,
        ready: Callable[[], bool],
        what: str,
        timer: RclTimer | None = None,
        timeout_s: float | None = None,
    ) -> None:
        """Wait for something that comes while another thread spins the node; warn if none does."""

        def over() -> bool:
            return ready() or not self.context.valid

        patience = PATIENCE_S + (timer.timer_period_ns / SECOND if timer else 0.0)
        if timeout_s is not None and timeout_s <= patience:
            self.flow.wait(over, timeout_s)
            return
        if not self.flow.wait(over, patience):
            self._logger.warning(
                f"{what} waits for ever unless another thread spins node {self._name!r}", once=True
            )
            self.flow.wait(over, None if timeout_s is None else timeout_s - patience)

    def key(self, name: str) -> str:
        """Return a whole name without the first slash.

        Raises:
            InvalidTopicNameException: ROS 2 does not allow the name
        """
        if not NAME.fullmatch(name):
            raise InvalidTopicNameException(
                f"Invalid topic name: got {name!r}; allowed: words of letters, digits and _ between"
                " single slashes, none of which begins with a digit"
            )
        name = self._remaps.get(name, name)
        if name.startswith("~/"):
            found = f"{self._namespace}/{self._name}/{name[2:]}"
        else:
            found = name if name.startswith("/") else f"{self._namespace}/{name}"
        found = found.strip("/")
        return self._remaps.get(f"/{found}", found).strip("/")

    # ------------------------------------------------------------------ names

    def get_name(self) -> str:
        """Return its name."""
        return self._name

    def get_namespace(self) -> str:
        """Return its namespace."""
        return f"/{self._namespace}"

    def get_fully_qualified_name(self) -> str:
        """Return namespace and name."""
        return f"/{self._namespace}/{self._name}".replace("//", "/")

    def get_clock(self) -> RclClock:
        """Return its clock, of ROS_TIME."""
        return self._clock

    def get_logger(self) -> settings.RclLogger:
        """Return its logger."""
        return self._logger

    def resolve_topic_name(self, topic: str, **_: Any) -> str:
        """Return a whole name."""
        return f"/{self.key(topic)}"

    resolve_service_name = resolve_topic_name

    def get_topic_names_and_types(self, *_: Any, **__: Any) -> list[tuple[str, list[str]]]:
        """List topics with their types."""
        topics = (topic for topic in self.flow.core.topics.values() if not topic.later)
        return sorted((f"/{t.name}", [t.type.replace("/", "/msg/")]) for t in topics)

    def get_service_names_and_types(self) -> list[tuple[str, list[str]]]:
        """List services with their types."""
        rows = self.flow.core.services.values()
        return sorted((f"/{row.name}", [row.type.replace("/", "/srv/")]) for row in rows)

    def get_node_names(self) -> list[str]:
        """List the names of nodes."""
        return [node._name for node in self.run.nodes]

    def count_publishers(self, topic_name: str) -> int:
        """Count the publishers of a topic."""
        return self.flow.bus.publishers(self.key(topic_name), None)

    def count_subscribers(self, topic_name: str) -> int:
        """Count the subscriptions to a topic."""
        return self.flow.bus.subscribers(self.key(topic_name), None)

    # ------------------------------------------------------------------ topics, services, timers

    @property
    def publishers(self) -> Iterator[Any]:
        """Its publishers."""
        yield from self._publishers

    @property
    def subscriptions(self) -> Iterator[Any]:
        """Its subscriptions."""
        yield from self._subscriptions

    @property
    def timers(self) -> Iterator[Any]:
        """Its timers."""
        yield from self._timers

    @property
    def clients(self) -> Iterator[Any]:
        """Its clients."""
        yield from self._clients

    @property
    def services(self) -> Iterator[Any]:
        """Its services."""
        yield from self._services

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: Any, **options: Any
    ) -> RclPublisher:
        """Return a publisher of a topic."""
        made = self.run.Publisher(self, msg_type, topic, qos_profile, **options)
        self._publishers.append(made)
        return made

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: Any,
        *,
        callback_group: Any = None,
        raw: bool = False,
        **_: Any,
    ) -> RclSubscription:
        """Have a function called with each message of a topic."""
        group = callback_group or self.default_callback_group
        made = self.run.Subscription(self, msg_type, topic, callback, qos_profile, group, raw)
        self._subscriptions.append(made)
        return made

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[[], Any] | None,
        callback_group: Any = None,
        clock: Any = None,  # noqa: ARG002  all show the same time
        autostart: bool = True,
    ) -> RclTimer:
        """Have a function called after each period [s]."""
        group = callback_group or self.default_callback_group
        made = self.run.Timer(self, round(float(timer_period_sec) * SECOND), callback, group)
        if not autostart:
            made.cancel()
        self._timers.append(made)
        return made

    def create_rate(self, frequency: float, clock: Any = None) -> SpinRate:
        """Return a rate that keeps a loop to a frequency [Hz].

        Raises:
            ValueError: the frequency is not above 0
        """
        if frequency <= 0.0:
            raise ValueError(f"frequency must be > 0: got {frequency}")
        group = executors.ReentrantCallbackGroup()
        timer = self.create_timer(1.0 / frequency, None, group, clock)
        return self.run.Rate(self, timer)

    def create_client(
        self, srv_type: Any, srv_name: str, *, callback_group: Any = None, **_: Any
    ) -> RclClient:
        """Return a caller of a service."""
        group = callback_group or self.default_callback_group
        made = self.run.Client(self, srv_type, srv_name, group)
        self._clients.append(made)
        return made

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[..., Any],
        *,
        callback_group: Any = None,
        **_: Any,
    ) -> RclService:
        """Have a function answer the script's own calls of a service."""
        group = callback_group or self.default_callback_group
        made = self.run.Service(self, srv_type, srv_name, callback, group)
        self._services.append(made)
        self.run.services[made.key] = made
        return made

    def create_guard_condition(self, callback: Callable[[], Any], group: Any = None) -> Any:
        """Return something to trigger, which has a function called."""
        timer = self.create_timer(0.0, None, group)
        timer.cancel()

        def once() -> Any:
            timer.cancel()
            return callback()

        timer.callback = once
        timer.__dict__["trigger"] = timer.reset
        return timer

    def destroy_publisher(self, publisher: Any) -> bool:
        """End a publisher."""
        return _removed(self._publishers, publisher)

    def destroy_subscription(self, subscription: Any) -> bool:
        """End a subscription."""
        if subscription in self._subscriptions:
            subscription.unsubscribe()
        return _removed(self._subscriptions, subscription)

    def destroy_timer(self, timer: Any) -> bool:
        """End a timer."""
        timer.cancel()
        return _removed(self._timers, timer)

    def destroy_rate(self, rate: SpinRate) -> bool:
        """End a rate."""
        rate.destroy()
        return True

    def destroy_client(self, client: Any) -> bool:
        """End a client."""
        return _removed(self._clients, client)

    def destroy_service(self, service: Any) -> bool:
        """End a service."""
        self.run.services.pop(service.key, None)
        return _removed(self._services, service)

    def destroy_node(self) -> None:
        """End all that it has."""
        for subscription in tuple(self._subscriptions):
            self.destroy_subscription(subscription)
        for service in tuple(self._services):
            self.destroy_service(service)
        self._timers, self._publishers, self._clients = [], [], []
        if self.executor is not None:
            self.executor.remove_node(self)
        if self in self.run.nodes:
            self.run.nodes.remove(self)

    # ------------------------------------------------------------------ parameters

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: Any = None, ignore_override: bool = False
    ) -> settings.RclParameter:
        """Declare a parameter with a default, or its type; the command line's value counts.

        Raises:
            ParameterAlreadyDeclaredException: it is declared
        """
        if name in self._parameters:
            raise ParameterAlreadyDeclaredException(f"Parameter(s) already declared: {name!r}")
        if isinstance(value, settings.ParameterKind):
            value = None
        if name in self._overrides and not ignore_override:
            given = self._overrides[name]
            if type(value) is float and type(given) is int:
                raise TypeError(
                    f"parameter {name!r}: got the integer {given} on the command line; allowed: a"
                    f" double, as {given}.0"
                )
            value = given
        self._parameters[name] = self.run.Parameter(name, None, value)
        self._descriptors[name] = descriptor or settings.ParameterDescriptor(name=name)
        return self._parameters[name]

    def declare_parameters(
        self, namespace: str, parameters: Iterable[tuple[Any, ...]], ignore_override: bool = False
    ) -> list[settings.RclParameter]:
        """Declare parameters: tuples of name, value, descriptor."""
        found: list[settings.RclParameter] = []
        for name, *rest in parameters:
            whole = f"{namespace}.{name}" if namespace else name
            found.append(self.declare_parameter(whole, *rest, ignore_override=ignore_override))
        return found

    def undeclare_parameter(self, name: str) -> None:
        """Forget a parameter."""
        self.get_parameter(name)
        self._parameters.pop(name, None)

    def has_parameter(self, name: str) -> bool:
        """Return whether a parameter is declared."""
        return name in self._parameters

    def get_parameter(self, name: str) -> settings.RclParameter:
        """Return a parameter.

        Raises:
            ParameterNotDeclaredException: it is not declared
        """
        if name not in self._parameters:
            if self._undeclared:
                return self.run.Parameter(name)
            raise ParameterNotDeclaredException(f"Invalid access to undeclared parameter: {name!r}")
        return self._parameters[name]

    def get_parameters(self, names: Iterable[str]) -> list[settings.RclParameter]:
        """Return parameters."""
        return [self.get_parameter(name) for name in names]

    def get_parameter_or(self, name: str, alternative_value: Any = None) -> Any:
        """Return a parameter, or another where it is not set."""
        found = self._parameters.get(name)
        if found is None or found.value is None:
            return alternative_value or self.run.Parameter(name)
        return found

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, settings.RclParameter]:
        """Return {rest of the name: parameter} of those below a prefix."""
        start = f"{prefix}." if prefix else ""
        return {
            n.removeprefix(start): p for n, p in self._parameters.items() if n.startswith(start)
        }

    def set_parameters(self, parameter_list: Sequence[settings.RclParameter]) -> list[Any]:
        """Set parameters one by one; return how each went."""
        return [self.set_parameters_atomically([one]) for one in parameter_list]

    def set_parameters_atomically(self, parameter_list: Sequence[settings.RclParameter]) -> Any:
        """Set all parameters, or none."""
        for one in parameter_list:
            if not self._undeclared:
                self.get_parameter(one.name)
            if getattr(self._descriptors.get(one.name), "read_only", False):
                reason = f"{one.name} is read-only"
                return settings.SetParametersResult(successful=False, reason=reason)
        for check in self._on_set:
            result = check(list(parameter_list))
            if not result.successful:
                return result
        self._parameters |= {one.name: one for one in parameter_list}
        return settings.SetParametersResult(successful=True)

    def add_on_set_parameters_callback(self, callback: Callable[[list[Any]], Any]) -> None:
        """Have a function check parameters before they are set."""
        self._on_set.insert(0, callback)

    def remove_on_set_parameters_callback(self, callback: Callable[[list[Any]], Any]) -> None:
        """Undo `add_on_set_parameters_callback`."""
        self._on_set.remove(callback)

    def describe_parameter(self, name: str) -> Any:
        """Return the descriptor of a parameter."""
        self.get_parameter(name)
        return self._descriptors.get(name)


def _removed(entries: list[Any], one: Any) -> bool:
    found = one in entries
    if found:
        entries.remove(one)
    return found


def serialize_message(message: Message) -> bytes:
    """Return a message as bytes (CDR)."""
    return cdr_encode(message._type, fields_of(message))


def deserialize_message(serialized_message: bytes, message_type: Any) -> Any:
    """Return the message of bytes (CDR)."""
    return message_of(message_type, cdr_decode(message_type._type, bytes(serialized_message)))


class Ros2:
    """The ROS 2 that a script finds: rclpy's classes and functions over one simulation.

    Args:
        flow: the simulation beneath
        thread: the class of the script's own threads

    Attributes:
        default_context: of nodes that are given none
        nodes: that were made
        services: {name without the first slash: the script's own service}
        arguments: the script's command line
    """

    def __init__(self, flow: Flow, thread: type[threading.Thread] = threading.Thread) -> None:
        self.flow = flow
        self.nodes: list[RclNode] = []
        self.services: dict[str, RclService] = {}
        self.arguments: Sequence[str] = ()
        own: dict[str, Any] = {"run": self, "flow": flow}
        self.Context: Any = type("Context", (RclContext,), own)
        self.default_context: RclContext = self.Context()
        self._global: Any = None
        self.Clock: Any = type("Clock", (RclClock,), own)
        self.ROSClock: Any = type("ROSClock", (RclRosClock,), own)
        self.Logger: Any = type("RcutilsLogger", (settings.RclLogger,), own)
        self.Future: Any = type("Future", (executors.RclFuture,), own)
        self.Task: Any = type("Task", (executors.RclTask,), own)
        self.Executor: Any = type("Executor", (executors.SpinExecutor,), own)
        self.SingleThreadedExecutor: Any = type("SingleThreadedExecutor", (self.Executor,), {})
        self.MultiThreadedExecutor: Any = type(
            "MultiThreadedExecutor", (executors.PoolExecutor,), {**own, "thread": thread}
        )
        self.Node: Any = type("Node", (RclNode,), own)
        self.Publisher: Any = type("Publisher", (RclPublisher,), {})
        self.Subscription: Any = type("Subscription", (RclSubscription,), {})
        self.Service: Any = type("Service", (RclService,), {})
        self.Client: Any = type("Client", (RclClient,), {})
        self.Timer: Any = type("Timer", (RclTimer,), {})
        self.Rate: Any = type("Rate", (SpinRate,), {})
        self.Time: Any = type("Time", (RclTime,), {"__slots__": ()})
        self.Duration: Any = type("Duration", (RclDuration,), {"__slots__": ()})
        self.Parameter: Any = type("Parameter", (settings.RclParameter,), {})
        self._loggers: dict[str, settings.RclLogger] = {}

    # ------------------------------------------------------------------ functions of rclpy

    def init(self, *, args: Sequence[str] | None = None, context: Any = None, **_: Any) -> None:
        """Begin."""
        self.arguments = tuple(sys.argv if args is None else args)
        (context or self.default_context).init()

    def shutdown(self, *, context: Any = None, uninstall_handlers: Any = None) -> None:  # noqa: ARG002
        """End: spinning returns, and waits fail."""
        (context or self.default_context).shutdown()

    def try_shutdown(self, *, context: Any = None, **_: Any) -> None:
        """End, if it is not over."""
        (context or self.default_context).try_shutdown()

    def ok(self, *, context: Any = None) -> bool:
        """Return whether it has begun, and is not over."""
        return (context or self.default_context).ok()

    def create_node(self, node_name: str, **options: Any) -> RclNode:
        """Return a node."""
        return self.Node(node_name, **options)

    def get_default_context(self, *, shutting_down: bool = False) -> RclContext:  # noqa: ARG002
        """Return the context of nodes that are given none."""
        return self.default_context

    def get_global_executor(self) -> Any:
        """Return the executor of `spin` and its like."""
        if self._global is None or self._global._over:
            self._global = self.SingleThreadedExecutor()
        return self._global

    def spin(self, node: RclNode, executor: Any = None) -> None:
        """Run callbacks of a node until the end."""
        chosen = executor or self.get_global_executor()
        try:
            chosen.add_node(node)
            while chosen.context.ok():
                chosen.spin_once()
        finally:
            chosen.remove_node(node)

    def spin_once(
        self, node: RclNode, *, executor: Any = None, timeout_sec: float | None = None
    ) -> None:
        """Run one callback of a node, waiting for it some time [s]."""
        chosen = executor or self.get_global_executor()
        try:
            chosen.add_node(node)
            chosen.spin_once(timeout_sec=timeout_sec)
        finally:
            chosen.remove_node(node)

    def spin_until_future_complete(
        self, node: RclNode, future: Any, executor: Any = None, timeout_sec: float | None = None
    ) -> None:
        """Run callbacks of a node until a future is there, or some time has passed [s]."""
        chosen = executor or self.get_global_executor()
        try:
            chosen.add_node(node)
            chosen.spin_until_future_complete(future, timeout_sec)
        finally:
            chosen.remove_node(node)

    def get_logger(self, name: str) -> settings.RclLogger:
        """Return the logger of a name."""
        return self._loggers.setdefault(name, self.Logger(name))

    def set_logger_level(self, name: str, level: settings.Severity, **_: Any) -> None:
        """Set the least severity that a logger shows."""
        self.get_logger(name).set_level(level)

    def wait_for_message(
        self, msg_type: Any, node: RclNode, topic: str, *, qos_profile: Any = 1,
        time_to_wait: float = -1,
    ) -> tuple[bool, Any]:  # fmt: skip
        """Wait for a message of a topic [s]; return whether one came, and it."""
        came: list[Any] = []
        subscription = RclSubscription(
            node, msg_type, topic, came.append, qos_profile, node.default_callback_group
        )
        patience = None if time_to_wait < 0 else time_to_wait
        self.flow.wait(lambda: subscription.ready() or not self.default_context.valid, patience)
        subscription.unsubscribe()
        if not subscription.ready():
            return False, None
        subscription.take()()
        return True, came[0]
