"""A node of rospy that reads its subscriptions in one thread, as roscpp's nodes do.

rospy has a thread for each topic: of forty-four at a time, many are late on two cores whenever
they were sent.
"""

# pyright: reportMissingImports=false, reportUnknownVariableType=false

from __future__ import annotations

import selectors
import socket
import struct
import threading
import time
from collections.abc import Sequence
from io import BytesIO
from typing import Any
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
from rosgraph.network import read_ros_handshake_header, write_ros_handshake_header
from sensor_msgs.msg import JointState

from benchmarks.client import SERVO, Callback

#: Bytes of a header before its frame: seq, secs, nsecs. Source: std_msgs/Header.
STAMP = struct.Struct("<4xII")


class Program:
    """A node of rospy; messages are bytes, parsed on demand."""

    def __init__(self, address: str) -> None:  # noqa: ARG002  the master's is in the environment
        rospy.init_node("listener", anonymous=True, disable_signals=True)
        self._written: dict[tuple[float, ...], Any] = {}
        self._servo: Any = rospy.Publisher(SERVO, JointState, queue_size=1, tcp_nodelay=True)
        self._servo.impl.set_queue_size(None)  # rospy would send the newest of a flood only

    def subscribe(self, topics: Sequence[str], callback: Callback) -> None:
        """As `Peer`."""
        wires = selectors.DefaultSelector()
        for topic in topics:
            wire, held = _subscribed(topic)
            wires.register(wire, selectors.EVENT_READ, (topic, held))
        threading.Thread(target=_listen, args=(wires, callback), daemon=True).start()

    def stamp(self, message: Any) -> int:
        """As `Peer`."""
        seconds, nanoseconds = STAMP.unpack_from(message)
        return seconds * 1_000_000_000 + nanoseconds

    def joints(self, message: Any) -> Sequence[float]:
        """As `Peer`."""
        return JointState().deserialize(message).position

    def homed(self, message: Any) -> bool:
        """As `Peer`: is_homed and is_busy are the last two bytes."""
        return bool(message[-2])

    def order(self, verb: str) -> None:
        """As `Peer`; PSM1 begins homed, so nothing is sent."""

    def servo(self, position: Sequence[float]) -> None:
        """As `Peer`; a message that is sent again is not serialized again."""
        key = tuple(position)
        if key not in self._written:
            self._written[key] = _Written(position=position)
        self._servo.publish(self._written[key])


class _Written(JointState):
    """A message that is serialized once."""

    _text: bytes | None = None

    def serialize(self, buff: Any) -> None:
        """Append the message's bytes to a buffer."""
        if self._text is None:
            begin = buff.tell()
            super().serialize(buff)
            self._text = buff.getvalue()[begin:]
        else:
            buff.write(self._text)


def _subscribed(topic: str) -> tuple[socket.socket, bytearray]:
    """Return a connection to the publisher of a topic, and the bytes that it has sent already.

    Source: the ROS wiki, Slave API (requestTopic) and TCPROS (the header).
    """
    name = rospy.get_name()
    master = rosgraph.Master(name)
    publishers = dict(master.getSystemState()[0])
    node: Any = ServerProxy(master.lookupNode(publishers[topic][0]))
    _, _, (_, host, port) = node.requestTopic(name, topic, [["TCPROS"]])
    wire = socket.create_connection((host, port))
    header = {"callerid": name, "topic": topic, "type": "*", "md5sum": "*", "tcp_nodelay": "1"}
    write_ros_handshake_header(wire, header)
    rest = BytesIO()
    read_ros_handshake_header(wire, rest, 65536)
    return wire, bytearray(rest.getvalue())


def _listen(wires: selectors.BaseSelector, callback: Callback) -> None:
    """Call back with messages as they arrive: the length precedes each."""
    while wires.get_map():
        for key, _ in wires.select():
            wire: Any = key.fileobj
            topic, held = key.data
            data = wire.recv(1 << 20)
            arrived = time.monotonic_ns()
            if not data:
                wires.unregister(wire)
            held += data
            while len(held) >= 4 and len(held) >= (end := 4 + int.from_bytes(held[:4], "little")):
                callback(topic, bytes(held[4:end]), arrived)
                del held[:end]
