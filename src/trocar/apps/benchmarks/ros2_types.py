"""The few messages that a ROS 2 subscriber needs, as the cyclonedds wheel has them.

Source: the packages std_msgs, sensor_msgs, geometry_msgs and crtk_msgs.
"""

# pyright: reportArgumentType=false
# The wheel's `sequence` says nothing of being a list, which its values are.
# Annotations must be real objects here: the wheel reads them.

from dataclasses import dataclass
from typing import Any

import cyclonedds.idl.annotations as mark
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

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
    """When, and in which frame."""

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
    """A pose: three and four numbers, flat, which is the same on the wire."""

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
    """An arm's state."""

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


def header() -> Header:
    """Return a header without a time, which the simulator accepts."""
    return Header(Time(0, 0), "")


def writer(participant: DomainParticipant, topic: str, kind: type[Any]) -> DataWriter[Any]:
    """Return a writer of commands, with ROS 2's name of the topic."""
    return DataWriter(participant, Topic(participant, f"rt{topic}", kind), Qos(RELIABLE))


def kind_of(topic: str) -> type[Any]:
    """Return the class of a topic's messages."""
    kinds = {"js": JointState, "cp": PoseStamped, "te": OperatingState, "aw": Image}
    return kinds[topic[-2:]]


def reader(participant: DomainParticipant, topic: str) -> DataReader[Any]:
    """Return a reader of a topic of an arm or an object."""
    qos = Qos(RELIABLE, Policy.History.KeepLast(64))
    return DataReader(participant, Topic(participant, f"rt{topic}", kind_of(topic)), qos)
