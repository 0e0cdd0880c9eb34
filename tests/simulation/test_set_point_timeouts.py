"""Effort and velocity set-points with a time-out end in a hold, in simulated time."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from trocar.simulation import World
from trocar.simulation.arm import Arm

PUSH = [0.6, 0.0, 0.0, 0.0, 0.0, 0.0]
TIMED = {
    "servo_jf": lambda arm, timeout: arm.servo_jf(PUSH, timeout),
    "servo_cf": lambda arm, timeout: arm.body.servo_cf([2.0, 0.0, 0.0, 0.0, 0.0, 0.0], timeout),
    "servo_jv": lambda arm, timeout: arm.servo_jv([0.3, 0.0, 0.0, 0.0, 0.0, 0.0], timeout),
}


@pytest.fixture
def world() -> World:
    return World("psm")


@pytest.fixture
def arm(world) -> Arm:
    return world.arm("PSM1")


@pytest.mark.parametrize("verb", TIMED)
def test_an_arm_holds_where_it_is_when_its_set_point_times_out(world, arm, verb, caplog):
    assert TIMED[verb](arm, 0.1)
    with caplog.at_level("WARNING", "trocar"):
        world.step(100)
        assert not caplog.messages
        there = arm.joints.positions()
        world.step()
    assert caplog.messages == [f"PSM1: {verb}: no set-point for 0.1 s; the arm holds where it is"]
    assert arm.joints.mode("yaw") == "position"
    world.step(1000)
    np.testing.assert_allclose(arm.joints.positions()[:6], there[:6], atol=0.01)
    assert np.abs(arm.measured_js().velocity).max() < 1e-3


def test_without_a_time_out_an_effort_drives_the_arm_into_its_stop(world, arm):
    arm.servo_jf(PUSH)
    world.step(8000)
    assert arm.joints.positions()[0] > arm.joints.upper[0] - 0.01


def test_a_set_point_that_is_renewed_does_not_time_out(world, arm):
    for _ in range(20):
        assert arm.servo_jf(PUSH, 0.1)
        world.step(90)
    assert arm.joints.mode("yaw") == "effort"
    assert arm.rejections.count == 0


@pytest.mark.parametrize(
    "newer",
    [
        lambda arm: arm.servo_jf(np.zeros(6)),
        lambda arm: arm.body.servo_cf(np.zeros(6)),
        lambda arm: arm.free(),
        lambda arm: arm.move_jp(arm.joints.positions()[:6] + 0.1),
        lambda arm: arm.joints.set_mode("effort"),
        lambda arm: arm.disable(),
        lambda arm: arm.state_command("pause"),
    ],
    ids=["servo_jf", "servo_cf", "free", "move_jp", "set_mode", "disable", "pause"],
)
def test_whatever_comes_next_takes_the_time_out_away(world, arm, newer):
    arm.servo_jf(PUSH, 0.1)
    world.step(50)
    newer(arm)
    modes = arm.runtime.motors.labels()[0]
    world.step(100)
    assert arm.runtime.motors.labels()[0] == modes
    assert "no set-point" not in arm.rejections.last


def test_a_rejected_command_leaves_the_time_out(world, arm):
    arm.servo_jf(PUSH, 0.1)
    world.step(50)
    assert not arm.servo_jp([np.nan] * 6)
    assert not arm.servo_jf([0.0])
    world.step(60)
    assert "no set-point" in arm.rejections.last


def test_the_jaw_keeps_its_grip_when_the_arm_s_effort_times_out(world, arm):
    arm.jaw.servo_jf([-0.1])
    opening = arm.jaw.setpoint_js()
    arm.servo_jf(PUSH, 0.1)
    world.step(300)
    assert arm.joints.mode("yaw") == "position"
    assert arm.joints.mode("jaw") == "effort"
    assert arm.jaw.setpoint_js().effort == opening.effort


def test_a_joint_in_mode_effort_exerts_nothing_after_the_time_out(world, arm):
    arm.joints.set_mode("effort", ["yaw"])
    arm.servo_jf(PUSH, 0.1)
    world.step(150)
    assert arm.joints.mode("yaw") == "effort"
    assert arm.setpoint_js().effort[0] == 0.0


def test_a_loaded_state_times_out_at_the_same_step(world, arm):
    arm.servo_jf(PUSH, 0.1)
    world.step(40)
    state = pickle.loads(pickle.dumps(world.save()))
    world.step(200)
    expected = arm.joints.positions()
    other = World("psm")
    other.load(state)
    other.step(200)
    np.testing.assert_array_equal(other.arm("PSM1").joints.positions(), expected)
    assert other.arm("PSM1").joints.mode("yaw") == "position"


def test_a_reset_takes_the_time_out_away(world, arm):
    arm.servo_jf(PUSH, 0.1)
    world.step(50)
    world.reset()
    world.step(200)
    assert arm.rejections.count == 0


@pytest.mark.parametrize("timeout", [0.0, -1.0, np.nan, np.inf, "0.1", True])
def test_a_time_out_that_is_no_time_is_rejected(arm, timeout):
    assert not arm.servo_jf(PUSH, timeout)
    assert "allowed: above 0, or None" in arm.rejections.last
    assert arm.joints.mode("yaw") == "position"
