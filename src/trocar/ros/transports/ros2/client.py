"""A client of topics and services on ROS 2, by Cyclone DDS.

Services are called as rmw_cyclonedds_cpp serves them; those of a robot that runs another RMW do
not answer.
"""

from __future__ import annotations

import logging
import os
import re
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any

from trocar.errors import TrocarError
from trocar.messages import (
    MessageError,
    blank,
    cdr_decode,
    cdr_encode,
    message_type,
    service_type,
)
from trocar.ros.client import CALL_S, DEPTH, Graph, Take
from trocar.ros.transports.ros2 import dds, naming
from trocar.ros.transports.ros2.dds import (
    DdsParticipant,
    DdsWriter,
    Network,
    OfferedEndpoint,
    QualityOfService,
    network,
)
from trocar.ros.transports.ros2.transport import CALLER, CALLS, WAIT_S, service_kinds

_log = logging.getLogger("trocar")

#: Time from joining until other participants' endpoints are known, and from matching until the
#: other side has matched, too [s]. Source: measured, tenths of a second; our own choice.
DISCOVERY_S, MATCHED_S = 1.5, 0.2
LOOK_S = 0.02
#: "sensor_msgs::msg::dds_::JointState_"
TYPE = re.compile(r"(\w+)::(?:msg|srv)::dds_::(\w+)_")


@dataclass
class _Calls:
    """The writer of a service's requests, and the replies that were received."""

    requests: DdsWriter
    replies: SimpleQueue[bytes] = field(default_factory=SimpleQueue[bytes])
    sent: int = 0


