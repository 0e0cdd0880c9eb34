"""The core's rows on DDS: each topic a writer or a reader, each service two of them."""

from __future__ import annotations

import logging
import os
import threading
from operator import itemgetter
from typing import TYPE_CHECKING

from trocar.errors import InputError
from trocar.interfaces.crtk.lane import Lane
from trocar.interfaces.crtk.messages import cdr_decode, cdr_encode, message_type, service_type
from trocar.interfaces.crtk.messages.forms import CDR_PACKING
from trocar.interfaces.crtk.transports.ros2 import graph, library, names
from trocar.interfaces.crtk.transports.ros2.bus import TAKEN, Bus, Reader, Taken, Writer
from trocar.interfaces.crtk.transports.ros2.calls import Calls
from trocar.interfaces.crtk.transports.ros2.hashes import type_hash
from trocar.interfaces.crtk.transports.ros2.network import Network, network
from trocar.interfaces.crtk.transports.ros2.quality import Quality
from trocar.interfaces.crtk.transports.ros2.service import Served, open_service

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.topics import Topic
    from trocar.interfaces.crtk.transport import Batch, Message

_log = logging.getLogger("trocar")

NODE = "trocar"
# Images are few and large: two are enough to send one again.
IMAGES = 2
# Commands that all count wait here while the core is busy; it refuses, and says so, sooner.
COMMANDS = 1024
# Longer ones are no command. Source: our own choice, 1 MB.
LONGEST = 1_000_000
WAIT_S = 0.2


