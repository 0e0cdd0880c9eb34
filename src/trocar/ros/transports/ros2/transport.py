"""The core's topics and services on DDS: each topic a writer or a reader, each service both."""

from __future__ import annotations

import logging
import os
import re
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING

from trocar.messages import (
    ServiceType,
    cdr_decode,
    cdr_encode,
    message_type,
    service_type,
)
from trocar.ros.parameters import Parameters
from trocar.ros.queues import ImageQueue
from trocar.ros.services import LARGEST, answered
from trocar.ros.transports.ros2 import dds, naming, parameters
from trocar.ros.transports.ros2.dds import (
    DdsParticipant,
    DdsReader,
    DdsSample,
    DdsWriter,
    Network,
    QualityOfService,
    network,
)

if TYPE_CHECKING:
    from trocar.ros.core import Batch, Core
    from trocar.ros.topic import Message, Topic

_log = logging.getLogger("trocar")

NODE = "trocar"
#: Depth of the queues of ordered commands; the core rejects and reports sooner.
COMMANDS = 1024
WAIT_S = 0.2
#: Period of comparing the topics of other nodes with those of the arms. Source: our own choice. [s]
UNREAD_S = 2.0
#: Calls and answers that wait. Source: rmw, rmw_qos_profile_services_default.
CALLS = 10
#: Threads that wait for services, and the longest time of a service call [s].
WORKERS, SERVICE_S = 4, 5.0
#: Longest wait of a reply for its caller to subscribe, and the period of looking.
#: Source: rmw_cyclonedds_cpp. [s]
LISTENS_S, LOOK_S = 0.1, 0.01
#: Bytes of a request and its reply that name the caller, after the encapsulation header.
#: Source: rmw_cyclonedds_cpp, `cdds_request_header_t` {uint64 guid; int64 seq}.
CALLER = slice(4, 20)

Answer = Callable[[bytes], bytes | None]


class Ros2Service:
    """A service as rmw_cyclonedds_cpp has it: two topics.

    Args:
        bus: the participant
        name: without a leading slash
        kinds: DDS name and type hash of the request, and of the response
        number: of the service, unique in the participant
        answer: returns the CDR bytes of the response to those of a request; None: no response
    """

    def __init__(
        self,
        bus: DdsParticipant,
        name: str,
        kinds: Sequence[tuple[str, str]],
        number: int,
        answer: Answer,
    ) -> None:
        self.name, self._answer = name, answer
        own = naming.endpoint_id(bus.guid, number)
        (request, asked), (reply, told) = kinds

        def quality(typehash: str) -> QualityOfService:
            return QualityOfService(
                CALLS, user_data=naming.user_data(serviceid=own, typehash=typehash)
            )

        self.requests = bus.reader(naming.request_name(name), request, quality(asked))
        self.replies = bus.writer(naming.reply_name(name), reply, quality(told))

    def answer(self, taken: DdsSample) -> None:
        """Answer a call, or log why not."""
        request, caller = taken.payload, taken.payload[CALLER]
        if not CALLER.stop < len(request) <= LARGEST:
            _log.warning("ROS 2: %s: rejected a request of %d bytes", self.name, len(request))
            return
        try:
            response = self._answer(request[: CALLER.start] + request[CALLER.stop :])
        except Exception:  # noqa: BLE001  a pool would swallow it
            _log.exception("ROS 2: %s: service call failed", self.name)
            return
        if response is None:
            return
        if self._listens(taken.writer):
            self.replies.write(response[: CALLER.start] + caller + response[CALLER.start :])
        else:
            _log.warning("ROS 2: %s: the client has disconnected", self.name)

    def _listens(self, caller: int) -> bool:
        """Wait until the caller's own reader is known, or any when the caller has no name."""
        data = self.requests.user_data_of(caller)
        if data is None:
            return False
        name = naming.read_user_data(data, "clientid")
        until = time.monotonic() + LISTENS_S
        while not any(self._is(reader, name) for reader in self.replies.readers()):
            if time.monotonic() > until:
                return False
            time.sleep(LOOK_S)
        return True

    def _is(self, reader: int, name: str | None) -> bool:
        if name is None:
            return True
        data = self.replies.user_data_of(reader)
        return data is not None and naming.read_user_data(data, "clientid") == name


def service_kinds(kind: ServiceType) -> list[tuple[str, str]]:
    """Return the DDS name and the hash of a service's request and of its response."""
    return [(half.dds_name, naming.type_hash(half)) for half in (kind.request, kind.response)]


