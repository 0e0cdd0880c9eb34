"""Joint verbs as the dVRK has them: what ends what, what adds to what."""

from __future__ import annotations

import logging
from operator import attrgetter

import numpy as np
import pytest
from ruckig import InputParameter, Ruckig, Trajectory

from trocar.errors import InputError
from trocar.simulation import World
from trocar.simulation.arm import Arm
from trocar.simulation.jaw import Jaw

GOAL = np.array([0.2, -0.1, 0.15, 0.3, 0.2, -0.1])
STEP = np.array([0.05, -0.02, 0.01, 0.1, 0.05, 0.05])


@pytest.fixture
def world() -> World:
    return World("psm")


@pytest.fixture
def arm(world) -> Arm:
    return world.arm("PSM1")


def jaw_of(arm: Arm) -> Jaw:
    assert arm.jaw is not None
    return arm.jaw


def test_servo_jr_adds_to_the_set_point_not_to_what_is_measured(arm):
    arm.servo_jp(GOAL - 0.5 * STEP)
    assert arm.servo_jr(STEP)
    np.testing.assert_allclose(arm.setpoint_js().position, GOAL + 0.5 * STEP, atol=1e-12)


def test_move_jr_adds_to_the_goal_that_is_under_way(world, arm):
    first = arm.move_jp(GOAL)
    world.step(50)
    second = arm.move_jr(STEP)
    assert first.done
    assert not first.goal_reached
    assert second.wait(5.0)
    np.testing.assert_allclose(arm.setpoint_js().position, GOAL + STEP, atol=1e-12)


def test_move_jr_of_a_resting_arm_adds_to_its_set_point(arm):
    before = arm.setpoint_js().position
    assert arm.move_jr(STEP).wait(5.0)
    np.testing.assert_allclose(arm.setpoint_js().position, before + STEP, atol=1e-12)


@pytest.mark.parametrize(
    "interruption",
    [
        lambda arm: arm.servo_jp(arm.setpoint_js().position),
        lambda arm: arm.servo_jf(np.zeros(6)),
        lambda arm: arm.servo_cp(arm.setpoint_cp().matrix),
        lambda arm: arm.body.servo_cf(np.zeros(6)),
        lambda arm: arm.hold(),
        lambda arm: arm.free(),
        lambda arm: arm.move_jp(GOAL),
        lambda arm: arm.disable(),
    ],
)
def test_whatever_comes_next_ends_a_move_with_its_goal_not_reached(world, arm, interruption):
    motion = arm.move_jp(GOAL)
    world.step(50)
    assert not motion.done
    interruption(arm)
    assert motion.done
    assert not motion.goal_reached


def test_an_effort_command_ends_a_move_of_the_jaw(world, arm):
    """Arm and jaw have one controller, as on the robot."""
    opening = jaw_of(arm).move_jp([0.8])
    world.step(5)
    assert arm.free()
    assert opening.done
    assert not opening.goal_reached


def test_a_new_move_retargets_without_a_stop(world, arm):
    """The set-point's velocity does not jump by more than the acceleration limit allows."""
    limit = np.array([j.acceleration_max for j in arm.description.joints[:6]])
    arm.move_jp(GOAL)
    speeds = []
    for k in range(600):
        if k == 150:
            arm.move_jp(GOAL + np.array([0.3, 0.1, 0.02, 0.5, 0.2, 0.2]))
        world.step()
        speeds.append(arm.setpoint_js().velocity)
    change = np.abs(np.diff(speeds, axis=0)).max(axis=0)
    assert (change <= limit * world.timestep * (1 + 1e-6)).all()
    assert (np.abs(speeds[151]) > 0.01).any()


