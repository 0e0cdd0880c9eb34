"""A node of ROS 1 that publishes, subscribes and serves what the core's table names, by rospy.

rospy comes with ROS 1 and not from PyPI. Message classes are made at run time and carry bytes:
written once for all subscribers, and read by our own decoder.

A subscriber that does not read delays no other: events and images wait in rospy's own queue
and thread for it, and states are left out for it. For 44 states at 220 Hz such threads take twice
the time, 0.8 cores instead of 0.35 (measured, 0.1 of it lost).
"""

from __future__ import annotations

import logging
import select
import socket
import struct
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from trocar.errors import InputError, TrocarError
from trocar.messages import (
    MessageError,
    MessageType,
    message_type,
    ros1_decode,
    ros1_encode,
    service_type,
)
from trocar.ros.transports.ros1.master import MasterError, find_master, settle_address
from trocar.ros.transports.ros1.parameters import ServerParameters

if TYPE_CHECKING:
    from trocar.ros.core import Batch, Core
    from trocar.ros.topic import Service, Topic

_log = logging.getLogger("trocar")

#: rospy publishes on /rosout what this logger gets.
ROSOUT = logging.getLogger("rosout")
#: Ends of the names of topics whose messages are also on /rosout. Source: cisst-ros 73aca61,
#: mts_ros_crtk_bridge_provided.cpp.
LEVELS = {"error": logging.ERROR, "warning": logging.WARNING, "status": logging.INFO}
STRING = "std_msgs/String"

NODE = "trocar"
#: Debian 12's (and Ubuntu's, from 22.04 on) names of what `--ros1` needs.
PACKAGES = "python3-rospy python3-rosmaster python3-std-msgs python3-rosgraph-msgs"
#: Longest time of a service call. Source: our own choice; one takes milliseconds. [s]
SERVICE_S = 5.0
#: Period of the check that the master has the node registered. Source: our own choice. [s]
WATCH_S = 2.0
#: Period of the check that clients are still connected: rospy reports those that publish neither
#: when they end nor when they are killed. Source: our own choice, shorter than a start of one. [s]
LOOK_S = 0.1
#: Longest time to unregister. Source: our own choice; it takes tenths of a second. [s]
FAREWELL_S = 10.0
#: First field of a header: the number of the message among its publisher's.
SEQUENCE = struct.Struct("<I")
GONE = "ROS 1: the master at %s is unreachable; the simulation and existing connections continue"


class MissingRospyError(TrocarError):
    """This Python cannot import rospy; `python` is which one, `reason` why not."""

    def __init__(self, python: str, reason: str) -> None:
        self.python, self.reason = python, reason
        super().__init__(
            f"--ros1: {python} has no rospy ({reason}). It is not on PyPI; Debian and Ubuntu have"
            f" it for /usr/bin/python3 only: sudo apt install {PACKAGES}, then"
            " make ros1-venv and .venv-ros1/bin/trocar sim --ros1 (docs/ros.md, ROS 1)"
        )


class Untraced:
    """Stands in for `traceback` in rospy, which formats one for each connection that ends.

    They go to its debug log, which is off; each takes milliseconds, in which no state is sent.
    """

    print_exc = staticmethod(traceback.print_exc)

    @staticmethod
    def format_exc() -> str:
        """Return the exception without its traceback."""
        return repr(sys.exception())


