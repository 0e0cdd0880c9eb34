"""A robot that is there now, which is another simulator, is followed over each transport."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import numpy as np
import pytest

from benchmarks.served import served
from trocar.errors import InputError, TrocarError
from trocar.live import Command, Loop
from trocar.live.loop import SERVER_TICK_S
from trocar.robot.follow import LiveSource, Mirror
from trocar.ros import Core
from trocar.ros.transports.websocket import WebSocketTransport
from trocar.ros.transports.websocket.client import WebSocketClient
from trocar.simulation import World

PATIENCE_S = 20.0


def until(done: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < end, what
        time.sleep(0.02)


@contextmanager
def robot() -> Iterator[tuple[Loop, WebSocketTransport, Core]]:
    """A simulated PSM that others take for a real one."""
    loop = Loop(World("psm"), tick_s=SERVER_TICK_S)
    core = Core(loop, rate_hz=200.0)
    transport = WebSocketTransport("127.0.0.1", 0, None)
    core.attach(transport)
    with closing(loop), closing(core):
        core.start()
        loop.start()
        yield loop, transport, core


@contextmanager
def twin(source: LiveSource) -> Iterator[tuple[Loop, Mirror]]:
    loop = Loop(World("psm"), tick_s=SERVER_TICK_S)
    mirror = Mirror(loop, source)
    with closing(loop), closing(mirror):
        mirror.start()
        loop.start()
        yield loop, mirror


def joints(loop: Loop) -> np.ndarray:
    return loop.latest.arms["PSM1"].q


def test_the_twin_goes_where_the_robot_goes_and_holds_when_it_is_gone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING, "trocar"), robot() as (real, transport, core):
        address = transport.greeting.split()[-1]
        address = next(w for w in transport.greeting.split() if w.startswith("ws://"))
        source = LiveSource(WebSocketClient(address))
        with twin(source) as (own, mirror):
            until(lambda: mirror.twins["PSM1"].heard > 20, "nothing heard")
            real.post(Command("PSM1", "servo_jp", {"q": (0.3, -0.2, 0.15, 0.4, 0.2, 0.1)}))
            until(lambda: abs(joints(own)[0] - 0.3) < 5e-3, "it does not follow")
            time.sleep(0.5)
            np.testing.assert_allclose(joints(own), joints(real), atol=2e-3)
            assert mirror.report().arms["PSM1"].rate_hz > 50.0
            assert "follows" in mirror.page()
            core.close()
            real.close()
            until(lambda: mirror.twins["PSM1"].silent, "silence is not told")
            held = joints(own).copy()
            time.sleep(0.3)
            np.testing.assert_allclose(joints(own), held, atol=1e-6)
            assert "no message, holds" in mirror.page()
    said = "\n".join(r.getMessage() for r in caplog.records)
    assert "PSM1: no message for 500 ms; holding position" in said
    assert "connection lost" in said


def test_nobody_there_is_told() -> None:
    client = WebSocketClient("ws://127.0.0.1:1")
    with pytest.raises(TrocarError, match=r"no connection to ws://127\.0\.0\.1:1"):
        client.start()
    with pytest.raises(InputError, match="allowed: ws://HOST:PORT"):
        WebSocketClient("http://x")


def test_the_twin_follows_a_robot_on_ros_2() -> None:
    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed (extra ros2)")
    from trocar.ros.transports.ros2 import Ros2Client, network

    alone = {"ROS_DOMAIN_ID": "87"}
    words = ["--no-page", "--rig", "psm", "--pose", "start", "--ros2", "dds"]
    words += ["--websocket-port", "0"]
    with served(words, r"ROS 2.*|.*loopback.*", alone):
        source = LiveSource(Ros2Client(network(alone)))
        with twin(source) as (own, mirror):
            until(lambda: mirror.twins["PSM1"].heard > 50, "nothing heard over ROS 2")
            assert mirror.report().arms["PSM1"].rate_hz > 50.0
            assert np.abs(joints(own)[:2]).max() < 0.05
