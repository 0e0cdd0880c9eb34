"""What happens between samples: operating states, goals, warnings, late subscribers."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.ros.served import Served, stamp_ns
from trocar.descriptions import load_rig
from trocar.errors import InputError, MissingExtraError
from trocar.live import Command, Loop
from trocar.ros import Core
from trocar.ros.core import topic_table
from trocar.ros.publishing import spoken
from trocar.ros.sampler import WAITING_S
from trocar.ros.transports.memory import MemoryTransport
from trocar.simulation import World
from trocar.simulation.rate_limit import BURST

#: What only transports that have a use for it ask for.
BY_TRANSPORTS = ("robot_description", "tf_static")
#: Ends of the names of topics that have no message until something happens.
HAPPENINGS = {
    *("goal_reached", "error", "warning", "status", "tool_type_request", "pinch"),
    *("slipped", "dropped", "selected", "unselected"),
}
AT_START = "PSM1/operating_state"


def busy_after(served: Served, count: int) -> list[bool]:
    return [m["is_busy"] for m in served.messages(AT_START)[count:]]


def settle(rig: str = "psm", **more) -> tuple[Served, int]:
    served = Served(rig, wanted=["PSM1/setpoint_js"], **more)
    served.run(0.02)
    return served, len(served.messages(AT_START))


@pytest.mark.parametrize("verb", ["move_jp", "jaw.move_jp", "move_cp"])
def test_a_move_of_no_length_is_busy_and_then_not(verb: str) -> None:
    served, before = settle()
    arm = served.world.arm("PSM1")
    assert arm.jaw is not None
    here = {
        "move_jp": {"q": arm.setpoint_js().position},
        "move_cp": {"T": arm.setpoint_cp().matrix},
        "jaw.move_jp": {"q": arm.jaw.setpoint_js().position},
    }
    served.loop.post(Command("PSM1", verb, here[verb]))
    served.run(0.3)
    told = busy_after(served, before)
    assert told[0] is True
    assert told[-1] is False


def test_a_move_while_moving_is_told_of_again() -> None:
    served, _ = settle()
    goal = served.world.arm("PSM1").setpoint_js().position + 0.02
    served.loop.post(Command("PSM1", "move_jp", {"q": goal}))
    served.run(0.02)
    before = len(served.messages(AT_START))
    served.loop.post(Command("PSM1", "move_jp", {"q": goal + 0.01}))
    served.run(0.02)
    assert True in busy_after(served, before)


def test_stamps_of_the_operating_state_increase_strictly() -> None:
    served, _ = settle()
    goal = served.world.arm("PSM1").setpoint_js().position + 0.02
    for sign in (1.0, -1.0, 1.0):
        served.loop.post(Command("PSM1", "move_jp", {"q": goal * sign}))
        served.run(0.05)
    served.run(1.5)
    stamps = [stamp_ns(m) for m in served.messages(AT_START)]
    assert (np.diff(stamps) > 0).all()


def test_the_operating_state_comes_when_it_changes_and_is_kept_for_late_subscribers() -> None:
    served, before = settle()
    served.run(3.0)
    assert len(served.messages(AT_START)) == before
    kept = served.core.latched(AT_START)
    assert kept is not None and kept["state"] == "ENABLED"


def test_states_that_change_are_told_with_what_was_asked_for() -> None:
    served, before = settle()
    for name in ("disable", "enable"):
        served.loop.post(Command("PSM1", "state_command", {"name": name}))
        served.run(0.01)
    assert [m["state"] for m in served.messages(AT_START)[before:]] == ["DISABLED", "ENABLED"]
    desired = [m["data"] for m in served.messages("PSM1/desired_state")]
    assert desired == ["HOMED", "DISABLED", "ENABLED"]  # the first: how it began


def test_a_refused_command_is_a_warning_on_its_arms_topic() -> None:
    served, _ = settle()
    served.loop.post(Command("PSM1", "servo_jp", {"q": [1.0]}))
    served.loop.post(Command("PSM1", "set_trajectory_ratio", {"ratio": 7.0}))
    served.run(0.01)
    told = [m["data"] for m in served.messages("PSM1/warning")]
    assert len(told) == 2
    assert "allowed: 6 numbers" in told[0]
    assert "ratio 7.0" in told[1]


def test_a_goal_that_was_reached_is_told() -> None:
    served, _ = settle()
    served.loop.post(Command("PSM1", "move_jr", {"dq": [0.01, 0, 0, 0, 0, 0]}))
    served.run(0.5)
    assert [m["data"] for m in served.messages("PSM1/goal_reached")] == [True]


def test_another_tool_is_told_and_its_poses_are_published() -> None:
    served, _ = settle()
    served.transport.want("PSM1/measured_cp", "PSM1/jaw/measured_js")
    assert served.core.latched("PSM1/tool_type") == {"data": "LARGE_NEEDLE_DRIVER:400006[..]"}
    served.loop.post(Command("PSM1", "set_tool_type", {"name": "PROGRASP_FORCEPS:420093"}))
    served.run(0.05)
    assert served.core.latched("PSM1/tool_type") == {"data": "PROGRASP_FORCEPS:420093[..13]"}
    p = served.last("PSM1/measured_cp")["pose"]["position"]
    expected = served.world.arm("PSM1").measured_cp().matrix[:3, 3]
    np.testing.assert_allclose([p["x"], p["y"], p["z"]], expected, atol=1e-6)
    served.loop.post(Command("PSM1", "set_tool_type", {"name": "none"}))
    served.run(0.02)
    before = len(served.messages("PSM1/jaw/measured_js"))
    served.run(0.05)
    assert len(served.messages("PSM1/jaw/measured_js")) == before  # no jaw, no message


def test_ratios_of_moves_are_told_when_they_change() -> None:
    served, _ = settle()
    served.loop.post(Command("PSM1", "set_trajectory_ratio", {"ratio": 0.5, "of": "velocity"}))
    served.run(0.01)
    assert served.core.latched("PSM1/trajectory_j/ratio_v") == {"data": 0.5}
    assert served.core.latched("PSM1/trajectory_j/ratio_a") == {"data": 1.0}


def test_a_pinched_gripper_is_told() -> None:
    served = Served("mtm", wanted=[])
    served.loop.post(Command("MTML", "gripper.squeeze_to", {"angle": 0.0}))
    served.run(1.0)
    assert len(served.messages("MTML/gripper/pinch")) == 1
    assert served.core.latched("MTML/gripper/closed") == {"data": True}
    assert served.core.latched("MTMR/gripper/closed") == {"data": False}


def test_samples_that_nobody_publishes_are_left_out_and_events_are_not() -> None:
    served = Served(wanted=["PSM1/measured_js"])
    for k in range(800):
        if k == 790:
            served.loop.post(Command("PSM1", "state_command", {"name": "disable"}))
        served.loop.tick()
    assert served.core.skipped > 0
    assert served.core.publish_waiting() == round(220 * WAITING_S)
    served.run(0.02)
    assert served.last(AT_START)["state"] == "DISABLED"


def test_every_latched_topic_has_a_message_for_those_who_come_late() -> None:
    served = Served("full_cart_mtm", wanted=[])
    served.run(0.01)
    rows = served.core.topics.values()
    latched = [
        t.name
        for t in rows
        if t.latched
        and not t.later
        and t.name not in BY_TRANSPORTS
        and t.name.rpartition("/")[2] not in HAPPENINGS
    ]
    assert [name for name in latched if served.core.latched(name) is None] == []


def test_buttons_pressed_and_released_at_once_have_stamps_of_their_own() -> None:
    served, _ = settle()
    for pressed in (1, 0):
        served.core.emit("console/clutch", {"axes": [], "buttons": [pressed]})
    served.run(0.01)
    down, up = served.messages("console/clutch")[-2:]
    assert (down["buttons"], up["buttons"]) == ([1], [0])
    assert stamp_ns(up) > stamp_ns(down)


@pytest.mark.parametrize(
    ("goal", "reason"),
    [([float("nan")] * 6, "position[0] nan"), ([0.0] * 6, "move_jp: the arm is DISABLED")],
)
def test_each_of_two_rejected_moves_is_answered(goal: list[float], reason: str) -> None:
    served, _ = settle()
    served.loop.post(Command("PSM1", "disable"))
    move = {"name": [], "position": goal, "velocity": [], "effort": []}
    for count in (1, 2):
        served.core.receive("PSM1/move_jp", {"header": {"stamp": (0, 0)}, **move}, "/me")
        served.run(0.01)
        assert len(served.messages("PSM1/warning")) == count
        assert reason in served.messages("PSM1/warning")[-1]["data"]


def test_of_a_flood_of_commands_that_raise_the_first_ten_are_reported() -> None:
    served, _ = settle()
    for _ in range(300):
        served.loop.post(Command("PSM1", "set_trajectory_ratio", {"ratio": 7.0}))
        served.run(0.001)
    assert len(served.messages("PSM1/warning")) == BURST
    served.run(2.0)
    served.loop.post(Command("PSM1", "set_trajectory_ratio", {"ratio": 7.0}))
    served.run(0.01)
    assert f"({300 - BURST} more such since)" in served.messages("PSM1/warning")[-1]["data"]


def test_when_a_transport_cannot_start_none_is_left_running() -> None:
    class Late(MemoryTransport):
        def start(self, core) -> None:  # noqa: ARG002
            raise InputError("the port is taken")

    core = Core(Loop(World("psm")))
    first = MemoryTransport()
    core.attach(first)
    core.attach(Late())
    with pytest.raises(InputError, match="port is taken"):
        core.start()
    assert first.closed


def test_the_core_publishes_in_a_thread_of_its_own_until_it_is_closed() -> None:
    loop = Loop(World("psm"), speed="max")
    core, transport = Core(loop), MemoryTransport(["PSM1/measured_js"])
    core.attach(transport)
    core.start()
    loop.run(0.5)  # in this thread
    core.close()
    assert len(transport.received["PSM1/measured_js"]) + core.skipped == 100  # ticks of 5 ms
    assert transport.closed


@pytest.mark.parametrize("part", ["send", "wanted"])
def test_a_transport_that_breaks_does_not_silence_the_others(
    part: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    served, _ = settle()
    broken = type(served.transport)()
    broken.name = "broken"
    served.core.attach(broken)
    broken.want("PSM1/measured_js")

    def fail(*given) -> None:  # noqa: ARG001
        raise OSError("no such wire")

    monkeypatch.setattr(broken, part, fail)
    before = served.transport.batches
    served.run(0.1)
    assert served.transport.batches > before
    assert "broken: messages lost" in caplog.text


def test_the_rig_as_urdf_comes_to_whoever_asks_for_it_and_anew_after_an_exchange() -> None:
    pytest.importorskip("lxml")
    loop = Loop(World("psm"), speed="realtime", tick_s=0.001)
    core, transport = Core(loop), MemoryTransport(["robot_description"])
    core.attach(transport)
    core.start()
    loop.start()

    def told(count: int) -> list[str]:
        end = time.monotonic() + 30.0
        while len(found := transport.received.get("robot_description", [])) < count:
            assert time.monotonic() < end
            time.sleep(0.01)
        return [message["data"] for message in found]

    try:
        (first,) = told(1)
        assert "<robot name=" in first
        assert core.receive("PSM1/set_tool_type", {"data": "PROGRASP_FORCEPS:400093"})
        first, second = told(2)
        assert first != second
        assert core.latched("robot_description") == {"data": second}
    finally:
        loop.close()
        core.close()


def test_without_its_library_the_urdf_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(rig) -> None:  # noqa: ARG001
        raise MissingExtraError("lxml", "export", "URDF")

    monkeypatch.setattr("trocar.ros.core.robot_model", missing)
    loop = Loop(World("psm"), speed="realtime", tick_s=0.001)
    core, transport = Core(loop), MemoryTransport(["robot_description", "system/warning"])
    core.attach(transport)
    core.start()
    loop.start()
    try:
        end = time.monotonic() + 30.0
        while not (warnings := transport.received.get("system/warning", [])):
            assert time.monotonic() < end
            time.sleep(0.01)
        assert "robot_description" in warnings[0]["data"]
    finally:
        loop.close()
        core.close()


def test_everything_that_the_dvrk_latches_is_latched() -> None:
    """Source: cisst-ros 73aca61, mtsROSBridge.h:828 and :845: every event."""
    rows = topic_table(load_rig("full_cart_mtm"))
    assert [
        t.name for t in rows if t.rate == "event" and t.direction == "pub" and not t.latched
    ] == []
    assert [t.name for t in rows if t.rate != "event" and t.latched] == []


def test_a_late_subscriber_gets_the_last_goal_warning_and_status() -> None:
    served, _ = settle()
    served.loop.post(Command("PSM1", "move_jr", {"dq": [0.01, 0, 0, 0, 0, 0]}))
    served.loop.post(Command("PSM1", "servo_jp", {"q": [1.0]}))
    served.run(0.5)
    assert served.core.latched("PSM1/goal_reached") == {"data": True}
    assert "allowed: 6 numbers" in str(served.core.latched("PSM1/warning"))


def test_states_are_reported_in_words_with_the_arms_name() -> None:
    """Source: recorded answers of the dVRK's software, steps A7 and A27."""
    served, _ = settle()
    assert served.core.latched("PSM1/status") == {"data": "PSM1: current state HOMED"}
    for verb in ("disable", "enable"):
        served.loop.post(Command("PSM1", "state_command", {"name": verb}))
        served.run(0.05)
    told = [m["data"] for m in served.messages("PSM1/status")][1:]
    assert told[:2] == ["PSM1: desired state DISABLED", "PSM1: current state DISABLED"]
    assert told[2] == "PSM1: desired state ENABLED"
    assert told[3].startswith("PSM1: current state ")


@pytest.mark.parametrize(
    ("arm", "text", "expected"),
    [
        ("PSM1", "hot", "PSM1: hot"),
        ("PSM1", "PSM1: hot", "PSM1: hot"),
        ("SUJ_PSM1", "hot", "PSM1 SUJ: hot"),
    ],
)
def test_a_message_begins_with_its_arm_once(arm: str, text: str, expected: str) -> None:
    assert spoken(arm, text) == expected
