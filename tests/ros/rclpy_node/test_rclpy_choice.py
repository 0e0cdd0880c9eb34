"""Which ROS 2 `trocar sim --ros2` speaks, and what is said where it cannot."""

from __future__ import annotations

import os
import sys
import time
from argparse import ArgumentParser
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from types import ModuleType, SimpleNamespace

import pytest

from tests.ros.rclpy_node.stand_in import RCLError, Wire
from trocar.cli import main, serving
from trocar.errors import TrocarError
from trocar.live.access import PageAccess
from trocar.ros.topic import Topic
from trocar.ros.transports import rclpy_node
from trocar.ros.transports.rclpy_node import RclpyTransport, reach

QUIET = ["sim", "--rig", "psm", "--no-page", "--no-websocket"]


def chosen(*words: str) -> list[str]:
    parser = ArgumentParser()
    serving.add_serving(parser)
    found = serving._transports(parser.parse_args(["--no-websocket", *words]), PageAccess())
    return [type(transport).__name__ for transport in found]


def test_rclpy_is_used_where_it_can_be_imported(wire: Wire) -> None:
    assert chosen() == []
    assert chosen("--ros2") == ["RclpyTransport"]
    assert chosen("--ros2", "rclpy") == ["RclpyTransport"]
    assert not wire.contexts


def test_cyclone_dds_is_used_elsewhere_and_when_it_is_asked_for(
    wire: Wire,  # noqa: ARG001
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
    assert chosen("--ros2", "dds") == ["Ros2Transport"]
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert chosen("--ros2") == ["Ros2Transport"]
    assert not caplog.records
    found = ModuleType("rclpy")  # no package, so it has no rclpy.context
    found.__spec__ = ModuleSpec("rclpy", None)
    monkeypatch.setitem(sys.modules, "rclpy", found)
    monkeypatch.delitem(sys.modules, "rclpy.context")
    assert chosen("--ros2") == ["Ros2Transport"]
    assert "there is an rclpy, but" in caplog.text


def test_rclpy_without_rclpy_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert main([*QUIET, "--ros2", "rclpy"]) == 2
    said = capsys.readouterr().err
    assert f"--ros2 rclpy: {sys.executable} cannot import rclpy" in said
    assert "source /opt/ros/DISTRO/setup.bash" in said


def test_another_way_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*QUIET, "--ros2", "cyclone"]) == 2
    assert "--ros2: invalid choice: 'cyclone'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "", "with programs on this machine"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", "with programs on this machine"),
        ("ROS_LOCALHOST_ONLY", "1", "with programs on this machine"),
        ("ROS_LOCALHOST_ONLY", "0", "with the whole network, without any password"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET", "with the whole network, without any password"),
        ("CYCLONEDDS_URI", "<General/>", "without any password, where CYCLONEDDS_URI says"),
    ],
)
def test_the_start_line_says_how_far_it_speaks(name: str, value: str, words: str) -> None:
    assert reach({name: value}) == words