class Ros2Transport:
    """Speak ROS 2 without it.

    Args:
        where: domain and network; default: as ROS 2's environment variables say
        node: name that `ros2 node list` shows

    Attributes:
        lost: messages for which there was no room, because a subscriber could not follow

    Raises:
        MissingExtraError: the extra `ros2` is not installed
        InputError: a variable of ROS 2 that has no possible value
    """

    name = "ros2"
    packing = CDR_PACKING

    def __init__(self, where: Network | None = None, node: str = NODE) -> None:
        library.load()
        self.where = where or network(os.environ)
        self.node = node
        self.lost = 0
        self._wanted: frozenset[str] = frozenset()
        self._writers: dict[str, Writer] = {}
        self._heard: dict[int, Topic] = {}
        self._served: dict[int, Served] = {}
        self._topic_of: dict[int, str] = {}
        self._bus: Bus | None = None
        self._ends = threading.Event()
        self._thread: threading.Thread | None = None

    # ------------------------------------------------------------------ life

    def start(self, core: Core) -> None:
        """Join the domain with every topic and service of the core.

        Raises:
            DdsError: no such network, or too many participants
        """
        self._core = core
        self._bus = bus = Bus(self.where.domain, self.where.config, names.user_data(enclave="/"))
        self._calls, self._lane = Calls(core), Lane(self._write)
        for topic in core.topics.values():
            if topic.later:
                continue
            if topic.direction == "pub":
                self._advertise(bus, topic)
            else:
                self._listen(bus, topic)
        for number, row in enumerate(core.services.values(), start=1):
            service = open_service(bus, row.name, service_type(row.type), number)
            self._served[service.requests.entity] = service
        self._introduce(bus)
        self._thread = threading.Thread(target=self._read, name="trocar-ros2", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the domain."""
        if self._bus is None:
            return
        self._ends.set()
        if self._thread is not None:
            self._thread.join()
        self._calls.close()
        self._lane.close()
        self._wanted, writers, self._writers = frozenset(), self._writers, {}
        writers.clear()
        bus, self._bus = self._bus, None
        bus.close()

    @property
    def greeting(self) -> str:
        """What to tell a person: where we are, and what their terminal must set."""
        where = self.where
        return (
            f"ROS 2: domain {where.domain}, {where.reach}; DDS opens UDP ports on all interfaces\n"
            f"  other terminals: export RMW_IMPLEMENTATION=rmw_cyclonedds_cpp "
            f"ROS_DOMAIN_ID={where.domain} {where.set}\n"
            "  services work with rmw_cyclonedds_cpp only, topics with rmw_fastrtps_cpp too"
        )

    # ------------------------------------------------------------------ out

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that have subscribers."""
        return self._wanted

    def send(self, batch: Batch) -> None:
        """Write what somebody listens to, and what is latched."""
        for topic, message in batch:
            writer = self._writers.get(topic.name)
            if writer is None or not (writer.matched or topic.latched):
                continue
            if topic.rate == "camera":
                self._lane.put(topic.name, (writer, topic, message))
            else:
                self._write((writer, topic, message))

    def _write(self, parcel: tuple[Writer, Topic, Message | bytes]) -> None:
        writer, topic, message = parcel
        data = message if isinstance(message, bytes) else cdr_encode(topic.type, message)
        if not writer.write(data):
            self.lost += 1
            if self.lost & (self.lost - 1) == 0:
                _log.warning("ROS 2: %d messages lost, the last of %s", self.lost, topic.name)

    def _advertise(self, bus: Bus, topic: Topic) -> None:
        kind = message_type(topic.type)
        depth = IMAGES if topic.rate == "camera" else topic.depth
        quality = Quality(depth, topic.latched, names.user_data(typehash=type_hash(kind)))
        writer = bus.writer(names.topic_name(topic.name), kind.dds_name, quality)
        self._writers[topic.name] = writer
        self._topic_of[writer.entity] = topic.name
        self._match(writer)

    def _match(self, writer: Writer) -> None:
        name = self._topic_of.get(writer.entity)
        if name is not None:
            self._wanted = (self._wanted | {name}) if writer.look() else (self._wanted - {name})

    # ------------------------------------------------------------------ in

    def _listen(self, bus: Bus, topic: Topic) -> None:
        kind = message_type(topic.type)
        depth = topic.depth if topic.depth == 1 else COMMANDS
        quality = Quality(depth, user_data=names.user_data(typehash=type_hash(kind)))
        reader = bus.reader(names.topic_name(topic.name), kind.dds_name, quality)
        self._heard[reader.entity] = topic

    def _receive(self, topic: Topic, payload: bytes, peer: str) -> None:
        try:
            if len(payload) > LONGEST:
                raise InputError(f"got {len(payload)} bytes; allowed: {LONGEST}")
            message = cdr_decode(topic.type, payload)
        except InputError as problem:
            self._core.refuse(topic, topic.name, str(problem), peer)
            return
        self._core.receive(topic.name, message, peer)

    def _read(self) -> None:
        bus = self._bus
        more: list[Reader] = []
        while bus is not None and not self._ends.is_set():
            woken = bus.wait(0.0 if more else WAIT_S)
            for end in woken:
                if isinstance(end, Writer):
                    self._match(end)
            more = self._take({*more, *(end for end in woken if isinstance(end, Reader))})

    def _take(self, readers: set[Reader]) -> list[Reader]:
        """Take what waits, and obey it as it was written, whatever the topic."""
        arrived: list[tuple[int, Topic, Taken]] = []
        more: list[Reader] = []
        for reader in readers:
            found = reader.take()
            if len(found) == TAKEN:
                more.append(reader)
            if reader.entity in self._served:
                self._calls.answer(self._served[reader.entity], found)
            else:
                topic = self._heard[reader.entity]
                arrived += [(taken.written_ns, topic, taken) for taken in found]
        for _, topic, taken in sorted(arrived, key=itemgetter(0)):
            self._receive(topic, taken.payload, f"ROS 2 {taken.writer:x}")
        return more

    # ------------------------------------------------------------------ inside

    def _introduce(self, bus: Bus) -> None:
        """Tell which node owns all this; kept for those who come later."""
        quality = Quality(1, latched=True)
        self._graph = bus.writer(graph.TOPIC, graph.TYPE, quality)
        ends = bus.ends()
        owned = [end for end in ends if end is not self._graph]
        info = graph.entities_info(
            bus.guid,
            self.node,
            [end.guid for end in owned if isinstance(end, Reader)],
            [end.guid for end in owned if isinstance(end, Writer)],
            size=self.where.gid_size,
        )
        self._graph.write(info)
