"""A participant of Cyclone DDS, with the few messages that it needs.

Source of the messages: the packages std_msgs, sensor_msgs, geometry_msgs and crtk_msgs.
"""

# pyright: reportArgumentType=false
# The wheel's `sequence` does not declare that its values are lists.
# Annotations must be real objects here: the wheel reads them.

import os
import struct
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cyclonedds.idl.annotations as mark
from cyclonedds._clayer import ddspy_take
from cyclonedds.core import (
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from benchmarks.client import ORDER, SERVO, Callback

ANY = SampleState.Any | ViewState.Any | InstanceState.Any
#: Every message begins with its header, behind four bytes. Source: XCDR1.
STAMP = struct.Struct("<4xiI")
RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))


@dataclass
@mark.final
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """A time [s, ns]."""

    sec: int32
    nanosec: uint32


@dataclass
@mark.final
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """Time and frame."""

    stamp: Time
    frame_id: str


@dataclass
@mark.final
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """Joints."""

    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
@mark.final
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    """A pose, flat, which is the same on the wire."""

    header: Header
    x: float64
    y: float64
    z: float64
    qx: float64
    qy: float64
    qz: float64
    qw: float64


@dataclass
@mark.final
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    """A picture."""

    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
@mark.final
class OperatingState(IdlStruct, typename="crtk_msgs::msg::dds_::OperatingState_"):
    """State of an arm."""

    header: Header
    state: str
    is_homed: bool
    is_busy: bool


@dataclass
@mark.final
class StringStamped(IdlStruct, typename="crtk_msgs::msg::dds_::StringStamped_"):
    """A command."""

    header: Header
    string: str


#: Class of a topic's messages, by the last letters of its name.
KINDS = {"js": JointState, "cp": PoseStamped, "te": OperatingState, "aw": Image}
UNSTAMPED = Header(Time(0, 0), "")


class Program:
    """A participant; messages are bytes, which are parsed on demand: the wheel takes 50 us each."""

    def __init__(self, address: str) -> None:  # noqa: ARG002  the domain is in the environment
        self._participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
        self._servo = self._writer(SERVO, JointState)
        self._order = self._writer(ORDER, StringStamped)

    def subscribe(self, topics: Sequence[str], callback: Callback) -> None:
        """As `Peer`."""
        qos = Qos(RELIABLE, Policy.History.KeepLast(64))
        kinds = {topic: KINDS[topic[-2:]] for topic in topics}
        readers = {
            topic: DataReader(self._participant, self._topic(topic, kind), qos)
            for topic, kind in kinds.items()
        }
        waiting = WaitSet(self._participant)
        for reader in readers.values():
            waiting.attach(ReadCondition(reader, ANY))

        def listen() -> None:
            while waiting.wait(duration(infinite=True)):
                for topic, reader in readers.items():
                    for data, info in ddspy_take(reader._ref, ANY, 64):
                        if info.valid_data:
                            callback(topic, (kinds[topic], data), time.monotonic_ns())

        threading.Thread(target=listen, daemon=True).start()

    def stamp(self, message: Any) -> int:
        """As `Peer`."""
        seconds, nanoseconds = STAMP.unpack_from(message[1])
        return seconds * 1_000_000_000 + nanoseconds

    def joints(self, message: Any) -> Sequence[float]:
        """As `Peer`."""
        return message[0].deserialize(message[1]).position

    def homed(self, message: Any) -> bool:
        """As `Peer`."""
        return message[0].deserialize(message[1]).is_homed

    def order(self, verb: str) -> None:
        """As `Peer`."""
        self._order.write(StringStamped(UNSTAMPED, verb))

    def servo(self, position: Sequence[float]) -> None:
        """As `Peer`."""
        self._servo.write(JointState(UNSTAMPED, [], list(position), [], []))

    def _topic(self, topic: str, kind: type[Any]) -> Topic[Any]:
        return Topic(self._participant, f"rt{topic}", kind)  # ROS 2's name

    def _writer(self, topic: str, kind: type[Any]) -> DataWriter[Any]:
        return DataWriter(self._participant, self._topic(topic, kind), Qos(RELIABLE))
