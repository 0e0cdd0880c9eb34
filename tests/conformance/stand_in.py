"""An arm of ours beneath the kit, without sockets and in simulated time, and one with faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tests.ros.served import Served
from trocar.errors import TrocarError
from trocar.messages import blank
from trocar.ros.client import CALL_S, DEPTH, Graph, Take

PEER = "kit"
TICK_S = 0.001


class ServedClient:
    """A client of a served world; time passes in `sleep` alone."""

    name = "memory"

    def __init__(self, rig: str = "psm") -> None:
        self.served = Served(rig, wanted=())
        self.takes: dict[str, list[Take]] = {}
        self._count: dict[str, int] = {}

    def start(self) -> None:
        self.served.run(0.05)

    def close(self) -> None:
        self.served.core.close()

    def now(self) -> float:
        return self.served.clock.now()

    def sleep(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / TICK_S))):
            self.served.run(TICK_S)
            self._deliver()

    def graph(self) -> Graph:
        topics = [t for t in self.served.core.topics.values() if not t.later]
        return Graph(
            {t.name: t.type for t in topics if t.direction == "pub"},
            {t.name: t.type for t in topics if t.direction == "sub"},
            {s.name: s.type for s in self.served.core.services.values()},
        )

    def latched(self, topic: str) -> bool | None:
        return self.served.core.topics[topic].latched

    def subscribe(
        self,
        topic: str,
        kind: str,
        take: Take,
        depth: int = DEPTH,  # noqa: ARG002
    ) -> Callable[[], None]:
        assert self.served.core.topics[topic].type == kind
        takes = self.takes.setdefault(topic, [])
        takes.append(take)
        self.served.transport.want(*self.takes)
        last = self.served.core.latched(topic)
        if last is not None and self.latched(topic):
            self.hand(topic, last, take)
        return lambda: takes.remove(take)

    def advertise(self, topic: str, kind: str) -> None:
        assert self.served.core.topics[topic].type == kind

    def publish(self, topic: str, kind: str, fields: Mapping[str, Any]) -> None:
        self.served.core.receive(topic, {**blank(kind), **fields}, PEER)

    def call(
        self,
        service: str,
        kind: str,
        fields: Mapping[str, Any],
        timeout_s: float = CALL_S,
    ) -> Mapping[str, Any]:
        row = self.served.core.services.get(service)
        if row is None or row.type != kind:
            raise TrocarError(f"{service}: no such service")
        return self.served.core.call(service, dict(fields), timeout_s)

    def hand(self, topic: str, message: Mapping[str, Any], take: Take) -> None:
        """Give a message to a subscriber."""
        take(message)

    def _deliver(self) -> None:
        received = self.served.transport.received
        for topic, messages in received.items():
            for message in messages:
                for take in tuple(self.takes.get(topic, ())):
                    self.hand(topic, message, take)
            messages.clear()
