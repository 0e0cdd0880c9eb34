"""The rosbridge protocol on a real socket."""

from __future__ import annotations

import contextlib
import math
import re
import time

import pytest

from tests.ros.websocket.conftest import Served, Talk, until

JS = "/PSM1/measured_js"
HOME = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]


def test_states_come_as_long_as_they_are_wanted(served: Served, talk: Talk) -> None:
    talk.send(op="subscribe", topic=JS)
    first, second = talk.hear_on(JS), talk.hear_on(JS)
    assert first["name"][:3] == ["yaw", "pitch", "insertion"]
    assert len(first["position"]) == 6
    stamps = [
        (m["header"]["stamp"]["secs"], m["header"]["stamp"]["nsecs"]) for m in (first, second)
    ]
    assert (0, 0) < stamps[0] < stamps[1]
    talk.send(op="unsubscribe", topic=JS)
    talk.wait_for_server()
    with pytest.raises(TimeoutError):
        talk.hear(0.2)
    assert until(lambda: not served.transport.wanted())


def test_only_what_somebody_wants_is_made(served: Served, talk: Talk) -> None:
    talk.send(op="subscribe", topic=JS)
    other = Talk(served.url)
    other.send(op="subscribe", topic="/PSM1/measured_cp")
    assert until(lambda: served.transport.wanted() == {"PSM1/measured_js", "PSM1/measured_cp"})
    other.socket.close()
    assert until(lambda: served.transport.wanted() == {"PSM1/measured_js"})


def test_a_name_without_a_slash_is_the_same_topic_and_comes_back_as_it_was_spelled(
    talk: Talk,
) -> None:
    talk.send(op="subscribe", topic="PSM1/measured_js", type="sensor_msgs/msg/JointState")
    assert talk.hear_on("PSM1/measured_js")["name"]


def test_a_late_subscriber_gets_the_last_of_a_latched_topic(talk: Talk) -> None:
    other = Talk(talk.url)
    other.send(op="subscribe", topic="/PSM1/tool_type")
    assert other.hear_on("/PSM1/tool_type")["data"].startswith("LARGE_NEEDLE_DRIVER")
    talk.send(op="subscribe", topic="/PSM1/tool_type")  # it was told already, and will not change
    assert talk.hear_on("/PSM1/tool_type")["data"].startswith("LARGE_NEEDLE_DRIVER")
    other.socket.close()


def test_a_throttled_topic_comes_less_often(talk: Talk) -> None:
    """In wall-clock time, which goes on where a busy machine slows the simulation down."""
    talk.send(op="subscribe", topic=JS, throttle_rate=200)
    times: list[float] = []
    for _ in range(4):
        talk.hear_on(JS)
        times.append(time.monotonic())
    assert times[-1] - times[0] > 0.4


def test_of_two_requests_for_a_topic_the_faster_counts_and_each_is_taken_back_alone(
    talk: Talk,
) -> None:
    talk.send(op="subscribe", topic=JS, id="slow", throttle_rate=3_600_000)
    talk.send(op="subscribe", topic=JS, id="fast")
    for _ in range(3):
        talk.hear_on(JS)
    talk.send(op="unsubscribe", topic=JS, id="fast")
    talk.wait_for_server()
    with contextlib.suppress(TimeoutError):  # what was on its way
        for _ in range(20):
            talk.hear(0.2)
    with pytest.raises(TimeoutError):
        talk.hear(0.2)