def test_set_points_of_moves_keep_the_limits_of_velocity_and_acceleration(world, arm):
    joints = arm.description.joints[:6]
    most = np.array([j.velocity_max for j in joints])
    rate = np.array([j.acceleration_max for j in joints])
    q = [arm.setpoint_js().position]
    v = [arm.setpoint_js().velocity]
    motion = arm.move_jp([1.2, 0.7, 0.2, 3.0, 1.0, -1.0])
    while not motion.done:
        world.step()
        q.append(arm.setpoint_js().position)
        v.append(arm.setpoint_js().velocity)
    assert (np.abs(v).max(axis=0) <= most * (1 + 1e-6)).all()
    assert (np.abs(np.diff(v, axis=0)).max(axis=0) <= rate * world.timestep * (1 + 1e-6)).all()
    steps = np.abs(np.diff(q, axis=0)).max(axis=0)
    assert (steps <= most * world.timestep * (1 + 1e-6)).all()


@pytest.mark.parametrize("ratio", [1.0, 0.25])
def test_moves_are_time_optimal(world, arm, ratio):
    """As long as ruckig's own answer to the same question, to a period."""
    arm.joints.set_trajectory_ratio(ratio)
    joints = arm.description.joints[:6]
    question = InputParameter(6)
    question.current_position = arm.setpoint_js().position.tolist()
    question.target_position = GOAL.tolist()
    question.max_velocity = [ratio * j.velocity_max for j in joints]
    question.max_acceleration = [ratio * j.acceleration_max for j in joints]
    answer = Trajectory(6)
    Ruckig(6).calculate(question, answer)
    begin = world.time
    assert arm.move_jp(GOAL).wait(20.0)
    assert world.time - begin == pytest.approx(answer.duration, rel=0.01)


def test_ratios_scale_velocity_and_acceleration_apart(arm):
    arm.joints.set_trajectory_ratio(0.5, "velocity")
    arm.joints.set_trajectory_ratio(0.2, "acceleration")
    assert arm.joints.trajectory_ratio == (0.5, 0.2)
    for wrong in (0.0, 1.1, np.nan, "fast"):
        with pytest.raises(InputError, match="above 0, up to 1"):
            arm.joints.set_trajectory_ratio(wrong)
    with pytest.raises(InputError, match="both, velocity, acceleration"):
        arm.joints.set_trajectory_ratio(0.5, "jerk")
    assert arm.joints.trajectory_ratio == (0.5, 0.2)


def test_servo_jf_persists_until_a_position_command_takes_the_arm_back(world, arm):
    arm.joints.use_gravity_compensation(True)
    before = arm.measured_js().position
    assert arm.servo_jf([0.4, 0, 0, 0, 0, 0])
    world.step(100)
    first = arm.measured_js()
    world.step(100)
    second = arm.measured_js()
    assert before[0] < first.position[0] < second.position[0]
    assert second.effort[0] - arm.runtime.motors.load()[0] == pytest.approx(0.4, abs=1e-9)
    arm.hold()
    world.step(1)
    stopped = arm.setpoint_js().position
    np.testing.assert_allclose(stopped, second.position, atol=1e-3)
    world.step(1000)
    np.testing.assert_allclose(arm.measured_js().position, stopped, atol=2e-3)


def test_efforts_beyond_the_motors_are_clipped(arm):
    assert arm.servo_jf([50.0, 0, 0, 0, 0, 0])
    assert arm.setpoint_js().effort[0] == arm.joints.effort_limit[0]
    assert "clipped" in arm.rejections.last


def test_a_free_arm_falls_without_gravity_compensation_and_floats_with_it(world, arm):
    arm.joints.use_gravity_compensation(False)
    start = arm.measured_js().position
    arm.free()
    world.step(500)
    assert np.abs(arm.measured_js().position - start).max() > 0.1
    world.reset()
    arm.joints.use_gravity_compensation(True)
    arm.free()
    world.step(500)
    assert np.abs(arm.measured_js().position - start).max() < 0.01


def test_a_world_may_begin_with_strict_limits_also_after_a_reset():
    strict = World("psm", strict_limits=True)
    one = strict.arm("PSM1")
    for _ in range(2):
        assert not one.servo_jp([9.0, 0, 0.12, 0, 0, 0])
        strict.reset()


