"""How many Python calls a set-point takes from the socket to the inbox."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

from tests.calls import calls_of
from tests.ros.asking import HOME, joints, stamped
from tests.ros.served import Served
from tests.ros.websocket.test_conversation import Wire
from trocar.messages import from_json
from trocar.ros.transports.websocket.server import Client, Conversation

SENT = stamped(joints(*HOME), (0, 0)) | {"header": {"stamp": {"secs": 0, "nsecs": 0}}}


def calls(work: Callable[[], object]) -> list[str]:
    """List the functions of Python that are called, in order."""
    return [call.function for call in calls_of(work, counted=lambda _: True)][1:]


def test_a_set_point_takes_few_calls_from_json_to_the_inbox() -> None:
    served = Served(wanted=())

    def take() -> None:
        served.core.receive("PSM1/servo_jp", from_json("sensor_msgs/JointState", SENT), "peer")

    take()
    served.run()
    called = calls(take)
    assert len(called) <= 16, called
    served.run()
    assert served.world.arm("PSM1").setpoint_js().position.tolist() == HOME


def test_a_set_point_takes_few_calls_from_the_text_frame_to_the_inbox() -> None:
    served = Served(wanted=())
    client = Client(cast("Any", Wire()), {})
    conversation = Conversation(served.core, ThreadPoolExecutor(1))
    text = json.dumps({"op": "publish", "topic": "/PSM1/servo_jp", "msg": SENT})

    def take() -> None:
        assert client.may_send(len(text))
        conversation.handle(client, text)

    take()
    served.run()
    called = calls(take)
    assert "post" in called and len(called) <= 25, called
    served.run()
    assert served.world.arm("PSM1").setpoint_js().position.tolist() == HOME