class Ros2Client:
    """Subscribe, publish and call over DDS.

    Args:
        where: domain and network; default: as ROS 2's environment variables say

    Raises:
        MissingExtraError: the extra `ros2` is not installed
        InputError: a variable of ROS 2 that has no possible value
    """

    def __init__(self, where: Network | None = None) -> None:
        dds.load()
        self._where = where or network(os.environ)
        self.name = f"ROS 2, domain {self._where.domain}"
        self._over = threading.Event()
        self._bus: DdsParticipant | None = None
        self._takes: dict[int, Callable[[bytes], None]] = {}
        self._writers: dict[str, DdsWriter] = {}
        self._calls: dict[str, _Calls] = {}
        self._offered: tuple[OfferedEndpoint, ...] = ()

    def start(self) -> None:
        """Join the domain.

        Raises:
            DdsError: no such network, or too many participants
        """
        where = self._where
        self._bus = DdsParticipant(where.domain, where.config, naming.user_data(enclave="/"))
        self._joined = time.monotonic()
        self._thread = threading.Thread(
            target=self._listen, args=(self._bus,), name="trocar-listen", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Leave the domain."""
        if self._bus is not None:
            self._over.set()
            self._thread.join()
            self._bus.close()
            self._bus = None

    def now(self) -> float:
        """Return the time of arrivals [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let time pass [s]."""
        time.sleep(seconds)

    def graph(self) -> Graph:
        """List the topics and services of other participants, once they had time to be found."""
        time.sleep(max(0.0, self._joined + DISCOVERY_S - time.monotonic()))
        self._offered = offered = self._participant().offered()
        published = {e.topic[3:]: _type(e.kind) for e in offered if e.writes and _is(e, "rt/")}
        subscribed = {e.topic[3:]: _type(e.kind) for e in offered if not e.writes and _is(e, "rt/")}
        services = {
            e.topic.removeprefix("rq/").removesuffix("Request"): _type(e.kind).removesuffix(
                "_Request"
            )
            for e in offered
            if not e.writes and _is(e, "rq/")
        }
        return Graph(published, subscribed, services)

    def latched(self, topic: str) -> bool | None:
        """Return whether a topic is TRANSIENT_LOCAL, None for one that `graph` has not listed."""
        name = naming.topic_name(topic)
        marks = [e.durable for e in self._offered if e.writes and e.topic == name]
        return all(marks) if marks else None

    def subscribe(
        self, topic: str, kind: str, take: Take, depth: int = DEPTH
    ) -> Callable[[], None]:
        """Have each message handed to `take`, the last one, too, where it is offered.

        Call the result to unsubscribe.
        """

        def taken(payload: bytes) -> None:
            try:
                fields = cdr_decode(kind, payload)
            except MessageError as problem:
                _log.debug("/%s: cannot read a message: %s", topic, problem)
            else:
                take(fields)

        durable = bool(self.latched(topic))
        quality = QualityOfService(depth, durable, best_effort=not durable)
        name = naming.topic_name(topic)
        reader = self._participant().reader(name, message_type(kind).dds_name, quality)
        self._takes[reader.entity] = taken

        def unsubscribe() -> None:
            self._takes[reader.entity] = lambda _: None

        return unsubscribe

    def advertise(self, topic: str, kind: str) -> None:
        """Announce messages on a topic."""
        if topic not in self._writers:
            name = naming.topic_name(topic)
            made = message_type(kind)
            data = naming.user_data(typehash=naming.type_hash(made))
            quality = QualityOfService(DEPTH, user_data=data)
            self._writers[topic] = self._participant().writer(name, made.dds_name, quality)

    def publish(self, topic: str, kind: str, fields: Mapping[str, Any]) -> None:
        """Send a message."""
        self.advertise(topic, kind)
        self._writers[topic].write(cdr_encode(kind, {**blank(kind), **fields}))

    def call(
        self, service: str, kind: str, fields: Mapping[str, Any], timeout_s: float = CALL_S
    ) -> Mapping[str, Any]:
        """Call a service.

        Raises:
            TrocarError: there is no such service, or it does not answer
        """
        halves = service_type(kind)
        until = time.monotonic() + timeout_s
        calls = self._calls.get(service) or self._connected(service, kind, until)
        calls.sent += 1
        caller = calls.requests.guid[8:] + calls.sent.to_bytes(8, "little")
        payload = cdr_encode(halves.request, {**blank(halves.request), **fields})
        calls.requests.write(payload[: CALLER.start] + caller + payload[CALLER.start :])
        while True:
            try:
                reply = calls.replies.get(timeout=max(0.0, until - time.monotonic()))
            except Empty:
                raise TrocarError(f"{service}: no answer within {timeout_s:g} s") from None
            if reply[CALLER] == caller:
                return cdr_decode(halves.response, reply[: CALLER.start] + reply[CALLER.stop :])

    def _connected(self, service: str, kind: str, until: float) -> _Calls:
        """Return the two ends of a service, once a server is there."""
        bus = self._participant()
        (request, asked), (reply, told) = service_kinds(service_type(kind))
        own = naming.endpoint_id(bus.guid, len(self._calls) + 1)

        def quality(typehash: str) -> QualityOfService:
            data = naming.user_data(clientid=own, typehash=typehash)
            return QualityOfService(CALLS, user_data=data)

        replies = bus.reader(naming.reply_name(service), reply, quality(told))
        requests = bus.writer(naming.request_name(service), request, quality(asked))
        found = self._calls[service] = _Calls(requests)
        self._takes[replies.entity] = found.replies.put
        while not requests.look():
            if time.monotonic() > until:
                raise TrocarError(f"{service}: no such service")
            time.sleep(LOOK_S)
        time.sleep(MATCHED_S)
        return found

    def _participant(self) -> DdsParticipant:
        if self._bus is None:
            raise TrocarError("ROS 2: not connected")
        return self._bus

    def _listen(self, bus: DdsParticipant) -> None:
        while not self._over.is_set():
            for end in bus.wait(WAIT_S):
                if isinstance(end, DdsWriter):
                    end.look()
                    continue
                take = self._takes.get(end.entity)
                if take is None:  # a new reader: its messages wait
                    time.sleep(0.0)
                    continue
                for sample in end.take():
                    take(sample.payload)


def _is(end: OfferedEndpoint, kind: str) -> bool:
    return end.topic.startswith(kind)


def _type(dds_name: str) -> str:
    """Return "sensor_msgs/JointState" for the name of a type in DDS."""
    found = TYPE.fullmatch(dds_name)
    return f"{found[1]}/{found[2]}" if found else dds_name