def test_it_keeps_to_this_machine_unless_it_is_told_otherwise(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    for said in (None, "SUBNET"):
        if said is not None:
            monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", said)
        transport = RclpyTransport()
        transport.start(Rows())  # type: ignore[arg-type]
        transport.close()
        assert os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == said
    assert [context.range for context in wire.contexts] == ["LOCALHOST", "SUBNET"]


Decode = Callable[[str, bytes], dict]


class Rows:
    """As much of a core as a start asks for."""

    def __init__(self, *topics: Topic) -> None:
        self.topics = {topic.name: topic for topic in topics}
        self.services: dict[str, object] = {}
        self.stamper = SimpleNamespace(mode="wall")
        self.loop = SimpleNamespace(world=SimpleNamespace(arms={}, rig=None))

    def latched(self, name: str) -> dict | None:
        return {"data": "as it was"} if name == "kept" else None

    def decoded(
        self, topic: Topic, data: bytes, decode: Callable[[str, bytes], dict], _: str
    ) -> dict:
        return decode(topic.type, data)


def test_names_that_ros_2_does_not_allow_are_left_out(
    wire: Wire, caplog: pytest.LogCaptureFixture
) -> None:
    right, wrong = (Topic(name, "std_msgs/String", "pub") for name in ("right", "9-wrong"))
    transport = RclpyTransport()
    transport.start(Rows(right, wrong))  # type: ignore[arg-type]
    transport.close()
    assert [p.topic for p in wire.nodes[0].publishers] == ["/right"]
    assert "topic 9-wrong is not available" in caplog.text


def test_what_is_latched_already_is_published_at_the_start(wire: Wire) -> None:
    transport = RclpyTransport()
    transport.start(Rows(Topic("kept", "std_msgs/String", "pub", latched=True)))  # type: ignore[arg-type]
    assert len(wire.listen("/kept")) == 1
    transport.close()
    transport.close()


def test_a_start_that_fails_leaves_nothing_behind(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise RCLError("no such RMW")

    monkeypatch.setattr(sys.modules["rclpy"], "create_node", refuse)
    with pytest.raises(TrocarError, match="--ros2: rclpy cannot start its node: no such RMW"):
        RclpyTransport().start(Rows())  # type: ignore[arg-type]
    assert [context.ok() for context in wire.contexts] == [False]


def test_rclpy_that_fails_within_is_told_and_asked_again(
    wire: Wire, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(rclpy_node, "PAUSE_S", 0.0)
    topic = Topic("told", "std_msgs/String", "sub")
    rows = Rows(topic)
    heard: list[str] = []

    def receive(name: str, fields: dict, peer: str) -> bool:  # noqa: ARG001
        heard.append(fields["data"])
        return True

    rows.receive = receive  # type: ignore[attr-defined]
    transport = RclpyTransport()
    transport.start(rows)  # type: ignore[arg-type]
    subscription = wire.subscription("/told")
    right = subscription.callback

    def fail(*_: object) -> None:
        subscription.callback = right
        raise RCLError("failed to take")

    subscription.callback = fail
    text = b"\0\1\0\0\2\0\0\0a\0"
    wire.write("/told", text)
    wire.write("/told", text)
    end = time.monotonic() + 10.0
    while not heard and time.monotonic() < end:
        time.sleep(0.005)
    transport.close()
    assert heard == ["a"]
    assert "error in rclpy, continuing" in caplog.text


def test_what_was_written_first_is_obeyed_first_on_whatever_topic(wire: Wire) -> None:
    rows = Rows(*(Topic(name, "std_msgs/Empty", "sub") for name in ("one", "two")))
    heard: list[str] = []
    rows.receive = lambda name, *_: heard.append(name)  # type: ignore[attr-defined]
    transport = RclpyTransport()
    transport.start(rows)  # type: ignore[arg-type]
    with wire.bell:  # all is there when the node looks
        for name, written in (("/two", 1), ("/two", 2), ("/one", 3), ("/one", 4), ("/one", 5)):
            wire.write(name, b"\0\1\0\0\0", written)
    end = time.monotonic() + 10.0
    while len(heard) < 5 and time.monotonic() < end:
        time.sleep(0.005)
    transport.close()
    assert heard == ["two", "two", "one", "one", "one"]


def test_set_points_do_not_wait_to_be_put_in_order(wire: Wire) -> None:
    rows = Rows(
        Topic("move", "std_msgs/Empty", "sub"), Topic("servo", "std_msgs/Empty", "sub", depth=1)
    )
    heard: list[str] = []
    rows.receive = lambda name, *_: heard.append(name)  # type: ignore[attr-defined]
    transport = RclpyTransport()
    transport.start(rows)  # type: ignore[arg-type]
    with wire.bell:
        wire.write("/move", b"\0\1\0\0\0", 1)
        wire.write("/servo", b"\0\1\0\0\0", 2)
    end = time.monotonic() + 10.0
    while len(heard) < 2 and time.monotonic() < end:
        time.sleep(0.005)
    transport.close()
    assert heard == ["servo", "move"]
