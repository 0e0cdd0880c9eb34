"""ROS 2: the core's topics, services and parameters by rclpy, which comes with ROS 2; on any RMW.

Messages travel as our own bytes, so a message class only names the type to rclpy; services have
objects of theirs. Services are a node of their own, so that no call holds up commands.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
from collections.abc import Callable, Generator, Mapping, MutableMapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING, Any

from trocar.errors import InputError, TrocarError
from trocar.messages import (
    MessageType,
    ServiceType,
    cdr_decode,
    cdr_encode,
    message_type,
    service_type,
)
from trocar.ros.parameters import MODEL, SIMULATED, Parameters
from trocar.ros.queues import ImageQueue
from trocar.ros.services import answered

if TYPE_CHECKING:
    from trocar.ros.core import Batch, Core
    from trocar.ros.topic import Message, Service, Topic

_log = logging.getLogger("trocar")

NODE = "trocar"
#: Period of counting subscribers: Humble has no event of them. Source: our own choice. [s]
LOOK_S = 0.02
#: Period of comparing the model with the rig's, whose tools may be exchanged. [s]
MODEL_S = 1.0
#: Pause after a failure of rclpy, and the longest time for its callbacks to end. [s]
PAUSE_S, CLOSING_S = 0.1, 5.0
#: Longest time of a service call. Source: our own choice. [s]
SERVICE_S = 5.0
#: Depth of the queues of ordered commands; the core rejects and reports sooner.
COMMANDS = 1024

# ---------------------------------------------------------------------- rclpy


@dataclass(frozen=True)
class Rclpy:
    """The modules of rclpy that are used here."""

    rclpy: ModuleType
    context: ModuleType
    exceptions: ModuleType
    executors: ModuleType
    parameter: ModuleType
    qos: ModuleType
    serialization: ModuleType
    interfaces: ModuleType


class MissingRclpyError(InputError):
    """This Python cannot import rclpy.

    Attributes:
        python: which one
        reason: why not
        there: whether there is an rclpy, though of another Python
    """

    def __init__(self, python: str, reason: str, *, there: bool) -> None:
        self.python, self.reason, self.there = python, reason, there
        super().__init__(
            f"--ros2 rclpy: {python} cannot import rclpy ({reason}). It comes with ROS 2:"
            " source /opt/ros/DISTRO/setup.bash, and run trocar with the Python that this ROS 2 is"
            " made for (Jazzy: 3.12); or use --ros2 dds, which needs no ROS (docs/ros.md, ROS 2)"
        )


def load() -> Rclpy:
    """Import rclpy.

    Raises:
        MissingRclpyError: this Python has no rclpy
    """
    names = ("context", "exceptions", "executors", "parameter", "qos", "serialization")
    modules = ["rclpy", *(f"rclpy.{name}" for name in names), "rcl_interfaces.msg"]
    try:
        return Rclpy(*map(import_module, modules))
    except ImportError as error:
        try:
            there = find_spec("rclpy") is not None
        except ValueError:  # sys.modules has None for it
            there = False
        raise MissingRclpyError(sys.executable, str(error), there=there) from error


RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
#: Variables that set the discovery range of ROS 2.
REACH = (
    RANGE,
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "CYCLONEDDS_URI",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
)


@contextmanager
def kept_local(environment: MutableMapping[str, str]) -> Generator[None]:
    """Let rclpy, which reads the environment in the block, stay on this machine by default.

    By default, a node of ROS 2 discovers all nodes of the network, and each of them can command
    the arms. Source: ROS 2, "Improved Dynamic Discovery"; a node restricted to its machine also
    discovers unrestricted nodes on that machine.
    """
    before = environment.get(RANGE)
    if any(environment.get(name) for name in REACH):
        yield
        return
    environment[RANGE] = "LOCALHOST"
    try:
        yield
    finally:
        environment.pop(RANGE)
        if before is not None:
            environment[RANGE] = before


def reach(environment: Mapping[str, str]) -> str:
    """Return in words which programs a node meets."""
    said = {name: environment[name] for name in REACH if environment.get(name)}
    if not said:
        return "with programs on this machine"
    if said.get("ROS_LOCALHOST_ONLY") == "0":
        del said["ROS_LOCALHOST_ONLY"]
    if "ROS_LOCALHOST_ONLY" in said or said.get(RANGE, "").upper() == "LOCALHOST":
        return "with programs on this machine"
    if not said or said == {RANGE: "SUBNET"}:
        return "with the whole network, without any password"
    return f"without any password, where {' and '.join(said)} {'say' if len(said) > 1 else 'says'}"


# ---------------------------------------------------------------------- classes of the workspace

#: Sources of the packages that no distribution of ROS 2 has.
SOURCES = {
    "crtk_msgs": "github.com/collaborative-robotics/crtk_msgs",
    "cisst_msgs": "github.com/jhu-cisst/cisst-ros",
    "trocar_msgs": "docs/ros.md, ROS 2",
}


class MissingTypeError(TrocarError):
    """The workspace has no such type as ours, in the package where it should be."""

    def __init__(self, package: str, problem: str = "") -> None:
        what = f"{package}, {problem}" if problem else package
        source = SOURCES.get(package)
        super().__init__(f"{what} ({source})" if source else what)


def message_class(kind: MessageType) -> Any:
    """Return the class of a message.

    Raises:
        MissingTypeError: the class is missing, or has other fields
    """
    found = _class(kind.ros2_name)
    _check(kind, found)
    return found


def service_class(kind: ServiceType) -> Any:
    """Return the class of a service, with `Request` and `Response`.

    Raises:
        MissingTypeError: the class is missing, or has other fields
    """
    found = _class(kind.ros2_name)
    for half, name in ((kind.request, "Request"), (kind.response, "Response")):
        _check(half, getattr(found, name, None))
    return found


def _class(name: str) -> Any:
    package, folder, own = name.split("/")
    try:
        module = import_module(f"{package}.{folder}")
    except ImportError as error:
        raise MissingTypeError(package) from error
    found = getattr(module, own, None)
    if found is None:
        raise MissingTypeError(package, f"which has no {own}")
    return found


def _check(kind: MessageType, found: Any) -> None:
    """Check that a class has the fields that are written: nothing checks the bytes later."""
    package = kind.ros2_name.split("/")[0]
    fields = getattr(found, "get_fields_and_field_types", None)
    if fields is None:
        raise MissingTypeError(package, "which is not a ROS 2 package")
    if list(fields()) != [field.name for field in kind.fields if not field.only_ros1]:
        raise MissingTypeError(package, f"in which {kind.name} has other fields")


# ---------------------------------------------------------------------- node


class NoAnswerError(Exception):
    """Raised by a service's callback so that rclpy answers nothing; the reason is logged."""