@dataclass(frozen=True)
class Rospy:
    """The modules of ROS 1 that are used here."""

    rospy: Any
    genpy: Any
    paramserver: Any
    registration: Any
    threads: tuple[Any, ...]

    def message_class(self, kind: MessageType) -> Any:
        """Return a class of messages that hold their bytes in `data`.

        `seq` is written as the number of the message where it begins with a header.
        """
        numbered = bool(kind.fields) and kind.fields[0].type == "std_msgs/Header"

        def init(own: Any, data: bytes = b"", seq: int = 0) -> None:
            own.data, own.seq = data, seq

        def serialize(own: Any, buffer: Any) -> None:
            if not numbered:
                buffer.write(own.data)
                return
            buffer.write(SEQUENCE.pack(own.seq % 2**32))
            buffer.write(memoryview(own.data)[SEQUENCE.size :])

        def deserialize(own: Any, data: bytes) -> Any:
            own.data = data
            return own

        return type(
            kind.name.replace("/", "_"),
            (self.genpy.Message,),
            {
                "__slots__": ("data", "seq"),
                "__init__": init,
                "__module__": __name__,
                "_type": kind.name,
                "_md5sum": kind.md5,
                "_full_text": kind.text_ros1,
                "_has_header": False,  # rospy would count a message for each of its subscribers
                "_slot_types": ("uint8[]",),
                "serialize": serialize,
                "deserialize": deserialize,
            },
        )

    def service_class(self, name: str) -> Any:
        """Return the class of a service of type `name`, such as "std_srvs/Trigger"."""
        kind = service_type(name)
        return type(
            name.replace("/", "_"),
            (),
            {
                "_type": name,
                "_md5sum": kind.md5,
                "_request_class": self.message_class(kind.request),
                "_response_class": self.message_class(kind.response),
            },
        )

    def join(self, node: str, *, anonymous: bool = False, rosout: bool = False) -> None:
        """Become a node, once in a process; signals, logging and time stay the process's own.

        Args:
            node: its name
            anonymous: append a number to the name
            rosout: publish on /rosout what is logged by the logger of that name

        Raises:
            InputError: the process is a node already
            TrocarError: rospy refuses
        """
        if self.rospy.core.is_initialized():
            raise InputError(
                "--ros1: this process is already a ROS 1 node; allowed: one node per process"
            )
        logging.getLogger("rospy").setLevel(logging.CRITICAL)
        keep: Callable[..., None] = lambda *_, **__: None  # noqa: E731
        self.rospy.core.configure_logging = keep
        for module in self.threads:  # several at each end of a client, in the publishing thread too
            module.traceback = Untraced
        options = {"disable_signals": True, "disable_rosout": not rosout, "disable_rostime": True}
        try:
            self.rospy.init_node(node, argv=[], anonymous=anonymous, **options)
        except (self.rospy.ROSException, ValueError, OSError) as error:
            raise TrocarError(f"--ros1: rospy cannot start its node: {error}") from error
        ROSOUT.setLevel(logging.INFO)
        ROSOUT.propagate = False


def load() -> Rospy:
    """Import rospy.

    Raises:
        MissingRospyError: this Python has no rospy
    """
    modules = ("rospy", "genpy", "rospy.impl.paramserver", "rospy.impl.registration")
    threads = ("rospy.topics", "rospy.impl.tcpros_base", "rospy.impl.tcpros_pubsub")
    try:
        return Rospy(*map(import_module, modules), threads=tuple(map(import_module, threads)))
    except ImportError as error:
        raise MissingRospyError(sys.executable, str(error)) from error


class Subscribers:
    """Keep which topics have subscribers; rospy calls the methods, whose names are its own.

    Args:
        welcome: called with the topic of each new subscriber
    """

    def __init__(self, welcome: Callable[[str], None]) -> None:
        self.topics: frozenset[str] = frozenset()
        self._lock, self._welcome = threading.Lock(), welcome

    def peer_subscribe(self, topic: str, _publish: object, _publish_to_peer: object) -> None:
        """Note that one came."""
        name = topic.removeprefix("/")
        with self._lock:
            self.topics |= {name}
        self._welcome(name)

    def peer_unsubscribe(self, topic: str, left: int) -> None:
        """Note that one went."""
        with self._lock:
            self.topics -= set() if left else {topic.removeprefix("/")}


def _writable(wire: socket.socket | None) -> bool:
    """Whether a state can be written without waiting; also where writing fails at once."""
    if wire is None or wire.fileno() < 0:  # closed meanwhile
        return True
    poll = select.poll()
    poll.register(wire, select.POLLOUT)
    return bool(poll.poll(0))


