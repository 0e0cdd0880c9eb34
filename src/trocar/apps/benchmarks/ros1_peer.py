"""A node of rospy."""

# pyright: reportMissingImports=false, reportUnknownVariableType=false

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Sequence
from typing import Any

import rospy
from sensor_msgs.msg import JointState

from trocar.apps.benchmarks.peers import SERVO, Told


class Program:
    """A node of rospy that takes messages as bytes: only what is asked for is read."""

    #: Bytes of a header before its frame: seq, secs, nsecs. Source: std_msgs/Header.
    STAMP = struct.Struct("<4xII")

    def __init__(self, address: str) -> None:  # noqa: ARG002  the master's is in the environment
        self._rospy: Any = rospy
        self._joint_state: Any = JointState
        self._rospy.init_node("listener", anonymous=True, disable_signals=True)
        self._servo: Any = self._rospy.Publisher(SERVO, JointState, queue_size=1, tcp_nodelay=True)

    def hear(self, topics: Sequence[str], told: Told) -> None:
        """As `Peer`; messages are bytes: only what is asked for is read."""

        def hearing(topic: str) -> Callable[[Any], None]:
            return lambda message: told(topic, message._buff, time.monotonic_ns())

        for topic in topics:
            rospy.Subscriber(topic, rospy.AnyMsg, hearing(topic), tcp_nodelay=True)

    def stamp(self, message: Any) -> int:
        """As `Peer`."""
        seconds, nanoseconds = self.STAMP.unpack_from(message)
        return seconds * 1_000_000_000 + nanoseconds

    def joints(self, message: Any) -> Sequence[float]:
        """As `Peer`."""
        return self._joint_state().deserialize(message).position

    def homed(self, message: Any) -> bool:
        """As `Peer`: is_homed and is_busy are the last two bytes."""
        return bool(message[-2])

    def order(self, verb: str) -> None:
        """As `Peer`: an arm that begins homed needs none, so none is sent."""

    def servo(self, position: Sequence[float]) -> None:
        """As `Peer`."""
        self._servo.publish(self._joint_state(position=position))
