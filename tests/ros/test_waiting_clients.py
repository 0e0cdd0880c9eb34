"""A client of the dVRK waits for moves by stamps; it sees each of them, also in a hiccup."""

from __future__ import annotations

import json
import time

import pytest
from websockets.sync.client import connect

from tests.ros.asking import HOME, joints
from tests.ros.served import stamp_ns
from trocar.live import Loop
from trocar.live.loop import SERVER_TICK_S
from trocar.ros import Core
from trocar.ros.transports.memory import MemoryTransport
from trocar.ros.transports.websocket import WebSocketTransport
from trocar.simulation import World

PATIENCE_S = 20.0


def waited(transport: MemoryTransport, start_ns: int) -> bool:
    """Wait as crtk_python_client 1.4 does: busy after the start, and then not busy."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        told = list(transport.received.get("PSM1/operating_state", []))
        last_busy = max((stamp_ns(m) for m in told if m["is_busy"]), default=0)
        if last_busy > start_ns and not told[-1]["is_busy"]:
            return True
        time.sleep(0.002)
    return False


@pytest.mark.parametrize("late_s", [0.0, 0.03])
def test_a_client_sees_the_end_of_every_move_of_zero_length(late_s):
    loop, transport = Loop(World("psm"), tick_s=SERVER_TICK_S), MemoryTransport(())
    core = Core(loop)
    core.attach(transport)
    time.sleep(0.1)  # what else a server does before time passes
    core.start()
    loop.start()
    try:
        core.receive("PSM1/move_jp", joints(*HOME))
        assert waited(transport, 0)
        for _ in range(10):
            if late_s:
                loop.ask(lambda _: time.sleep(late_s))
                time.sleep(0.5 * late_s)
            start_ns = time.time_ns()
            assert core.receive("PSM1/move_jp", joints(*HOME))
            assert waited(transport, start_ns)
    finally:
        core.close()
        loop.close()


def test_a_client_that_reads_right_after_it_subscribed_finds_a_message() -> None:
    """Its next call is answered after the first message, though the next sample is far away."""
    loop, transport = Loop(World("psm"), tick_s=SERVER_TICK_S), WebSocketTransport(port=0)
    core = Core(loop, rate_hz=0.2)
    core.attach(transport)
    core.start()
    loop.start()
    try:
        time.sleep(0.3)  # the first sample has been taken, the next comes in 5 s
        with connect(transport.address) as line:
            for topic in ("PSM1/measured_js", "PSM1/setpoint_cp", "tf"):
                line.send(json.dumps({"op": "subscribe", "topic": f"/{topic}"}))
                line.send(json.dumps({"op": "call_service", "service": "/rosapi/topics"}))
                answer = json.loads(line.recv(2.0))
                assert (answer["op"], answer.get("topic")) == ("publish", f"/{topic}")
                assert json.loads(line.recv(2.0))["op"] == "service_response"
    finally:
        loop.close()
        core.close()
