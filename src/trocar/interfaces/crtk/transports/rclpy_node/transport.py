"""The core's rows on a node of rclpy: bytes out, bytes in, and services as rclpy has them."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from trocar.errors import InputError, TrocarError
from trocar.interfaces.crtk.lane import Lane
from trocar.interfaces.crtk.messages import cdr_decode, cdr_encode, message_type, service_type
from trocar.interfaces.crtk.messages.forms import CDR_PACKING
from trocar.interfaces.crtk.sorter import Sorter
from trocar.interfaces.crtk.transports.rclpy_node import library
from trocar.interfaces.crtk.transports.rclpy_node.answering import LONGEST, answering
from trocar.interfaces.crtk.transports.rclpy_node.classes import (
    LackingError,
    message_class,
    service_class,
)
from trocar.interfaces.crtk.transports.rclpy_node.node import Node
from trocar.interfaces.crtk.transports.rclpy_node.reach import kept_near, reach

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.topics import Service, Topic
    from trocar.interfaces.crtk.transport import Batch, Message

_log = logging.getLogger("trocar")

NODE = "trocar"
LOOK_S = 0.05
"""How often it is looked who subscribes [s]. Source: our own choice."""

MOMENT_S = 0.01
"""How long commands that all count are kept, to be put in order [s]. Source: our own choice; rclpy
takes one message of each topic in a round, and a round of 150 topics takes milliseconds."""

# Images are few and large: two are enough to send one again.
IMAGES = 2
# Commands that all count wait here while the core is busy; it refuses, and says so, sooner.
COMMANDS = 1024
NS = 1_000_000_000


class RclpyTransport:
    """Be a node of ROS 2; its services are a node of their own, so that no call holds up commands.

    Args:
        node: its name

    Attributes:
        lost: messages that rclpy did not take
        greeting: what to tell the user once it has started: which RMW and domain, what is left out

    Raises:
        MissingRclpyError: this Python has no rclpy
    """

    name = "ros2"
    packing = CDR_PACKING

    def __init__(self, node: str = NODE) -> None:
        self._ros = library.load()
        self.node = node
        self.lost = 0
        self.greeting = ""
        self._context: Any = None
        self._nodes: list[Node] = []
        self._outlets: dict[str, Any] = {}
        self._heard: frozenset[str] = frozenset()
        self._lacking: dict[str, int] = {}
        self._sorter = Sorter(MOMENT_S)
        self._lane = Lane(self._publish)
        self._over = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="trocar-ros2-watch", daemon=True)

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
        if self._watcher.is_alive():
            self._watcher.join()
        self._lane.close()
        self._outlets, self._heard = {}, frozenset()
        nodes, self._nodes = self._nodes, []
        for node in nodes:
            node.close()
        self._sorter.close()
        context, self._context = self._context, None
        if context is not None:
            context.try_shutdown()

    # ------------------------------------------------------------------ out

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that have subscribers."""
        return self._heard

    def send(self, batch: Batch) -> None:
        """Publish what somebody listens to, and every event: who came just now gets it, too."""
        for topic, message in batch:
            if not (topic.rate == "event" or topic.latched or topic.name in self._heard):
                continue
            if topic.rate == "camera":
                self._lane.put(topic.name, (topic, message))
            else:
                self._publish((topic, message))

    def _publish(self, parcel: tuple[Topic, Message | bytes]) -> None:
        topic, message = parcel
        publisher = self._outlets.get(topic.name)
        if publisher is None:
            return
        data = message if isinstance(message, bytes) else cdr_encode(topic.type, message)
        try:
            publisher.publish(data)
        except RuntimeError as error:  # rclpy's errors are
            self.lost += 1
            if self.lost & (self.lost - 1) == 0:
                _log.warning(
                    "ROS 2: %d messages lost, the last of %s: %s", self.lost, topic.name, error
                )

    def _watch(self) -> None:
        while not self._over.wait(LOOK_S):
            try:
                self._heard = frozenset(
                    name for name, out in self._outlets.items() if out.get_subscription_count()
                )
            except RuntimeError as error:
                if not self._over.is_set():
                    _log.warning("ROS 2: who subscribes is not known any more: %s", error)
                return

    # ------------------------------------------------------------------ in

    def _take(self, topic: Topic, data: bytes, info: Mapping[str, Any]) -> None:
        """Hand a command to the core, in the order of writing."""
        core, peer = self._core, "ROS 2"
        try:
            if len(data) > LONGEST:
                raise InputError(f"got {len(data)} bytes; allowed: {LONGEST}")
            fields = cdr_decode(topic.type, data)
        except InputError as problem:
            core.refuse(topic, topic.name, str(problem), peer)
            return
        written = divmod(int(info.get("source_timestamp") or 0), NS)
        self._sorter.take(core, topic, fields, peer, written)

    # ------------------------------------------------------------------ inside

    def _open(self, core: Core) -> None:
        self._context = context = self._ros.context.Context()
        with kept_near(os.environ):  # a context of our own leaves the process its signals
            self._ros.rclpy.init(args=[], context=context)
        topics = Node(self._ros, context, self.node)
        self._nodes.append(topics)
        services = Node(self._ros, context, f"{self.node}_services")
        self._nodes.append(services)
        for topic in core.topics.values():
            if not topic.later:
                register = self._advertise if topic.direction == "pub" else self._listen
                self._tried(register, topic, topics.own)
        for service in core.services.values():
            self._tried(self._serve, service, services.own)
        self.greeting = self._greeting()
        for name, last in ((name, core.latched(name)) for name in self._outlets):
            if last is not None:
                self._publish((core.topics[name], last))
        self._sorter.start()
        for node in self._nodes:
            node.start()
        self._watcher.start()

    def _tried(self, register: Callable[[Any, Any], None], row: Topic | Service, own: Any) -> None:
        """Register a row; leave out what the workspace or ROS 2 has no room for."""
        wrong = self._ros.exceptions
        try:
            register(row, own)
        except LackingError as problem:
            self._leave_out(problem)
        except wrong.NoTypeSupportImportedException:
            package = row.type.split("/")[0]
            self._leave_out(LackingError(package, "whose libraries cannot be loaded"))
        except wrong.NameValidationException as problem:
            _log.warning("ROS 2: %s is left out: %s", row.name, problem)

    def _advertise(self, topic: Topic, own: Any) -> None:
        made = message_class(message_type(topic.type))
        depth = IMAGES if topic.rate == "camera" else 1 if topic.latched else topic.depth
        profile = self._quality(depth, latched=topic.latched)
        self._outlets[topic.name] = own.create_publisher(made, f"/{topic.name}", profile)

    def _listen(self, topic: Topic, own: Any) -> None:
        made = message_class(message_type(topic.type))
        profile = self._quality(topic.depth if topic.depth == 1 else COMMANDS)

        def take(data: bytes, info: Mapping[str, Any]) -> None:  # two arguments: rclpy looks
            self._take(topic, data, info)

        own.create_subscription(made, f"/{topic.name}", take, profile, raw=True)

    def _serve(self, service: Service, own: Any) -> None:
        made = service_class(service_type(service.type))
        answer = answering(self._ros, self._core, service, made)
        own.create_service(made, f"/{service.name}", answer)

    def _quality(self, depth: int, *, latched: bool = False) -> Any:
        """Return a profile: reliable, which every subscriber's wish is compatible with."""
        qos = self._ros.qos
        kept = qos.DurabilityPolicy.TRANSIENT_LOCAL if latched else qos.DurabilityPolicy.VOLATILE
        return qos.QoSProfile(
            history=qos.HistoryPolicy.KEEP_LAST,
            depth=depth,
            reliability=qos.ReliabilityPolicy.RELIABLE,
            durability=kept,
        )

    def _leave_out(self, problem: LackingError) -> None:
        self._lacking[problem.told] = self._lacking.get(problem.told, 0) + 1

    def _greeting(self) -> str:
        rmw = self._ros.rclpy.get_rmw_implementation_identifier()
        domain = self._context.get_domain_id()
        lines = [f"ROS 2: node /{self.node} by rclpy, {rmw}, domain {domain}; {reach(os.environ)}"]
        lines += [
            f"  without {what}: {count} topics and services are left out"
            for what, count in sorted(self._lacking.items())
        ]
        return "\n".join(lines)
