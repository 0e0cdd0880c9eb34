"""The view in Foxglove, by a client that knows its protocol and rosbags' reader of ROS 2."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import trocar
from trocar.errors import InputError
from trocar.messages import cdr_decode, message_type

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")

from tests.ros.foxglove.viewer import Viewer, until, viewer
from tests.ros.served import Served, stamp_ns
from trocar.ros.publishing import Out, Publishing
from trocar.ros.sample import Sample
from trocar.ros.transports.foxglove import FoxgloveTransport

ARM = "/PSM1/measured_js"


class Shown(Served):
    """A served arm with Foxglove instead of a list; nobody else wants anything."""

    def __init__(self, record: str | None = None, **core) -> None:
        super().__init__(wanted=(), **core)
        self.foxglove = FoxgloveTransport(0, record)
        self.core.attach(self.foxglove)
        self.published = [
            topic for topic in self.core.topics.values() if topic.direction == "pub"
            if not topic.later
        ]  # fmt: skip

    def viewer(self):
        return viewer(self.foxglove.port, len(self.published))

    def view(self, client: Viewer, *topics: str) -> None:
        """Subscribe, and wait until the simulator knows."""
        client.subscribe(*topics)
        until(lambda: {t[1:] for t in topics} <= self.foxglove.wanted())


@pytest.fixture
def shown() -> Iterator[Shown]:
    served = Shown()
    yield served
    served.core.close()


def test_every_published_topic_is_offered_as_ros_2_has_it(shown: Shown) -> None:
    with shown.viewer() as client:
        assert set(client.channels) == {f"/{topic.name}" for topic in shown.published}
        for topic in shown.published:
            told, kind = client.channels[f"/{topic.name}"], message_type(topic.type)
            assert (told["encoding"], told["schemaEncoding"]) == ("cdr", "ros2msg")
            assert (told["schemaName"], told["schema"]) == (kind.ros2_name, kind.text_ros2)


def test_a_viewer_reads_the_arms_joints_by_the_text_that_came_with_them(shown: Shown) -> None:
    typesys = pytest.importorskip("rosbags.typesys", reason="the extra bags is not installed")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    with shown.viewer() as client:
        told = client.channels[ARM]
        store.register(typesys.get_types_from_msg(told["schema"], told["schemaName"]))
        shown.view(client, ARM)
        shown.run(0.01)
        topic, log_ns, data = client.message()
    read = store.deserialize_cdr(data, told["schemaName"])
    assert topic == ARM
    arm = shown.world.arm("PSM1")
    assert [*read.name, "jaw"] == list(arm.joints.names)
    np.testing.assert_allclose(read.position, arm.measured_js().position[:6], atol=1e-5)
    assert np.any(np.abs(read.position) > 0.01)
    assert log_ns == read.header.stamp.sec * 10**9 + read.header.stamp.nanosec


def test_only_what_somebody_views_is_computed(
    shown: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    states = Publishing.states

    def counted(self: Publishing, sample: Sample, wanted: list[frozenset[str]]) -> list[Out]:
        made.extend(name for names in wanted for name in names)
        return states(self, sample, wanted)

    monkeypatch.setattr(Publishing, "states", counted)
    with shown.viewer() as client:
        shown.run(0.02)
        assert made == []
        shown.view(client, ARM)
        shown.run(0.02)
        assert set(made) == {"PSM1/measured_js"}
        client.unsubscribe(ARM)
        until(lambda: not shown.foxglove.wanted())
        shown.view(client, "/tf")
    until(lambda: not shown.foxglove.wanted())
    made.clear()
    shown.run(0.02)
    assert made == []


def test_who_comes_late_gets_what_is_latched(shown: Shown) -> None:
    shown.run(0.02)
    for _ in range(2):
        with shown.viewer() as client:
            client.subscribe("/tf_static")
            until(lambda: "tf_static" in shown.foxglove.wanted())
            shown.run()
            topic, _, data = client.message()
            assert topic == "/tf_static"
            frames = cdr_decode("tf2_msgs/TFMessage", data)["transforms"]
            assert {frame["header"]["frame_id"] for frame in frames} == {"world"}


def test_simulated_time_is_the_viewers_time() -> None:
    served = Shown(clock="sim")
    try:
        with served.viewer() as client:
            assert client.hello["capabilities"] == ["time"]
            served.view(client, ARM)
            served.run(0.01)
            assert 1_000_000_000 <= client.time() < 2_000_000_000
    finally:
        served.core.close()


def test_nobody_moves_an_arm_from_here(shown: Shown) -> None:
    with shown.viewer() as client:
        assert client.hello["capabilities"] == []
        channel = {
            "id": 1, "topic": "/PSM1/move_jp", "encoding": "json",
            "schemaName": "sensor_msgs/msg/JointState",
        }  # fmt: skip
        client.say(op="advertise", channels=[channel])
        client.socket.send(b"\x01\x01\x00\x00\x00{}")
        shown.view(client, ARM)
        shown.run(0.01)
        assert client.message()[0] == ARM
    assert shown.core.refused == 0


def test_a_viewer_that_reads_nothing_does_not_hold_up_the_end(shown: Shown) -> None:
    topic, large = shown.core.topics["system/status"], {"data": "x" * 500_000}
    with shown.viewer() as client:
        shown.view(client, "/system/status")
        for _ in range(64):  # more than sockets and the viewer's own queue hold
            shown.foxglove.send([(topic, large)])
            time.sleep(0.01)
        end = threading.Thread(target=shown.core.close, daemon=True)
        end.start()
        end.join(10.0)
        assert not end.is_alive()


def test_a_port_that_is_taken_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        served = Served(wanted=())
        transport = FoxgloveTransport(taken.getsockname()[1])
        with pytest.raises(InputError, match=r"cannot listen on 127\.0\.0\.1 port .*in use"):
            served.core.attach(transport)
        served.core.close()
    with pytest.raises(InputError, match="got port 70000"):
        FoxgloveTransport(70000)


def test_a_file_holds_every_topic_as_it_was_sent(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader", reason="the extra record is not installed")
    file = tmp_path / "view.mcap"
    served = Shown(str(file), rate_hz=100.0)
    served.run(0.1)
    served.core.close()
    with file.open("rb") as stream:
        rows = list(reader.make_reader(stream).iter_messages())
    told = {channel.topic for _, channel, _ in rows}
    assert {ARM, "/PSM1/measured_cp", "/PSM1/operating_state", "/tf", "/tf_static"} <= told
    joints = [(m.log_time, m.data) for _, c, m in rows if c.topic == ARM]
    read = [(log_ns, cdr_decode("sensor_msgs/JointState", data)) for log_ns, data in joints]
    assert len(read) >= 9
    assert all(log_ns == stamp_ns(message) for log_ns, message in read)
    with pytest.raises(InputError, match=r"--foxglove-record .*exists"):
        Shown(str(file))


def test_without_the_extra_one_line_names_it() -> None:
    code = (
        "import sys; sys.modules['foxglove'] = None; from trocar.cli import main; sys.exit(main())"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, "sim", "--foxglove",
         "--rig", "psm", "--no-page", "--no-websocket"],
        env={**os.environ, "PYTHONPATH": str(Path(trocar.__file__).parents[1])},
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert ended.returncode == 1
    assert ended.stderr.strip().endswith(
        "Foxglove needs foxglove-sdk, which is not installed: pip install 'trocar[foxglove]'"
    )
