"""The transport alone, on a core that only takes notes."""

from __future__ import annotations

import os
import signal
import threading
import time
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from tests.ros.ros2.ros2_side import Program, private_network, program
from trocar.errors import InputError
from trocar.messages import cdr_encode, message_type, service_type
from trocar.ros import services
from trocar.ros.topic import Topic
from trocar.ros.transports.ros2 import Ros2Transport
from trocar.ros.transports.ros2.dds import DdsSample
from trocar.ros.transports.ros2.transport import CALLER, Ros2Service, service_kinds

JOINTS = Topic("PSM1/measured_js", "sensor_msgs/JointState", "pub", "state")
IMAGES = Topic("stereo/left/image_raw", "sensor_msgs/Image", "pub", "camera", depth=2)


class Notes:
    """A core that keeps what it is told."""

    def __init__(self, *topics: Topic) -> None:
        self.topics = {topic.name: topic for topic in topics}
        self.services: dict[str, object] = {}
        self.loop = SimpleNamespace(world=SimpleNamespace(arms={}))

    def unread(self, names: list[str], peer: str) -> str:  # noqa: ARG002  as the core's
        return ""


@pytest.fixture
def transport():
    core = Notes(JOINTS, IMAGES)
    running = Ros2Transport(private_network())
    running.start(core)  # type: ignore[arg-type]  as much of a core as this asks for
    yield running
    running.close()