class RclpyNode:
    """A node and the thread of its callbacks, one, since rclpy's for several costs much more.

    Args:
        library: rclpy
        context: initialised
        name: of the node
        parameters: whether it has parameter services

    Attributes:
        own: rclpy's node
    """

    def __init__(
        self, library: Rclpy, context: Any, name: str, *, parameters: bool = False
    ) -> None:
        self._context = context
        self.own = library.rclpy.create_node(
            name,
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=parameters,
        )
        self._executor = library.executors.SingleThreadedExecutor(context=context)
        self._executor.add_node(self.own)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._spin, name=f"trocar-ros2-{name}", daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self) -> None:
        """End after the callback that runs, and leave."""
        self._over.set()
        self._executor.shutdown(timeout_sec=CLOSING_S)
        if self._thread.is_alive():
            self._thread.join(CLOSING_S)
        self.own.destroy_node()

    def _spin(self) -> None:
        while not self._over.is_set() and self._context.ok():
            try:
                self._executor.spin_once()
            except NoAnswerError:
                continue
            except Exception:  # noqa: BLE001  rclpy passes on whatever went wrong within
                if self._over.is_set() or not self._context.ok():
                    break
                _log.exception("ROS 2: error in rclpy, continuing")
                self._over.wait(PAUSE_S)
        if not self._over.is_set():
            _log.warning("ROS 2 stopped: rclpy was shut down; the simulation continues")


