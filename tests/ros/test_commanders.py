"""Several clients of one arm, and a client that vanishes."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from tests.ros.asking import HOME, NEAR, joints, pose, state, wrench, xyz
from tests.ros.served import Served
from trocar.errors import InputError
from trocar.live.commanders import IDLE_S
from trocar.ros.core import SETPOINT_TIMEOUT_S

PUSH = joints(effort=[0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
NOTHING = joints(effort=[0.0] * 6)
SLIDE = joints(velocity=[0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
FORCE = wrench(xyz(2.0, 0.0, 0.0))


def warnings(served: Served, arm: str = "PSM1") -> list[str]:
    served.run(0.02)
    return [message["data"] for message in served.messages(f"{arm}/warning")]


# ---------------------------------------------------------------------- several clients


def test_a_second_commander_of_an_arm_is_named_in_the_log_and_on_its_warning_topic(caplog):
    served = Served(wanted=())
    served.core.receive("PSM1/servo_jp", joints(*HOME), "/alice")
    with caplog.at_level(logging.WARNING, "trocar"):
        assert served.core.receive("PSM1/servo_jp", joints(*NEAR), "/bob")
        for _ in range(50):
            served.core.receive("PSM1/servo_jp", joints(*NEAR), "/alice")
            served.core.receive("PSM1/servo_jp", joints(*NEAR), "/bob")
    expected = "/bob commands PSM1 beside /alice: the newest command counts"
    assert caplog.messages == [expected]
    assert warnings(served) == [f"PSM1: {expected}"]
    assert served.loop.commanders.of("PSM1") == ["/alice", "/bob"]


def test_clients_of_different_arms_do_not_disturb_each_other(caplog):
    served = Served("two_psm_ecm", wanted=())
    with caplog.at_level(logging.WARNING, "trocar"):
        served.core.receive("PSM1/servo_jp", joints(*HOME), "/alice")
        served.core.receive("PSM2/servo_jp", joints(*HOME), "/bob")
        served.core.receive("PSM1/jaw/servo_jp", joints(0.1), "/alice")
    assert not caplog.messages


@pytest.mark.parametrize("gone", ["disconnected", "silent"])
def test_an_arm_is_free_once_its_client_has_gone(gone, caplog):
    served = Served(wanted=(), exclusive=True)
    served.core.receive("PSM1/move_jp", joints(*NEAR), "/alice")
    if gone == "disconnected":
        served.core.disconnected("/alice")
    else:
        served.clock.time += IDLE_S
    with caplog.at_level(logging.WARNING, "trocar"):
        assert served.core.receive("PSM1/servo_jp", joints(*HOME), "/bob")
    assert not caplog.messages
    assert served.loop.commanders.of("PSM1") == ["/bob"]


def test_an_exclusive_arm_rejects_a_second_commander_all_but_disable_and_pause(caplog):
    served = Served(wanted=(), exclusive=True)
    served.core.receive("PSM1/servo_jp", joints(*HOME), "/alice")
    served.run()
    with caplog.at_level(logging.WARNING, "trocar"):
        assert not served.core.receive("PSM1/servo_jp", joints(*NEAR), "/bob")
        assert not served.core.receive("system/home", {}, "/bob")
    assert "PSM1 is commanded by /alice; allowed (--exclusive): disable and pause" in caplog.text
    assert "PSM1 is commanded by /alice" in warnings(served)[0]
    np.testing.assert_allclose(served.world.arm("PSM1").setpoint_js().position, HOME)
    assert served.core.receive("PSM1/servo_jp", joints(*NEAR), "/alice")
    assert served.core.receive("PSM1/state_command", state("disable"), "/bob")
    served.run()
    assert served.world.arm("PSM1").operating_state().state == "DISABLED"


def test_a_rejected_message_makes_nobody_a_commander():
    served = Served(wanted=())
    served.core.receive("PSM1/servo_jp", joints(1.0), "/alice")
    served.core.receive("PSM1/state_command", state("disable"), "/alice")
    assert served.loop.commanders.of("PSM1") == []


# ---------------------------------------------------------------------- a client that vanishes


@pytest.mark.parametrize(
    ("topic", "message"),
    [("servo_jf", PUSH), ("body/servo_cf", FORCE), ("servo_jv", SLIDE)],
)
def test_an_arm_holds_when_the_client_that_pushes_it_vanishes(topic, message, caplog):
    served = Served(wanted=())
    arm = served.world.arm("PSM1")
    served.core.receive(f"PSM1/{topic}", message, "/gone")
    served.run(SETPOINT_TIMEOUT_S + 0.01)
    there = arm.joints.positions()
    with caplog.at_level(logging.WARNING, "trocar"):
        served.run(2.0)
    assert arm.joints.mode("yaw") == "position"
    np.testing.assert_allclose(arm.joints.positions(), there, atol=0.01)
    assert "no set-point for 0.1 s; the arm holds where it is" in warnings(served)[0]


def test_a_client_that_publishes_efforts_at_rate_keeps_them():
    served = Served(wanted=())
    for _ in range(30):
        served.core.receive("PSM1/servo_jf", PUSH, "/alice")
        served.run(0.05)
    assert served.world.arm("PSM1").joints.mode("yaw") == "effort"
    assert warnings(served) == []


@pytest.mark.parametrize(
    ("topic", "message"),
    [("servo_jf", NOTHING), ("body/servo_cf", wrench(xyz(0.0, 0.0, 0.0))), ("free", {})],
)
def test_an_arm_without_efforts_stays_free(topic, message):
    served = Served(wanted=())
    served.core.receive(f"PSM1/{topic}", message, "/alice")
    served.run(1.0)
    assert served.world.arm("PSM1").joints.mode("yaw") == "effort"


@pytest.mark.parametrize("how", ["by a script", "as on the dVRK"])
def test_efforts_persist_without_a_time_out(how):
    served = Served(wanted=(), setpoint_timeout_s=0.0 if how == "as on the dVRK" else 0.1)
    served.core.receive("PSM1/servo_jf", PUSH, "" if how == "by a script" else "/alice")
    served.run(1.0)
    assert served.world.arm("PSM1").joints.mode("yaw") == "effort"


def test_an_arm_that_pauses_time_keeps_its_effort_until_time_goes_on():
    served = Served(wanted=())
    served.core.receive("PSM1/servo_jf", PUSH, "/alice")
    served.run(0.05)
    served.core.receive("scene/pause", {})
    served.run(1.0)
    assert served.world.arm("PSM1").joints.mode("yaw") == "effort"
    served.core.receive("scene/resume", {})
    served.run(0.1)
    assert served.world.arm("PSM1").joints.mode("yaw") == "position"


@pytest.mark.parametrize("timeout", [-1.0, float("inf"), float("nan")])
def test_a_time_out_that_is_no_time_is_an_error(timeout):
    with pytest.raises(InputError, match="allowed: 0 or more"):
        Served(wanted=(), setpoint_timeout_s=timeout)


def test_a_pose_is_followed_without_a_time_out():
    served = Served(wanted=())
    served.core.receive("PSM1/servo_cp", pose(xyz(0.0, 0.0, -0.1)), "/alice")
    served.core.receive("PSM1/servo_jp", joints(*NEAR), "/alice")
    served.run(1.0)
    np.testing.assert_allclose(served.world.arm("PSM1").setpoint_js().position, NEAR)
    assert not [text for text in warnings(served) if "no set-point" in text]