def joints(n: int) -> dict:
    numbers = np.arange(6.0)
    return {
        "header": {"stamp": (n // 1000 + 1, n % 1000), "frame_id": ""},
        "name": ["a"] * 6,
        "position": numbers,
        "velocity": numbers,
        "effort": numbers,
    }


def image(n: int) -> dict:
    return {
        "header": {"stamp": (1, n), "frame_id": "left"},
        "height": 480,
        "width": 640,
        "encoding": "rgb8",
        "is_bigendian": 0,
        "step": 1920,
        "data": bytes([n]) * 921_600,
    }


def test_images_arrive_whole_and_in_order(transport: Ros2Transport) -> None:
    with program("look", transport.where) as peer:
        for n in range(1, 200):
            transport.send([(IMAGES, image(n))])
            time.sleep(0.02)
            if peer.waiting():
                break
        told = peer.tell()
    stamps = told["stamps"]
    assert len(stamps) == 5
    assert stamps == sorted(set(stamps))
    assert told["whole"]
    assert transport.lost == 0


def test_a_subscriber_that_stands_still_holds_up_nobody(transport: Ros2Transport) -> None:
    peer = Program("linger", transport.where)
    os.kill(peer.process.pid, signal.SIGSTOP)
    try:
        sender = threading.Thread(
            target=lambda: [transport.send([(JOINTS, joints(n))]) for n in range(20_000)],
            daemon=True,
        )
        sender.start()
        sender.join(60)
        assert not sender.is_alive()
    finally:
        peer.end()


class Box:
    """A reader in which messages wait."""

    def __init__(self, entity: int, *taken: DdsSample) -> None:
        self.entity = entity
        self._taken = list(taken)

    def take(self) -> list[DdsSample]:
        return self._taken

    def participant_of(self, writer: int) -> int:
        return writer


def test_commands_of_several_topics_are_obeyed_as_they_were_written() -> None:
    orders = Topic("PSM1/state_command", "crtk_msgs/StringStamped", "sub")
    moves = Topic("PSM1/move_jp", "sensor_msgs/JointState", "sub")
    seen: list[str] = []
    transport = Ros2Transport(private_network())
    transport.core = SimpleNamespace(  # type: ignore[assignment]
        receive=lambda name, *_: seen.append(name),
        decoded=lambda topic, data, decode, _: decode(topic.type, data),
    )
    transport.topics = {1: moves, 2: orders}
    order = cdr_encode(orders.type, {"header": joints(1)["header"], "string": "home"})
    boxes = [Box(1, DdsSample(cdr_encode(moves.type, joints(1)), 7, 30))]
    boxes.append(Box(2, DdsSample(order, 8, 10), DdsSample(order, 8, 20)))
    for readers in (boxes, boxes[::-1]):
        seen.clear()
        transport.take(readers)  # type: ignore[arg-type]
        assert seen == [orders.name, orders.name, moves.name]


def test_a_client_is_gone_with_the_last_of_its_writers() -> None:
    transport, gone = Ros2Transport(private_network()), list[str]()
    moves, there = Topic("PSM1/move_jp", "sensor_msgs/JointState", "sub"), {7: 1, 8: 1, 9: 2}
    transport.core = SimpleNamespace(  # type: ignore[assignment]
        receive=lambda *_: None,
        decoded=lambda topic, data, decode, _: decode(topic.type, data),
        disconnected=gone.append,
    )
    transport.topics = {1: moves}
    data = cdr_encode(moves.type, joints(1))
    box = Box(1, *(DdsSample(data, writer, writer) for writer in there))
    box.participant_of = lambda writer: there.get(writer, 0)  # type: ignore[method-assign]
    transport.take([box])  # type: ignore[list-item]
    transport.look()
    assert gone == []
    del there[7]
    transport.look()
    assert gone == []
    del there[8]
    transport.look()
    transport.look()
    assert gone == ["ROS 2 1"]


class Ends:
    """A participant that is both ends of a service, without a network."""

    guid = bytes(16)

    def __init__(self) -> None:
        self.written: list[bytes] = []

    def reader(self, *_: object) -> Ends:
        return self

    writer = reader

    def readers(self) -> list[int]:
        return [1]

    def user_data_of(self, handle: int) -> bytes:  # noqa: ARG002
        return b""

    def write(self, payload: bytes) -> bool:
        self.written.append(payload)
        return True


def answered(call, *requests: bytes) -> list[bytes]:
    kind, ends = service_type("crtk_msgs/QueryForwardKinematics"), Ends()
    name = "PSM1/forward_kinematics"
    answer = partial(services.answered, call, name, kind, timeout_s=5.0)
    service = Ros2Service(ends, name, service_kinds(kind), 1, answer)  # type: ignore[arg-type]
    for request in requests:
        service.answer(DdsSample(request, 1, 0))
    return ends.written


def asked(kind: str, caller: bytes) -> bytes:
    payload = cdr_encode(message_type(kind), {"jp": [0.0], "cp": blank_pose()})
    return payload[: CALLER.start] + caller + payload[CALLER.start :]


def blank_pose() -> dict:
    return {
        "position": dict.fromkeys("xyz", 0.0),
        "orientation": {**dict.fromkeys("xyz", 0.0), "w": 1.0},
    }


def test_a_refused_call_is_answered_with_the_reason() -> None:
    def refuse(*_: object) -> dict:
        raise InputError("no such pose")

    kind = service_type("crtk_msgs/QueryForwardKinematics").request
    caller = bytes(range(16))
    (reply,) = answered(refuse, asked(kind.name, caller))
    assert reply[CALLER] == caller
    assert b"no such pose" in reply


def test_calls_that_are_none_are_not_answered_by_chance(rng: np.random.Generator) -> None:
    short = [rng.bytes(size) for size in range(21)]
    assert answered(lambda *_: {}, *short) == []
    for reply in answered(lambda *_: {}, *[b"\0\1\0\0" + rng.bytes(40) for _ in range(40)]):
        assert b"QueryForwardKinematics" in reply  # the refusal says of what


def test_a_call_that_breaks_the_simulator_is_told_and_not_answered(caplog) -> None:
    def break_it(*_: object) -> dict:
        raise ZeroDivisionError

    kind = service_type("crtk_msgs/QueryForwardKinematics").request
    assert answered(break_it, asked(kind.name, bytes(16))) == []
    assert "service call failed" in caplog.text
