"""A simulator as a node of ROS 2, with rclpy's stand-in: topics, commands, services, the end."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from tests.ros.rclpy_node.conftest import Serving
from tests.ros.rclpy_node.stand_in import (
    DurabilityPolicy,
    Parameter,
    ReliabilityPolicy,
    Wire,
    packages,
)
from trocar.messages import blank, cdr_decode, cdr_encode

JOINTS = "sensor_msgs/JointState"
STATE = "crtk_msgs/OperatingState"
ORDER = "crtk_msgs/StringStamped"


def until(true: Callable[[], object], what: str) -> None:
    end = time.monotonic() + 20.0
    while not true():
        assert time.monotonic() < end, what
        time.sleep(0.005)


def told(data: bytes) -> str:
    return cdr_decode(STATE, data)["state"]


def order(text: str) -> bytes:
    return cdr_encode(ORDER, {**blank(ORDER), "string": text})


def move(*goal: float) -> bytes:
    return cdr_encode(JOINTS, {**blank(JOINTS), "position": np.array(goal)})


def test_states_go_out_as_bytes_while_somebody_listens(serving: Serving, wire: Wire) -> None:
    with serving() as (_, transport):
        assert "PSM1/measured_js" not in transport.wanted()
        heard = wire.listen("/PSM1/measured_js")
        until(lambda: len(heard) > 50, "no states")
        for data in heard[:50]:
            state = cdr_decode(JOINTS, data)
            assert state["name"][:3] == ["yaw", "pitch", "insertion"]
            assert data == cdr_encode(JOINTS, state)
        assert not wire.topic("/PSM1/measured_cp").history
        assert transport.lost == 0


def test_late_subscribers_get_the_last_of_latched_topics_and_no_older(
    serving: Serving, wire: Wire
) -> None:
    with serving():
        early = wire.listen("/PSM1/operating_state")
        until(lambda: early, "no state")
        wire.write("/PSM1/state_command", order("enable"))
        until(lambda: told(early[-1]) == "ENABLED", "not enabled")
        assert [told(data) for data in wire.listen("/PSM1/operating_state")] == ["ENABLED"]


def test_a_topic_promises_what_every_subscriber_asks_for(serving: Serving, wire: Wire) -> None:
    with serving():
        for name, depth, kept in (
            ("/PSM1/measured_js", 64, DurabilityPolicy.VOLATILE),
            ("/PSM1/operating_state", 1, DurabilityPolicy.TRANSIENT_LOCAL),
            ("/tf_static", 1, DurabilityPolicy.TRANSIENT_LOCAL),
        ):
            quality = wire.topic(name).qos_profile
            assert (quality.depth, quality.durability) == (depth, kept)
            assert quality.reliability is ReliabilityPolicy.RELIABLE
        assert wire.subscription("/PSM1/servo_jp").qos_profile.depth == 1
        assert wire.subscription("/PSM1/move_jp").qos_profile.depth == 1024


def test_commands_are_obeyed_in_the_order_of_writing_whatever_comes_first(
    serving: Serving, wire: Wire
) -> None:
    goal = 0.2, -0.1, 0.1, 0.0, 0.0, 0.0
    with serving() as (core, _):
        wire.write("/PSM1/move_jp", move(*goal), 30)
        wire.write("/PSM1/state_command", order("enable"), 10)
        wire.write("/PSM1/state_command", order("home"), 20)
        setpoints = wire.listen("/PSM1/setpoint_js")
        until(
            lambda: (
                setpoints
                and np.allclose(cdr_decode(JOINTS, setpoints[-1])["position"][:6], goal, atol=1e-6)
            ),
            "the arm did not go there",
        )
        assert core.refused == 0


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"\0\1\0\0", "not this message"),
        (b"\0\0\0\0" + bytes(60), "little endian"),
        (b"\0\1\0\0" + bytes(1_000_000), "got 1000004 bytes; allowed: up to 1000000"),
        (move(float("nan"), 0.0, 0.0, 0.0, 0.0, 0.0), "got position[0] nan"),
    ],
    ids=["short", "big endian", "long", "nan"],
)
def test_what_is_no_command_is_refused_and_told(
    serving: Serving, wire: Wire, data: bytes, reason: str
) -> None:
    with serving() as (core, _):
        warnings = wire.listen("/PSM1/warning")
        wire.write("/PSM1/servo_jp", data)
        until(lambda: core.refused, "it was not refused")
        until(lambda: warnings, "nobody was told")
        assert reason in cdr_decode("std_msgs/String", warnings[-1])["data"]


def test_calls_are_answered_by_objects_of_the_service(serving: Serving, wire: Wire) -> None:
    with serving():
        call = wire.call("/PSM1/forward_kinematics", jp=[0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
        answer = call.result()
        assert type(answer).__name__ == "QueryForwardKinematics_Response"
        assert answer.result is True
        assert answer.cp["position"]["z"] < -0.1


def test_a_call_that_cannot_be_answered_says_why_and_the_next_one_is(
    serving: Serving, wire: Wire, caplog: pytest.LogCaptureFixture
) -> None:
    with serving() as (core, _):
        right = core.call

        def wrong(*_: object) -> dict:
            raise ZeroDivisionError

        core.call = wrong  # type: ignore[method-assign]
        broken = wire.call("/PSM1/forward_kinematics", jp=[0.0])
        until(lambda: "service call failed" in caplog.text, "nothing was said")
        core.call = right  # type: ignore[method-assign]
        bad = wire.call("/PSM1/forward_kinematics", jp=[0.0] * 20).result()
        assert bad.result is False
        assert bad.message
        long = wire.call("/PSM1/forward_kinematics", jp=[0.0] * 200_000).result()
        assert "allowed: up to 1000000" in long.message
        assert not broken.done.is_set()


def test_the_model_and_the_gains_are_parameters_of_the_node(serving: Serving, wire: Wire) -> None:
    with serving() as (core, _):
        (node, _) = wire.nodes
        yaw = core.loop.world.arm("PSM1").joints.gains("yaw")
        assert node.parameters["PSM1.yaw_controller.p"] == yaw[0]
        warnings = wire.listen("/PSM1/warning")
        good, bad = (Parameter("PSM1.yaw_controller.p", value=value) for value in (77.0, "much"))
        assert [r.successful for r in node.set_parameters([good, bad])] == [True, False]
        until(
            lambda: core.loop.world.arm("PSM1").joints.gains("yaw")[0] == 77.0,
            "the gain is not set",
        )
        until(lambda: warnings, "nobody was told")
        assert "yaw_controller/p: got 'much'" in cdr_decode("std_msgs/String", warnings[0])["data"]
        until(lambda: "robot_description" in node.parameters, "no model")
        assert "<robot" in node.parameters["robot_description"]
        (result,) = node.set_parameters([Parameter("robot_description", value="x")])
        assert result.reason == "robot_description: read-only"


def test_a_workspace_without_crtk_msgs_has_the_other_topics_and_is_told(
    serving: Serving, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, module in packages(["crtk_msgs", "trocar_msgs"]).items():
        monkeypatch.setitem(sys.modules, name, module)
    with serving() as (core, transport):
        heard = wire.listen("/PSM1/measured_js")
        until(lambda: heard, "no states")
        names = {p.topic for node in wire.nodes for p in node.publishers}
        assert "/PSM1/operating_state" not in names
        rows = (*core.topics.values(), *core.services.values())
        count = sum(
            row.type.startswith("crtk_msgs/") and not getattr(row, "later", False) for row in rows
        )
        assert transport.greeting.splitlines() == [
            "ROS 2: node /trocar by rclpy, rmw_fastrtps_cpp, domain 0;"
            " with programs on this machine",
            "  without crtk_msgs (github.com/collaborative-robotics/crtk_msgs):"
            f" {count} topics and services are left out",
            "  without trocar_msgs (docs/ros.md, ROS 2): 1 topics and services are left out",
        ]


def test_types_with_other_fields_or_without_libraries_are_left_out(
    serving: Serving, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = type("Joy", (), {"get_fields_and_field_types": classmethod(lambda _: {"axes": ""})})
    monkeypatch.setattr(sys.modules["sensor_msgs.msg"], "Joy", other)
    monkeypatch.delattr(sys.modules["crtk_msgs.srv"], "QueryForwardKinematics")
    wire.without_support = ("geometry_msgs",)
    with serving() as (_, transport):
        assert "sensor_msgs, in which sensor_msgs/Joy has other fields" in transport.greeting
        assert "crtk_msgs, which has no QueryForwardKinematics (github" in transport.greeting
        assert "geometry_msgs, whose libraries cannot be loaded" in transport.greeting
        assert wire.topic("/PSM1/measured_js")


def test_the_end_leaves_no_node_no_context_and_no_thread(serving: Serving, wire: Wire) -> None:
    before = threading.active_count()
    with serving():
        assert [node.name for node in wire.nodes] == ["trocar", "trocar_services"]
        assert [context.ok() for context in wire.contexts] == [True]
    assert all(node.destroyed for node in wire.nodes)
    assert [context.ok() for context in wire.contexts] == [False]
    assert threading.active_count() == before


def test_when_rclpy_is_shut_down_the_simulation_goes_on(
    serving: Serving, wire: Wire, caplog: pytest.LogCaptureFixture
) -> None:
    with serving() as (core, _):
        wire.contexts[0].try_shutdown()
        until(lambda: "ROS 2 stopped" in caplog.text, "nothing was said")
        assert core.loop.running


def test_what_rclpy_does_not_take_is_counted_and_told(
    serving: Serving, wire: Wire, caplog: pytest.LogCaptureFixture
) -> None:
    with serving() as (_, transport):
        wire.listen("/PSM1/measured_js")
        wire.broken = True
        until(lambda: transport.lost > 10, "nothing is lost")
        wire.broken = False
    assert "ROS 2: 1 messages lost, the last of " in caplog.text
    assert "ROS 2: 8 messages lost" in caplog.text
    assert "ROS 2: 9 messages lost" not in caplog.text
