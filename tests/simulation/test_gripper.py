"""A master's gripper: a spring and a sensor, no motor; fingers shut it."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.live.inbox import Command
from trocar.simulation import World
from trocar.simulation.jaw import DEBOUNCE_S

OPEN = np.deg2rad(60.0)
#: A lever of 8 g with its middle 28 mm from its hinge weighs 2.2 mN m; both do, by half an angle.
WEIGHT_NM = 2.2e-3


@pytest.fixture
def world():
    return World("mtm")


@pytest.fixture
def arm(world):
    return world.arm("MTML")


def opening(arm) -> float:
    return float(arm.gripper.measured_js().position[0])


def test_the_gripper_is_no_motor_joint(arm):
    assert len(arm.measured_js().name) == len(arm.setpoint_js().name) == 7
    assert "gripper" not in arm.measured_js().name
    assert arm.gripper.measured_js().name == ("gripper",)
    assert arm.joints.names[-1] == "gripper"
    assert World("psm").arm("PSM1").gripper is None


def test_let_go_it_is_wide_open(world, arm):
    arm.gripper.squeeze_to(0.2)
    world.step(300)
    arm.gripper.release()
    world.step(300)
    assert opening(arm) == pytest.approx(OPEN, abs=1e-4)


@pytest.mark.parametrize("effort", [0.07, 0.10, 0.13])
def test_squeezed_it_closes_as_far_as_its_spring_lets_it(world, arm, effort):
    spring = load_arm("mtml").joint("gripper").spring
    assert spring is not None
    arm.gripper.squeeze(effort)
    world.step(1500)
    expected = spring.rest - effort / spring.stiffness
    assert opening(arm) == pytest.approx(expected, abs=WEIGHT_NM / spring.stiffness)


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.9])
def test_fingers_hold_it_at_an_angle(world, arm, angle):
    arm.gripper.squeeze_to(angle)
    world.step(1000)
    assert opening(arm) == pytest.approx(angle, abs=2e-3)


def test_both_levers_open_alike(world, arm):
    arm.gripper.squeeze_to(0.5)
    world.step(500)
    at = arm.description.mechanism.frame_index
    seen = {frame: world.arm("MTML").joints.frame_coordinates()[k] for frame, k in at.items()}
    assert seen["gripper_left"] == pytest.approx(0.25, abs=1e-3)
    assert seen["gripper_right"] == pytest.approx(-seen["gripper_left"], abs=1e-6)


def test_a_pinch_is_told_once_and_only_when_it_lasts(world, arm):
    entries = []
    world.listen(lambda e: entries.append((e.name, dict(e.values))) if e.kind == "event" else None)
    arm.gripper.squeeze_to(0.0)
    world.step(100)
    arm.gripper.release()
    world.step(500)
    assert arm.gripper.pinches == 0 and not arm.gripper.closed
    arm.gripper.squeeze_to(0.0)
    world.step(round(DEBOUNCE_S / world.timestep) + 200)
    world.step(1000)
    assert arm.gripper.pinches == 1 and arm.gripper.closed
    arm.gripper.release()
    world.step(600)
    assert not arm.gripper.closed
    assert [name for name, _ in entries if name.startswith("gripper")] == [
        "gripper/closed",
        "gripper/pinch",
        "gripper/closed",
    ]
    world.reset()
    assert arm.gripper.pinches == 0


def test_fingers_move_no_other_joint(world, arm):
    arm.joints.set_mode("effort")
    before = arm.measured_js().position
    arm.gripper.squeeze(0.2)
    world.step(1000)
    np.testing.assert_allclose(arm.measured_js().position, before, atol=1e-3)


def test_commands_of_the_arm_leave_the_fingers_alone(world, arm):
    arm.gripper.squeeze_to(0.4)
    world.step(300)
    arm.move_to("home").wait(10.0)
    arm.joints.set_mode("effort")
    arm.servo_jf(np.zeros(7))
    arm.joints.use_gravity_compensation(False)
    arm.joints.use_gravity_compensation(True)
    arm.joints.set_mode("position")
    world.step(300)
    assert opening(arm) == pytest.approx(0.4, abs=5e-3)


def test_a_reset_takes_the_fingers_away(world, arm):
    arm.gripper.squeeze_to(0.0)
    world.step(500)
    world.reset()
    world.step(300)
    assert opening(arm) == pytest.approx(OPEN, abs=1e-4)


def test_the_commands_are_told_and_can_be_repeated(world, arm):
    entries = []
    world.listen(lambda e: entries.append((e.source, e.name)) if e.kind == "command" else None)
    arm.gripper.squeeze_to(0.1)
    arm.gripper.squeeze(0.1)
    arm.gripper.release()
    assert entries == [
        ("MTML", "gripper.squeeze_to"),
        ("MTML", "gripper.squeeze"),
        ("MTML", "gripper.release"),
    ]


@pytest.mark.parametrize("angle", [-0.1, 1.2, float("nan"), "shut", None, True])
def test_an_angle_that_is_none_is_rejected(arm, angle):
    with pytest.raises(InputError, match=r"MTML: gripper: got angle .*; allowed: 0 to 1\.0472"):
        arm.gripper.squeeze_to(angle)


@pytest.mark.parametrize("effort", [-0.1, 5.0, float("inf")])
def test_an_effort_beyond_fingers_is_rejected(arm, effort):
    with pytest.raises(InputError, match=r"MTML: gripper: got effort .*; allowed: 0 to 0\.8"):
        arm.gripper.squeeze(effort)


@pytest.mark.parametrize("mode", ["position", "effort", "set"])
def test_it_has_no_mode_to_choose(arm, mode):
    with pytest.raises(InputError, match="gripper has no motor; squeeze it"):
        arm.joints.set_mode(mode, ["gripper"])


def test_the_page_s_command_squeezes_and_lets_go(world, arm):
    Command("MTML", "gripper.squeeze_to", {"angle": 0.2}).apply(world)
    world.step(500)
    assert opening(arm) == pytest.approx(0.2, abs=2e-3)
    assert arm.runtime.snapshot(None).setpoint[-1] == pytest.approx(0.2)
    Command("MTML", "gripper.release").apply(world)
    world.step(500)
    assert opening(arm) == pytest.approx(OPEN, abs=1e-4)
    assert arm.runtime.snapshot(None).setpoint[-1] == opening(arm)
    with pytest.raises(InputError, match="does not have"):
        Command("PSM1", "gripper.squeeze_to", {"angle": 0.2}).apply(World("psm"))
