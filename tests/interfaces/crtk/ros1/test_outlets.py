"""What subscribers get who do not read, vanish, or come late; rospy is played here."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trocar.interfaces.crtk.messages import message_type, ros1_decode
from trocar.interfaces.crtk.topics import Topic
from trocar.interfaces.crtk.transports.ros1.outlets import Outlet
from trocar.interfaces.crtk.transports.ros1.sender import Sender

STATE = {"header": {"stamp": (1, 2), "frame_id": ""}, "name": ["yaw"], "position": [0.5],
         "velocity": [], "effort": []}  # fmt: skip


class Connection:
    """As rospy's: a socket, and what it counts."""

    def __init__(self) -> None:
        self.socket, self.far = socket.socketpair()
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        self.done, self.stat_bytes, self.stat_num_msg = False, 0, 0

    def fileno(self) -> int:
        return self.socket.fileno()

    def close(self) -> None:
        self.done = True

    def read(self, count: int) -> bytes:
        return self.far.recv(count, socket.MSG_WAITALL)

    def message(self, kind: str) -> dict[str, Any]:
        (size,) = struct.unpack("<I", self.read(4))
        return ros1_decode(message_type(kind), self.read(size))


class Publisher:
    def __init__(self, name: str, kind: Any, latch: bool, queue_size: int) -> None:
        self.impl = SimpleNamespace(connections=[], latch=None, publock=threading.RLock())
        self.impl.set_queue_size = lambda *_: None
        self.asked = name, kind, latch, queue_size


@pytest.fixture
def connect() -> Iterator[Callable[[], Connection]]:
    made: list[Connection] = []

    def one() -> Connection:
        made.append(Connection())
        return made[-1]

    yield one
    for connection in made:
        connection.socket.close()
        connection.far.close()


LIBRARY: Any = SimpleNamespace(
    rospy=SimpleNamespace(Publisher=Publisher), genpy=SimpleNamespace(Message=object)
)


def outlet(*connections: Connection, depth: int = 64, latched: bool = False) -> Outlet:
    row = Topic("PSM1/measured_js", "sensor_msgs/JointState", "pub", "state", latched, depth)
    made = Outlet(LIBRARY, row)
    made._impl.connections = list(connections)
    return made


def numbered(k: int) -> dict[str, Any]:
    return {**STATE, "position": np.full(200, float(k))}


def test_a_message_goes_to_everybody_as_ros_1_writes_it(connect) -> None:
    ends = connect(), connect()
    assert outlet(*ends).send(STATE) == 0
    for end in ends:
        got = end.message("sensor_msgs/JointState")
        assert list(got["name"]) == ["yaw"] and list(got["position"]) == [0.5]
        assert end.stat_num_msg == 1


def test_who_does_not_read_loses_the_oldest_and_nobody_waits_for_it(connect) -> None:
    still, quick = connect(), connect()
    out = outlet(still, quick, depth=3)
    dropped = 0
    for k in range(40):
        dropped += out.send(numbered(k))
        assert quick.message("sensor_msgs/JointState")["position"][0] == k
    assert dropped > 0 and out.late and out.descriptors() == [still.fileno()]
    got = []
    while out.late:
        got.append(still.message("sensor_msgs/JointState")["position"][0])
        out.catch_up()
    while len(got) < 40 - dropped:
        got.append(still.message("sensor_msgs/JointState")["position"][0])
    assert got == sorted(got) and got[-1] == 39.0, "whole messages, in order, the newest last"


def test_who_vanishes_is_let_go(connect) -> None:
    gone, there = connect(), connect()
    out = outlet(gone, there)
    gone.far.close()
    for _ in range(3):
        out.send(STATE)
    assert gone.done and not out.late
    assert there.message("sensor_msgs/JointState")["position"][0] == 0.5


def test_a_latched_message_is_kept_for_those_who_come_late() -> None:
    out = outlet(latched=True)
    out.send(STATE)
    kept = ros1_decode(message_type("sensor_msgs/JointState"), out._impl.latch.data)
    assert list(kept["position"]) == [0.5]
    plain = outlet()
    plain.send(STATE)
    assert plain._impl.latch is None


@pytest.mark.parametrize("rate", ["state", "event"])
def test_what_cannot_be_written_in_time_is_left_out_but_for_events(rate: Any, connect) -> None:
    end = connect()
    out = outlet(end)
    row = Topic("PSM1/measured_js", "sensor_msgs/JointState", "pub", rate)
    sender = Sender({row.name: out})
    for k in range(50):  # nobody writes yet
        sender.put([(row, numbered(k))])
    assert (sender.dropped > 0) == (rate == "state")
    sender.start()
    got = [end.message("sensor_msgs/JointState")["position"][0] for _ in range(50 - sender.dropped)]
    assert got == [float(k) for k in range(len(got))]
    sender.close()