def test_strict_limits_reject_what_else_is_clipped(world, arm):
    beyond = GOAL + np.array([5.0, 0, 0, 0, 0, 0])
    assert arm.servo_jp(np.clip(beyond, arm.joints.lower[:6], arm.joints.upper[:6])) in (True,)
    world.reset()
    before = arm.setpoint_js().position
    arm.joints.use_strict_limits(True)
    assert not arm.servo_jp(beyond)
    assert not arm.move_jp(beyond).wait(0.1)
    np.testing.assert_array_equal(arm.setpoint_js().position, before)
    assert "yaw beyond the limit" in arm.rejections.last
    arm.joints.use_strict_limits(False)
    motion = arm.move_jp(beyond)
    assert motion.goal[0] == arm.joints.upper[0]


def test_a_move_ends_when_its_set_point_arrives_though_the_jaw_is_blocked(arm):
    """As on a needle: the fingers meet at 0 and the set-point goes on to -20 degrees."""
    motion = jaw_of(arm).close()
    assert motion.wait(2.0)
    assert jaw_of(arm).setpoint_js().position[0] == pytest.approx(np.deg2rad(-20.0))
    assert abs(jaw_of(arm).measured_js().position[0]) < 0.02


def test_jaw_verbs_add_as_the_arm_s_do():
    world = World("psm", dynamics="cad")
    jaw = jaw_of(world.arm("PSM1"))
    assert jaw.servo_jp([0.2])
    assert jaw.servo_jr([0.1])
    assert jaw.setpoint_js().position[0] == pytest.approx(0.3)
    jaw.move_jp([0.6])
    world.step(3)
    assert jaw.move_jr([0.1]).wait(2.0)
    assert jaw.setpoint_js().position[0] == pytest.approx(0.7)
    assert jaw.servo_jf([-0.1])
    world.step(10)
    assert jaw.measured_js().effort[0] == pytest.approx(-0.1, abs=1e-4)  # and its weight
    assert jaw.move_jp([0.5]).wait(2.0)


def test_every_rejected_move_gives_its_reason(arm, caplog):
    with caplog.at_level(logging.WARNING):
        moves = [arm.move_jp([9.0]), arm.move_jp([9.0]), jaw_of(arm).move_jp([1.0, 2.0])]
    assert len(caplog.messages) == 3
    assert ["allowed: 6 numbers" in move.reason for move in moves] == [True, True, False]
    assert repr(moves[1]) == f"<Motion rejected: {moves[1].reason}>"
    assert arm.move_jp(GOAL).reason == ""


def test_a_stream_is_warned_of_once_in_two_seconds_with_how_many_were_not_reported(
    world, arm, caplog
):
    with caplog.at_level(logging.WARNING):
        for _ in range(5):
            arm.servo_jp([np.nan] * 6)
        world.step(2001)
        arm.servo_jp([np.nan] * 6)
    messages = [r.getMessage() for r in caplog.records]
    assert len(messages) == 2
    assert "4 more such" in messages[1]
    assert arm.rejections.count == 6


@pytest.mark.parametrize(
    "verb", ["servo_jp", "servo_jr", "servo_jf", "move_jp", "move_jr", "forces.servo_cf"]
)
def test_what_is_no_vector_of_numbers_changes_nothing(arm, verb):
    before, state = arm.setpoint_js().position, arm.operating_state()
    unusable = [[1.0], [np.nan] * 6, [np.inf] * 6, "abc", None, [["a"] * 6]]
    for count, bad in enumerate(unusable, 1):
        answer = attrgetter(verb)(arm)(bad)
        assert not (answer.goal_reached if verb.startswith("move") else answer), bad
        np.testing.assert_array_equal(arm.setpoint_js().position, before)
        assert arm.operating_state() == state
        assert arm.rejections.count == count
        assert set(arm.runtime.snapshot(None).modes) == {"position"}


def test_set_points_and_measured_agree_at_rest():
    """Within 2 mrad and 0.1 mm for every arm of the cart, with the dVRK's gains."""
    cart = World("full_cart")
    cart.step(3000)
    for a in cart.arms.values():
        error = np.abs(a.measured_js().position - a.setpoint_js().position)
        kinds = [j.kind for j in a.description.joints][: len(error)]
        allowed = [1e-4 if kind == "prismatic" else 2e-3 for kind in kinds]
        assert (error <= allowed).all(), (a.name, error)