def test_a_move_moves_the_arm(talk: Talk) -> None:
    talk.send(op="advertise", topic="/PSM1/move_jp", type="sensor_msgs/JointState")
    talk.send(op="subscribe", topic=JS, throttle_rate=10)
    goal = [0.2, *HOME[1:]]
    talk.send(op="publish", topic="/PSM1/move_jp", msg={"position": goal})
    talk.hear_on(JS, lambda m: math.isclose(m["position"][0], 0.2, abs_tol=1e-3))
    talk.send(op="publish", topic="/PSM1/move_jp", msg={"position": HOME})
    talk.hear_on(JS, lambda m: math.isclose(m["position"][0], 0.0, abs_tol=1e-3))


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ({"position": [0.1, 0.2]}, "move_jp: got 2 numbers"),
        ({"position": [math.nan] * 6}, "move_jp: .*(nan|NaN)"),
        ({"position": "far"}, "move_jp: .*position"),
        ({"positions": HOME}, "move_jp: .*positions"),
    ],
)
def test_a_bad_message_is_told_on_the_arms_warning_topic(
    served: Served, talk: Talk, message: dict[str, object], words: str
) -> None:
    served.core.forget_refusals()
    talk.send(op="subscribe", topic="/PSM1/warning")
    talk.send(op="publish", topic="/PSM1/move_jp", msg=message)
    talk.hear_on("/PSM1/warning", lambda m: bool(re.search(words, m["data"])))  # not the last one
    assert until(lambda: abs(served.loop.latest.arms["PSM1"].setpoint[:6] - HOME).max() < 1e-6)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"op": "subscribe", "topic": "/PSM9/measured_js"}, "unknown topic"),
        ({"op": "subscribe", "topic": "/PSM1/servo_jp"}, "trocar listens to it"),
        ({"op": "subscribe", "topic": JS, "type": "std_msgs/Empty"}, "it has sensor_msgs/Joint"),
        ({"op": "publish", "topic": JS, "msg": {}}, "trocar itself publishes it"),
        ({"op": "publish", "topic": "/nowhere", "msg": {}}, "unknown topic"),
        ({"op": "advertise", "topic": "/PSM1/hold", "type": "std_msgs/Bool"}, "std_msgs/Empty"),
        (
            {"op": "advertise_service", "type": "a/B", "service": "/s"},
            "offered by clients are not supported",
        ),
        ({"op": "dance"}, "op: got 'dance'"),
    ],
)
def test_what_cannot_be_done_is_told_to_the_client(
    talk: Talk, document: dict[str, str], words: str
) -> None:
    talk.send(**document, id="q")
    status = talk.hear_op("status")
    assert (status["level"], status["id"]) == ("error", "q")
    assert words in status["msg"]


def test_a_client_may_ask_for_silence(talk: Talk) -> None:
    talk.send(op="set_level", level="none")
    talk.send(op="dance")
    talk.send(op="call_service", service="/rosapi/nodes")
    assert talk.hear()["op"] == "service_response"


def test_text_that_is_no_json_is_answered_and_the_talk_goes_on(talk: Talk) -> None:
    for junk in ("", "{", "nonsense", "[" * 50_000, "\x00"):
        talk.socket.send(junk)
        assert "invalid JSON" in talk.hear_op("status")["msg"]
    talk.socket.send(b"\x00\x01")
    assert "binary" in talk.hear_op("status")["msg"]
    talk.wait_for_server()


def test_rosapi_tells_every_topic_and_service_with_its_type(served: Served, talk: Talk) -> None:
    told = talk.call("/rosapi/topics")["values"]
    types = dict(zip(told["topics"], told["types"], strict=True))
    there = {f"/{n}": t.type for n, t in served.core.topics.items() if not t.later}
    assert types == there
    assert types[JS] == "sensor_msgs/JointState"
    services = talk.call("rosapi/services")["values"]["services"]
    assert {f"/{name}" for name in served.core.services} < set(services)
    for name, service in served.core.services.items():
        answered = talk.call("/rosapi/service_type", {"service": f"/{name}"})
        assert answered["values"] == {"type": service.type}
        break


@pytest.mark.parametrize(
    ("service", "args", "values"),
    [
        ("topic_type", {"topic": JS}, {"type": "sensor_msgs/JointState"}),
        ("topic_type", {"topic": "/nowhere"}, {"type": ""}),
        ("topic_type", [JS], {"type": "sensor_msgs/JointState"}),
        ("nodes", None, {"nodes": ["/trocar"]}),
        ("publishers", {"topic": JS}, {"publishers": ["/trocar"]}),
        ("subscribers", {"topic": JS}, {"subscribers": []}),
        ("get_param_names", {}, {"names": []}),
    ],
)
def test_rosapi_answers(talk: Talk, service: str, args: object, values: object) -> None:
    response = talk.call(f"/rosapi/{service}", args)
    assert response["result"] is True
    assert response["values"] == values


def test_rosapi_describes_messages_field_by_field(talk: Talk) -> None:
    told = talk.call("/rosapi/message_details", {"type": "geometry_msgs/PoseStamped"})
    whole = {typedef["type"]: typedef for typedef in told["values"]["typedefs"]}
    assert whole["geometry_msgs/Pose"]["fieldnames"] == ["position", "orientation"]
    assert whole["geometry_msgs/Point"]["fieldtypes"] == ["float64"] * 3
    assert whole["std_msgs/Header"]["fieldarraylen"] == [-1, -1]


@pytest.mark.parametrize("service", ["/rosapi/explode", "/nothing", "/rosapi/../../etc/passwd"])
def test_a_service_that_is_not_there_says_so(talk: Talk, service: str) -> None:
    response = talk.call(service)
    assert response["result"] is False
    assert "unknown service" in response["values"]