class RclpyTransport:
    """Be a node of ROS 2.

    Args:
        node: its name

    Attributes:
        lost: messages that rclpy did not take
        greeting: lines to print at the start: which RMW and domain, what is left out

    Raises:
        MissingRclpyError: this Python has no rclpy
    """

    name = "ros2"

    def __init__(self, node: str = NODE) -> None:
        self._ros = load()
        self.node = node
        self.lost = 0
        self.greeting = ""
        self._context: Any = None
        self._nodes: list[RclpyNode] = []
        self._publishers: dict[str, Any] = {}
        self._subscribed: frozenset[str] = frozenset()
        self._heard: set[str] = set()
        self._lacking: dict[str, int] = {}
        self._images = ImageQueue(self._publish)
        self._over = threading.Event()
        self._model = ""
        self._threads = [
            threading.Thread(target=work, name=f"trocar-ros2-{name}", daemon=True)
            for name, work in (("watch", self._watch), ("model", self._describe))
        ]

    # ------------------------------------------------------------------ life

    def start(self, core: Core) -> None:
        """Become a node with every topic and service of the core that the workspace has types for.

        Raises:
            TrocarError: rclpy refuses
        """
        self._core = core
        try:
            self._open(core)
        except (RuntimeError, ValueError, OSError) as error:
            self.close()
            raise TrocarError(f"--ros2: rclpy cannot start its node: {error}") from error

    def close(self) -> None:
        """Destroy the nodes, and shut down what was initialised here."""
        self._over.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()
        self._images.close()
        self._publishers, self._subscribed = {}, frozenset()
        nodes, self._nodes = self._nodes, []
        for node in nodes:
            node.close()
        context, self._context = self._context, None
        if context is not None:
            context.try_shutdown()

    def _open(self, core: Core) -> None:
        self._context = context = self._ros.context.Context()
        with kept_local(os.environ):  # a context of our own leaves the process its signals
            self._ros.rclpy.init(args=[], context=context)
        topics = RclpyNode(self._ros, context, self.node, parameters=True)
        self._nodes.append(topics)
        services = RclpyNode(self._ros, context, f"{self.node}_services")
        self._nodes.append(services)
        self._parameters = Parameters(core)
        self._gains = set(self._parameters.names()) - {MODEL, SIMULATED}
        for name, value in self._parameters.read(self._gains).items():
            topics.own.declare_parameter(name, value)
        topics.own.add_on_set_parameters_callback(self._set)
        for topic in core.topics.values():
            if not topic.later:
                register = self._advertise if topic.direction == "pub" else self._listen
                self._try(register, topic, topics.own)
        for service in core.services.values():
            self._try(self._serve, service, services.own)
        rmw = self._ros.rclpy.get_rmw_implementation_identifier()
        domain = context.get_domain_id()
        lines = [f"ROS 2: node /{self.node} by rclpy, {rmw}, domain {domain}; {reach(os.environ)}"]
        lines += [
            f"  without {what}: {count} topics and services are left out"
            for what, count in sorted(self._lacking.items())
        ]
        self.greeting = "\n".join(lines)
        for name in self._publishers:
            last = core.latched(name)
            if last is not None:
                self._publish((core.topics[name], last))
        for node in self._nodes:
            node.start()
        for thread in self._threads:
            thread.start()

    def _try(self, register: Callable[[Any, Any], None], row: Topic | Service, own: Any) -> None:
        """Register a row; leave out one that the workspace or ROS 2 cannot have."""
        wrong = self._ros.exceptions
        try:
            try:
                register(row, own)
            except wrong.NoTypeSupportImportedException:
                package = row.type.split("/")[0]
                raise MissingTypeError(package, "whose libraries cannot be loaded") from None
        except MissingTypeError as problem:
            self._lacking[str(problem)] = self._lacking.get(str(problem), 0) + 1
        except wrong.NameValidationException as problem:
            _log.warning("ROS 2: topic %s is not available: %s", row.name, problem)

    def _quality(self, depth: int, *, latched: bool = False) -> Any:
        """Return a profile: reliable, which every subscriber's request is compatible with."""
        qos = self._ros.qos
        kept = qos.DurabilityPolicy.TRANSIENT_LOCAL if latched else qos.DurabilityPolicy.VOLATILE
        return qos.QoSProfile(
            history=qos.HistoryPolicy.KEEP_LAST,
            depth=depth,
            reliability=qos.ReliabilityPolicy.RELIABLE,
            durability=kept,
        )

    # ------------------------------------------------------------------ out

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that have subscribers."""
        return self._subscribed

    def send(self, batch: Batch) -> None:
        """Publish what has subscribers, and every event: who came just now gets it, too."""
        for topic, message in batch:
            if not (topic.rate == "event" or topic.latched or topic.name in self._subscribed):
                continue
            if topic.rate == "camera":
                self._images.put((topic, message), topic.name)
            else:
                self._publish((topic, message))

    def _advertise(self, topic: Topic, own: Any) -> None:
        made = message_class(message_type(topic.type))
        profile = self._quality(topic.depth, latched=topic.latched)
        self._publishers[topic.name] = own.create_publisher(made, f"/{topic.name}", profile)

    def _publish(self, parcel: tuple[Topic, Message | bytes]) -> None:
        topic, message = parcel
        publisher = self._publishers.get(topic.name)
        if publisher is None:
            return
        data = message if isinstance(message, bytes) else cdr_encode(topic.type, message)
        try:
            publisher.publish(data)
        except RuntimeError as error:  # rclpy's errors are
            self.lost += 1
            if self.lost & (self.lost - 1) == 0:
                text = "ROS 2: %d messages lost, the last of %s: %s"
                _log.warning(text, self.lost, topic.name, error)

    def _watch(self) -> None:
        """Note which topics have subscribers, and that no client is left of those that commanded.

        rclpy does not name who sent a message: all its clients are one.
        """
        due = 0
        while not self._over.wait(LOOK_S):
            try:
                due -= 1
                if due < 0:
                    due = round(MODEL_S / LOOK_S)
                    self._report_unread()
                self._subscribed = frozenset(
                    name
                    for name, publisher in self._publishers.items()
                    if publisher.get_subscription_count()
                )
                node, heard = self._nodes[0].own, tuple(self._heard)
                if heard and not any(node.count_publishers(f"/{name}") for name in heard):
                    self._heard.difference_update(heard)
                    self._core.disconnected("ROS 2")
            except RuntimeError as error:
                if not self._over.is_set():
                    _log.warning("ROS 2: cannot query subscribers: %s", error)
                return

    def _report_unread(self) -> None:
        """Report topics that other nodes publish and that nothing subscribes to."""
        node = self._nodes[0].own
        names = (name for name, _ in node.get_topic_names_and_types())
        self._core.unread(
            [
                name.lstrip("/")
                for name in names
                if node.count_publishers(name) and not node.count_subscribers(name)
            ],
            "ROS 2",
        )

    # ------------------------------------------------------------------ in

    def _listen(self, topic: Topic, own: Any) -> None:
        made = message_class(message_type(topic.type))
        profile = self._quality(topic.depth if topic.depth == 1 else COMMANDS)

        def take(data: bytes) -> None:
            fields = self._core.decoded(topic, data, cdr_decode, "ROS 2")
            if fields is not None:
                self._heard.add(topic.name)
                self._core.receive(topic.name, fields, "ROS 2")

        own.create_subscription(made, f"/{topic.name}", take, profile, raw=True)

    def _serve(self, service: Service, own: Any) -> None:
        kind = service_type(service.type)
        made, codec = service_class(kind), self._ros.serialization

        def answer(request: Any, _response: Any) -> Any:
            try:
                data = codec.serialize_message(request)
                found = answered(self._core.call, service.name, kind, data, SERVICE_S)
            except Exception as problem:
                _log.exception("ROS 2: %s: service call failed", service.name)
                raise NoAnswerError from problem
            if found is None:
                raise NoAnswerError
            return codec.deserialize_message(found, made.Response)

        own.create_service(made, f"/{service.name}", answer)

    # ------------------------------------------------------------------ parameters

    def _set(self, given: list[Any]) -> Any:
        """Set gains, all or none of those in one request."""
        result, own = self._ros.interfaces.SetParametersResult, self._parameters
        if any(one.name == MODEL and one.value != self._model for one in given):
            return result(successful=False, reason=f"{MODEL}: read-only")
        gains = [(p.name, p.value) for p in given if p.name in self._gains]
        wrong = [one for one in gains if own.problem(*one)]
        problems = [own.write(*one) for one in wrong or gains]
        return result(successful=not wrong, reason="; ".join(filter(None, problems)))

    def _describe(self) -> None:
        """Keep the parameter of the model, which takes seconds, up to date with the rig."""
        described = None
        while not self._over.is_set():
            rig = self._core.loop.world.rig
            if rig is not described and (model := self._parameters.model()) is not None:
                first, self._model = not self._model, model
                node = self._nodes[0].own
                if first:
                    node.declare_parameter(MODEL, model)
                else:
                    node.set_parameters([self._ros.parameter.Parameter(MODEL, value=model)])
            described = rig
            self._over.wait(MODEL_S)
