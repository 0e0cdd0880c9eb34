"""A client of the topics and services of a robot, or of another simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

#: Takes the fields of a received message.
Take = Callable[[Mapping[str, Any]], None]

#: Messages that wait for a subscriber by default. Source: our own choice.
DEPTH = 64
#: Longest time of a service call. Source: our own choice; one takes milliseconds. [s]
CALL_S = 5.0


@dataclass(frozen=True)
class Graph:
    """Topics and services that others offer, by names without a leading slash.

    Attributes:
        published: {topic with a publisher: its type}
        subscribed: {topic with a subscriber: its type}
        services: {service: its type, "" where the transport lists names only}
    """

    published: Mapping[str, str] = field(default_factory=dict[str, str])
    subscribed: Mapping[str, str] = field(default_factory=dict[str, str])
    services: Mapping[str, str] = field(default_factory=dict[str, str])


class RosClient(Protocol):
    """Subscribe, publish and call, over one transport.

    Messages are dictionaries, as in `trocar.messages`. Functions that take them are called in a
    thread of the transport.
    """

    @property
    def name(self) -> str:
        """Name of the transport and address, for messages and reports."""
        ...

    def start(self) -> None:
        """Connect.

        Raises:
            TrocarError: no connection
        """
        ...

    def close(self) -> None:
        """Disconnect."""
        ...

    def now(self) -> float:
        """Return the time of arrivals, from any zero [s]."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let time pass [s]."""
        ...

    def graph(self) -> Graph:
        """List the topics and services of others."""
        ...

    def latched(self, topic: str) -> bool | None:
        """Return whether late subscribers of a topic get its last message.

        None: the transport does not show it, or not before there is a subscription.
        """
        ...

    def subscribe(
        self, topic: str, kind: str, take: Take, depth: int = DEPTH
    ) -> Callable[[], None]:
        """Have each message handed to `take`; call the result to unsubscribe.

        Args:
            topic: without a leading slash
            kind: type of its messages
            take: called with the fields of each message
            depth: messages that wait; 1: only the newest counts
        """
        ...

    def advertise(self, topic: str, kind: str) -> None:
        """Announce messages, so that subscribers are connected when the first one is sent."""
        ...

    def publish(self, topic: str, kind: str, fields: Mapping[str, Any]) -> None:
        """Send a message; fields that are left out are zero."""
        ...

    def call(
        self, service: str, kind: str, fields: Mapping[str, Any], timeout_s: float = CALL_S
    ) -> Mapping[str, Any]:
        """Call a service.

        Raises:
            TrocarError: there is no such service, it rejects the request, or it does not answer
        """
        ...
