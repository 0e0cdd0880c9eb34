"""A participant of Cyclone DDS."""

# pyright: reportArgumentType=false
# The wheel's `sequence` says nothing of being a list, which its values are.

from __future__ import annotations

import os
import struct
import threading
import time
from collections.abc import Sequence
from typing import Any

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.util import duration

from trocar.apps.benchmarks import ros2_types as types
from trocar.apps.benchmarks.peers import ORDER, SERVO, Told

ANY = SampleState.Any | ViewState.Any | InstanceState.Any
#: Every message that is heard begins with its header, behind four bytes. Source: XCDR1.
STAMP = struct.Struct("<4xiI")
FOREVER = duration(infinite=True)


class Program:
    """A participant of Cyclone DDS that takes messages through the wheel's typed classes."""

    def __init__(self, address: str) -> None:  # noqa: ARG002  the domain is in the environment
        domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
        self._participant = DomainParticipant(domain)
        self._servo = types.writer(self._participant, SERVO, types.JointState)
        self._order = types.writer(self._participant, ORDER, types.StringStamped)

    def hear(self, topics: Sequence[str], told: Told) -> None:
        """As `Peer`; messages are bytes, which are read when somebody asks what they say.

        So that reading one makes no other late: the wheel takes 50 us for each.
        """
        readers = {topic: types.reader(self._participant, topic) for topic in topics}
        kinds = {topic: types.kind_of(topic) for topic in topics}
        waiting = WaitSet(self._participant)
        for reader in readers.values():
            waiting.attach(ReadCondition(reader, ANY))

        def listen() -> None:
            while waiting.wait(FOREVER):
                for topic, reader in readers.items():
                    for data, info in ddspy_take(reader._ref, ANY, 64):
                        if info.valid_data:
                            told(topic, (kinds[topic], data), time.monotonic_ns())

        threading.Thread(target=listen, daemon=True).start()

    def stamp(self, message: Any) -> int:
        """As `Peer`."""
        seconds, nanoseconds = STAMP.unpack_from(message[1])
        return seconds * 1_000_000_000 + nanoseconds

    def joints(self, message: Any) -> Sequence[float]:
        """As `Peer`."""
        return _read(message).position

    def homed(self, message: Any) -> bool:
        """As `Peer`."""
        return _read(message).is_homed

    def order(self, verb: str) -> None:
        """As `Peer`."""
        self._order.write(types.StringStamped(types.header(), verb))

    def servo(self, position: Sequence[float]) -> None:
        """As `Peer`."""
        self._servo.write(types.JointState(types.header(), [], list(position), [], []))


def _read(message: tuple[Any, bytes]) -> Any:
    kind, data = message
    return kind.deserialize(data)