class Ros1Transport:
    """Serve the core over ROS 1. A process can have one such node, once.

    Args:
        node: its name

    Attributes:
        greeting: the line to print at the start: which master, which address
    """

    name = "ros1"

    def __init__(self, node: str = NODE) -> None:
        self.node = node
        self.greeting = ""
        self._publishers: dict[str, Any] = {}
        self._sent: dict[str, int] = {}
        self._subscriptions: list[Any] = []
        self._clients: frozenset[str] = frozenset()
        self._subscribers = Subscribers(self._welcome)
        self._over = threading.Event()
        self._watcher: threading.Thread | None = None
        self._complained: set[str] = set()

    # ------------------------------------------------------------------ life

    def start(self, core: Core) -> None:
        """Join the master, and register every topic and service.

        Raises:
            MissingRospyError: this Python has no rospy
            MasterError, InputError: no master
            TrocarError: rospy refuses
        """
        self._core = core
        self._ros = load()
        self._master = find_master()
        address = settle_address(self._master)
        self._ros.join(self.node, rosout=True)
        for topic in core.topics.values():
            if not topic.later:
                register = self._advertise if topic.direction == "pub" else self._listen
                register(topic)
        for service in core.services.values():
            self._serve(service)
        rospy = self._ros.rospy
        cache = self._ros.paramserver.get_param_server_cache()
        uri = rospy.core.get_node_uri()
        self._parameters = ServerParameters(core, self._master, uri, cache)
        self._watcher = threading.Thread(target=self._watch, name="trocar-ros1-watch", daemon=True)
        self._watcher.start()
        self.greeting = f"ROS 1: node /{self.node} at the master {self._master.uri}; it {address}"

    def close(self) -> None:
        """Unregister, and delete the parameters that were set."""
        if self._watcher is None:
            return
        self._over.set()
        farewell = threading.Thread(target=self._part, name="trocar-ros1-farewell", daemon=True)
        farewell.start()
        farewell.join(FAREWELL_S)

    def _part(self) -> None:
        if self._watcher is not None:
            self._watcher.join()  # it may be setting parameters
        with suppress(TrocarError):
            self._parameters.forget()
        self._ros.rospy.signal_shutdown("the simulation has ended")

    # ------------------------------------------------------------------ out

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that have subscribers."""
        return self._subscribers.topics

    def send(self, batch: Batch) -> None:
        """Publish what has subscribers, and what is latched; rospy queues it for each of them."""
        for topic, message in batch:
            publisher = self._publishers.get(topic.name)
            if publisher is None or self._over.is_set():
                continue
            if topic.latched or topic.name in self._subscribers.topics:
                self._publish(topic, publisher, message)
            level = LEVELS.get(topic.name.rpartition("/")[2])
            if level is not None and topic.type == STRING:
                ROSOUT.log(level, "%s", message["data"])

    def _advertise(self, topic: Topic) -> None:
        kind = message_type(topic.type)
        self._publishers[topic.name] = publisher = self._ros.rospy.Publisher(
            f"/{topic.name}",
            self._ros.message_class(kind),
            subscriber_listener=self._subscribers,
            latch=topic.latched,
            queue_size=topic.depth,
        )
        self._sent[topic.name] = 1
        if topic.rate not in ("event", "camera"):
            publisher.impl.set_queue_size(None)
        last = self._core.latched(topic.name)
        if last is not None:
            self._publish(topic, publisher, last)

    def _welcome(self, name: str) -> None:
        """Send a new subscriber the newest state, at once: clients read as soon as they subscribe.

        Its socket sends each message at once from now on, whatever the subscriber asked for: small
        ones would otherwise wait until it has acknowledged those before.
        """
        publisher = self._publishers.get(name)
        if publisher is None:  # rospy has not returned the publisher yet
            return
        topic, newest = self._core.topics[name], publisher.impl.connections[-1:]
        with suppress(OSError):  # closed meanwhile
            for connection in newest:
                connection.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        state = None if topic.latched else self._core.latched(name)
        if state is not None:
            self._publish(topic, publisher, state, newest)

    def _publish(
        self, topic: Topic, publisher: Any, message: Any, to: Sequence[Any] | None = None
    ) -> None:
        """Publish to all subscribers, or to those of some connections."""
        try:
            kind = message_type(topic.type)
            data = message if isinstance(message, bytes) else ros1_encode(kind, message)
            number = self._sent[topic.name]
            if to is None:
                self._sent[topic.name] = number + 1
            else:  # the others shall not miss one
                number -= 1
            made, impl = publisher.data_class(data, number), publisher.impl
            if topic.latched or impl.queue_size is not None:
                publisher.publish(made)
                return
            with impl.publock:
                for connection in list(impl.connections if to is None else to):
                    if _writable(connection.socket):
                        impl.publish(made, connection_override=connection)
        except (MessageError, self._ros.rospy.ROSException) as error:
            if topic.name not in self._complained:
                self._complained.add(topic.name)
                _log.warning("ROS 1: cannot publish %s: %s", topic.name, error)

    # ------------------------------------------------------------------ in

    def _listen(self, topic: Topic) -> None:
        core, kind = self._core, message_type(topic.type)

        def take(message: Any) -> None:
            peer = str(getattr(message, "_connection_header", {}).get("callerid", ""))
            fields = core.decoded(topic, message.data, ros1_decode, peer)
            if fields is not None:
                core.receive(topic.name, fields, peer)

        subscriber = self._ros.rospy.Subscriber(
            f"/{topic.name}",
            self._ros.message_class(kind),
            take,
            queue_size=1 if topic.depth == 1 else None,
            tcp_nodelay=True,
        )
        self._subscriptions.append(subscriber.impl)

    def _look(self) -> None:
        """Report clients that publish to no topic any longer; killed ones have no socket."""
        ends = [end for impl in self._subscriptions for end in impl.connections or ()]
        clients = frozenset(str(end.callerid_pub) for end in ends if end.socket is not None)
        for gone in self._clients - clients:
            self._core.disconnected(gone)
        self._clients = clients

    def _rest(self) -> bool:
        """Look after clients until the master is due again; return whether all is over."""
        until = time.monotonic() + WATCH_S
        while time.monotonic() < until:
            if self._over.wait(LOOK_S):
                return True
            self._look()
        return False

    def _serve(self, service: Service) -> None:
        kind, made = service_type(service.type), self._ros.service_class(service.type)
        rospy = self._ros.rospy

        def answer(request: Any) -> Any:
            try:
                asked = ros1_decode(kind.request, request.data)
                found = self._core.call(service.name, asked, SERVICE_S)
                return made._response_class(ros1_encode(kind.response, found))
            except (TrocarError, TimeoutError) as error:
                raise rospy.ServiceException(str(error)) from error

        rospy.Service(f"/{service.name}", made, answer)

    # ------------------------------------------------------------------ the master

    def _watch(self) -> None:
        """Set parameters, and register again with a new master; what changes is logged once."""
        answers, announced = True, False
        while True:
            if answers:
                announced = self._announce(announced)
            if self._rest():
                return
            if self._ros.rospy.is_shutdown():
                _log.warning("ROS 1 stopped: another node has taken the name /%s", self.node)
                self._over.set()
                return
            try:
                ours = [{name for name, _ in rows} for _, rows in self._registrations()]
                _, _, listed = self._master.ask("getSystemState")
                published, subscribed, _ = listed
                known = all(
                    names <= {name for name, nodes in rows if f"/{self.node}" in nodes}
                    for names, rows in zip(ours, listed, strict=True)
                )
                heard = {name for name, _ in subscribed}
                names = [name.lstrip("/") for name, _ in published if name not in heard]
                self._core.unread(names, "ROS 1")
            except MasterError:
                if answers:
                    _log.warning(GONE, self._master.uri)
                answers = False
                continue
            if not known:
                self._register_again()
                announced = False
                _log.warning("ROS 1: registered with the new master at %s", self._master.uri)
            elif not answers:
                _log.warning("ROS 1: the master at %s is reachable again", self._master.uri)
            answers = True

    def _announce(self, announced: bool) -> bool:
        """Set parameters, those that change when all are set; return whether that is done with."""
        try:
            if announced:
                self._parameters.follow()
            else:
                self._parameters.start()
        except MasterError:
            return False
        except TrocarError as error:
            _log.warning("ROS 1: cannot set parameters: %s", error)
        return True

    def _registrations(self) -> list[tuple[Any, list[Any]]]:
        """List the node's publications, subscriptions and services: kind, (name, type or address).

        In the order of the master's getSystemState.
        """
        of = self._ros.registration
        topics, kinds = of.get_topic_manager(), of.Registration
        return [
            (kinds.PUB, topics.get_publications()),
            (kinds.SUB, topics.get_subscriptions()),
            (kinds.SRV, of.get_service_manager().get_services()),
        ]

    def _register_again(self) -> None:
        """Register everything once more, which rospy itself does not."""
        listeners = self._ros.registration.get_registration_listeners()
        for kind, rows in self._registrations():
            for name, described in rows:
                listeners.notify_added(name, described, kind)