class Ros2Transport:
    """Speak ROS 2 without it.

    Args:
        where: domain and network; default: as ROS 2's environment variables say
        node: name that `ros2 node list` shows

    Attributes:
        core: is served, since `start`
        topics: {DDS entity of a reader or writer: topic}
        lost: messages for which there was no room, because a subscriber could not follow

    Raises:
        MissingExtraError: the extra `ros2` is not installed
        InputError: a variable of ROS 2 that has no possible value
    """

    name = "ros2"

    def __init__(self, where: Network | None = None, node: str = NODE) -> None:
        dds.load()
        naming.typestore("EMPTY")
        self.where = where or network(os.environ)
        self.node = node
        self.lost = 0
        self._wanted: frozenset[str] = frozenset()
        self._writers: dict[str, DdsWriter] = {}
        self.topics: dict[int, Topic] = {}
        self._peers: dict[int, tuple[DdsReader, str]] = {}
        self._services: dict[int, Ros2Service] = {}
        self._older: bool | None = None
        self._bus: DdsParticipant | None = None
        self._over = threading.Event()

    # ------------------------------------------------------------------ life

    def start(self, core: Core) -> None:
        """Join the domain with every topic and service of the core.

        Raises:
            DdsError: no such network, or too many participants
        """
        self.core = core
        self._bus = bus = DdsParticipant(
            self.where.domain, self.where.config, naming.user_data(enclave="/")
        )
        self._workers = ThreadPoolExecutor(WORKERS, "trocar-ros2-call")
        self._images = ImageQueue(self._write)
        for topic in core.topics.values():
            if not topic.later:
                self._register(bus, topic)
        for number, row in enumerate(core.services.values(), start=1):
            kind = service_type(row.type)
            answer = partial(answered, core.call, row.name, kind, timeout_s=SERVICE_S)
            self._serve(Ros2Service(bus, row.name, service_kinds(kind), number, answer))
        own = Parameters(core)
        for number, name in enumerate(parameters.SERVICES, start=len(core.services) + 1):
            key = f"{self.node}/{re.sub('(?<!^)(?=[A-Z])', '_', name).lower()}"
            answer = parameters.answering(name, own)
            self._serve(Ros2Service(bus, key, parameters.service_type(name), number, answer))
        self._graph = bus.writer(
            naming.GRAPH_TOPIC, naming.GRAPH_TYPE, QualityOfService(1, latched=True)
        )
        self._introduce(bus)
        self._thread = threading.Thread(
            target=self._listen, args=(bus,), name="trocar-ros2", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Leave the domain."""
        if self._bus is None:
            return
        self._over.set()
        self._thread.join()
        self._workers.shutdown(wait=True, cancel_futures=True)
        self._images.close()
        self._wanted, self._writers = frozenset(), {}
        self._bus.close()
        self._bus = None

    @property
    def greeting(self) -> str:
        """The lines that are printed at the start: where it is, and what other terminals set."""
        where = self.where
        return (
            f"ROS 2: domain {where.domain}, {where.reach}; DDS opens UDP ports on all interfaces\n"
            f"  other terminals: export RMW_IMPLEMENTATION=rmw_cyclonedds_cpp "
            f"ROS_DOMAIN_ID={where.domain} {where.set}\n"
            "  services work with rmw_cyclonedds_cpp only, topics with rmw_fastrtps_cpp too"
        )

    def _register(self, bus: DdsParticipant, topic: Topic) -> None:
        kind, name = message_type(topic.type), naming.topic_name(topic.name)
        data = naming.user_data(typehash=naming.type_hash(kind))
        if topic.direction == "pub":
            depth = topic.depth
            end = bus.writer(name, kind.dds_name, QualityOfService(depth, topic.latched, data))
            self._writers[topic.name] = end
        else:
            depth = topic.depth if topic.depth == 1 else COMMANDS
            end = bus.reader(name, kind.dds_name, QualityOfService(depth, user_data=data))
        self.topics[end.entity] = topic
        if isinstance(end, DdsWriter):
            self._match(end)

    def _serve(self, service: Ros2Service) -> None:
        self._services[service.requests.entity] = service

    # ------------------------------------------------------------------ out

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that have subscribers."""
        return self._wanted

    def send(self, batch: Batch) -> None:
        """Write what has subscribers, and what is latched."""
        for topic, message in batch:
            writer = self._writers.get(topic.name)
            if writer is None or not (writer.matched or topic.latched):
                continue
            if topic.rate == "camera":
                self._images.put((writer, topic, message), topic.name)
            else:
                self._write((writer, topic, message))

    def _write(self, parcel: tuple[DdsWriter, Topic, Message | bytes]) -> None:
        writer, topic, message = parcel
        data = message if isinstance(message, bytes) else cdr_encode(topic.type, message)
        if not writer.write(data):
            self.lost += 1
            if self.lost & (self.lost - 1) == 0:
                _log.warning("ROS 2: %d messages lost, the last of %s", self.lost, topic.name)

    def _match(self, writer: DdsWriter) -> None:
        """Note that subscribers came or went."""
        topic, count = self.topics.get(writer.entity), writer.look()
        if topic is not None:
            name = {topic.name}
            self._wanted = self._wanted | name if count else self._wanted - name
        elif self._bus is not None and writer is self._graph:
            self._introduce(self._bus)

    def _introduce(self, bus: DdsParticipant) -> None:
        """Describe the node, in the form of those who read the graph.

        The wire does not distinguish the two forms, and a reader of the other form makes a node
        without a name of it. So nothing is written before there is a reader; readers since Iron
        carry the hash of the type, those before have none and ROS_DISTRO decides.
        """
        for reader in self._graph.readers():
            data = self._graph.user_data_of(reader) or b""
            hashed = naming.read_user_data(data, "typehash") is not None
            distribution = os.environ.get("ROS_DISTRO", "humble")
            older = not hashed and distribution in naming.OLDER_DISTRIBUTIONS
            if self._older is None:
                self._older = older
                ends = [end for end in bus.ends() if end is not self._graph]
                readers = [end.guid for end in ends if isinstance(end, DdsReader)]
                writers = [end.guid for end in ends if isinstance(end, DdsWriter)]
                self._graph.write(
                    naming.entities_info(bus.guid, self.node, readers, writers, older=older)
                )
            elif older != self._older:
                _log.warning(
                    "ROS 2: nodes of Humble and of later distributions share domain %d; only "
                    "those of Humble see this node's name",
                    self.where.domain,
                )

    # ------------------------------------------------------------------ in

    def _listen(self, bus: DdsParticipant) -> None:
        more: set[DdsReader] = set()
        due = described = 0.0
        while not self._over.is_set():
            if time.monotonic() >= due:
                self.look()
                due = time.monotonic() + WAIT_S
            if time.monotonic() >= described:
                self._report_unread(bus)
                described = time.monotonic() + UNREAD_S
            for end in bus.wait(0.0 if more else WAIT_S):
                if isinstance(end, DdsWriter):
                    self._match(end)
                else:
                    more.add(end)
            more = self.take(more)

    def _report_unread(self, bus: DdsParticipant) -> None:
        """Report topics that other nodes publish and that nothing subscribes to."""
        ends = bus.offered()
        heard = {end.topic for end in ends if not end.writes}
        names = {end.topic for end in ends if end.writes} - heard
        self.core.unread(sorted(n[3:] for n in names if n.startswith("rt/")), "ROS 2")

    def take(self, readers: Iterable[DdsReader]) -> set[DdsReader]:
        """Hand what waits to the core in the order of writing; return who may have more."""
        arrived: list[tuple[int, Topic, bytes, str]] = []
        more: set[DdsReader] = set()
        for reader in readers:
            found = reader.take()
            if len(found) == dds.TAKEN:
                more.add(reader)
            service = self._services.get(reader.entity)
            if service is None:
                topic = self.topics[reader.entity]
                arrived += [(s.written_ns, topic, s.payload, self._peer(reader, s)) for s in found]
            else:
                for taken in found:
                    self._workers.submit(service.answer, taken)
        for _, topic, payload, peer in sorted(arrived, key=itemgetter(0)):
            self._receive(topic, payload, peer)
        return more

    def _peer(self, reader: DdsReader, taken: DdsSample) -> str:
        """Name the node's participant: a client has a writer for each topic."""
        if taken.writer not in self._peers:
            participant = reader.participant_of(taken.writer)
            self._peers[taken.writer] = reader, f"ROS 2 {participant or taken.writer:x}"
        return self._peers[taken.writer][1]

    def look(self) -> None:
        """Report clients of which no writer is left."""
        ended = [n for n, (reader, _) in self._peers.items() if not reader.participant_of(n)]
        gone = {self._peers.pop(writer)[1] for writer in ended}
        for peer in gone - {name for _, name in self._peers.values()}:
            self.core.disconnected(peer)

    def _receive(self, topic: Topic, payload: bytes, peer: str) -> None:
        message = self.core.decoded(topic, payload, cdr_decode, peer)
        if message is not None:
            self.core.receive(topic.name, message, peer)
