"""A client of topics and services on ROS 1, by rospy. A process can have one such node, once."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any

from trocar.errors import TrocarError
from trocar.messages import (
    MessageError,
    blank,
    message_type,
    ros1_decode,
    ros1_encode,
    service_type,
)
from trocar.ros.client import CALL_S, DEPTH, Graph, Take
from trocar.ros.transports.ros1.master import find_master, settle_address
from trocar.ros.transports.ros1.transport import load

_log = logging.getLogger("trocar")


class Ros1Client:
    """Subscribe, publish and call by rospy.

    Args:
        node: name, to which rospy adds a number
    """

    name = "ROS 1"

    def __init__(self, node: str = "trocar_client") -> None:
        self._node = node
        self._joined = False
        self._subscribers: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}

    def start(self) -> None:
        """Join the master.

        Raises:
            MissingRospyError: this Python has no rospy
            MasterError, InputError: no master
            TrocarError: rospy refuses
        """
        self._ros = load()
        self._master = find_master()
        settle_address(self._master)
        self._ros.join(self._node, anonymous=True)
        self._joined = True

    def close(self) -> None:
        """Leave."""
        if self._joined:
            self._ros.rospy.signal_shutdown("closed")

    def now(self) -> float:
        """Return the time of arrivals [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let time pass [s]."""
        time.sleep(seconds)

    def graph(self) -> Graph:
        """List the topics and services that other nodes have registered.

        Raises:
            MasterError: the master does not answer
        """
        own = self._ros.rospy.get_name()
        publishers, subscribers, services = self._master.ask("getSystemState")[2]
        types = dict(self._master.ask("getTopicTypes")[2])

        def typed(rows: Any) -> dict[str, str]:
            others = (topic for topic, nodes in rows if any(node != own for node in nodes))
            return {topic.removeprefix("/"): str(types.get(topic, "")) for topic in others}

        named = {name.removeprefix("/"): "" for name, _ in services}
        return Graph(typed(publishers), typed(subscribers), named)

    def latched(self, topic: str) -> bool | None:
        """Return whether a subscribed topic is latched, by the headers of its connections."""
        subscriber = self._subscribers.get(topic)
        if subscriber is None or subscriber.impl is None:
            return None
        marks = [bool(line.is_latched) for line in list(subscriber.impl.connections)]
        return all(marks) if marks else None

    def subscribe(
        self, topic: str, kind: str, take: Take, depth: int = DEPTH
    ) -> Callable[[], None]:
        """Have each message handed to `take`; call the result to unsubscribe."""

        def taken(message: Any) -> None:
            try:
                fields = ros1_decode(kind, message.data)
            except MessageError as problem:
                _log.debug("/%s: cannot read a message: %s", topic, problem)
            else:
                take(fields)

        made = self._ros.message_class(message_type(kind))
        subscriber = self._ros.rospy.Subscriber(
            f"/{topic}", made, taken, queue_size=depth, tcp_nodelay=True
        )
        self._subscribers[topic] = subscriber
        return subscriber.unregister

    def advertise(self, topic: str, kind: str) -> None:
        """Announce messages on a topic."""
        if topic not in self._publishers:
            made = self._ros.message_class(message_type(kind))
            publisher = self._ros.rospy.Publisher(
                f"/{topic}", made, queue_size=DEPTH, tcp_nodelay=True
            )
            self._publishers[topic] = publisher

    def publish(self, topic: str, kind: str, fields: Mapping[str, Any]) -> None:
        """Send a message."""
        self.advertise(topic, kind)
        publisher = self._publishers[topic]
        publisher.publish(publisher.data_class(ros1_encode(kind, {**blank(kind), **fields})))

    def call(
        self, service: str, kind: str, fields: Mapping[str, Any], timeout_s: float = CALL_S
    ) -> Mapping[str, Any]:
        """Call a service.

        Raises:
            TrocarError: there is no such service, it rejects the request, or it does not answer
        """
        rospy, halves = self._ros.rospy, service_type(kind)
        made = self._ros.service_class(kind)
        request = made._request_class(
            ros1_encode(halves.request, {**blank(halves.request), **fields})
        )
        try:
            rospy.wait_for_service(f"/{service}", timeout_s)
            reply: Any = rospy.ServiceProxy(f"/{service}", made).call(request)
        except (rospy.ServiceException, rospy.ROSException) as error:
            raise TrocarError(f"{service}: {error}") from error
        return ros1_decode(halves.response, reply.data)
