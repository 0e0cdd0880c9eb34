"""Moves: within limits, to the goal, one after another, several at a time."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm, names
from trocar.errors import InputError
from trocar.simulation import World
from trocar.simulation.moves import RATIO_MIN, Profile

GOAL = np.array([0.6, -0.4, 0.19, 1.0, 0.4, -0.3])


def followed(world: World, periods: int) -> np.ndarray:
    """The arm's set-points at the start and after each period, (periods + 1, n)."""
    arm = world.arm("PSM1")
    found = [arm.setpoint_js().position]
    for _ in range(periods):
        world.step()
        found.append(arm.setpoint_js().position)
    return np.array(found)


def test_set_points_keep_velocity_and_acceleration_limits_and_arrive():
    world = World("psm", dynamics="cad")
    arm = world.arm("PSM1")
    joints = arm.description.joints[:6]
    world.set_state("PSM1", np.array([-1.5, 0.0, 0.12, 0.0, 0.0, 0.0, 0.0]))
    motion = arm.move_jp(GOAL)
    assert arm.operating_state().is_busy
    path = followed(world, 3000)
    assert motion.done
    assert motion.goal_reached
    assert not arm.operating_state().is_busy
    np.testing.assert_array_equal(path[-1], GOAL)
    speed = np.diff(path, axis=0) / world.timestep
    rate = np.diff(speed, axis=0) / world.timestep
    assert (np.abs(speed).max(axis=0) <= [j.velocity_max * (1 + 1e-9) for j in joints]).all()
    # The yaw has far to go: it cruises at its limit.
    assert np.abs(speed)[:, 0].max() == pytest.approx(joints[0].velocity_max, rel=1e-6)
    # Differences of 1e-16 m over 1e-6 s^2 leave 1e-9.
    assert (np.abs(rate).max(axis=0) <= [j.acceleration_max + 1e-6 for j in joints]).all()
    np.testing.assert_allclose(arm.measured_js().position, GOAL, atol=3e-3)


def test_a_move_is_as_fast_as_its_slowest_joint_may_be():
    """Insertion by 0.1 m with 0.2 m/s and 0.2 m/s^2: 2 sqrt(d / a), as it never cruises."""
    world = World("psm")
    motion = world.arm("PSM1").move_jp([0, 0, 0.22, 0, 0, 0])
    assert motion.wait()
    assert world.time == pytest.approx(2 * np.sqrt(0.1 / 0.2), abs=2e-3)


@pytest.mark.parametrize("name", names("arms"))
def test_every_arm_crosses_its_whole_range_at_the_least_ratio(name):
    joints = [j for j in load_arm(name).joints if np.isfinite(j.velocity_max)]  # motors alone
    lower, upper = (np.array([getattr(j, k) for j in joints]) for k in ("lower", "upper"))
    speed = RATIO_MIN * np.array([j.velocity_max for j in joints])
    rate = RATIO_MIN * np.array([j.acceleration_max for j in joints])
    path = Profile((lower, np.zeros(len(joints))), upper, (speed, rate), 0.0)
    np.testing.assert_allclose(path.at(path.duration)[0], upper)


@pytest.mark.parametrize("scale", [1e-6, 1e-13, 5e-324])
def test_a_move_that_takes_too_long_to_plan_is_rejected(scale):
    zero, one = np.zeros(2), np.ones(2)
    with pytest.raises(InputError, match="no trajectory from"):
        Profile((zero, zero), np.array([1.0, 0.5]), (scale * one, scale * one), 0.0)


def test_set_point_velocities_are_the_paths():
    world = World("psm")
    arm = world.arm("PSM1")
    arm.move_jp(GOAL)
    before = arm.setpoint_js()
    for _ in range(300):
        world.step()
        now = arm.setpoint_js()
        slope = (now.position - before.position) / world.timestep
        np.testing.assert_allclose(0.5 * (now.velocity + before.velocity), slope, atol=5e-3)
        before = now


@pytest.mark.parametrize("end", ["servo", "hold", "mode"])
def test_a_superseded_move_is_over_without_its_goal_and_leaves_no_velocity(end):
    world = World("psm")
    arm = world.arm("PSM1")
    motion = arm.move_jp(GOAL)
    world.step(400)
    assert np.abs(arm.setpoint_js().velocity).max() > 0.05
    if end == "servo":
        arm.servo_jp(arm.setpoint_js().position)
    elif end == "hold":
        arm.hold()
    else:
        arm.joints.set_mode("position")
    assert motion.done
    assert not motion.goal_reached
    assert not motion.wait(1.0)
    assert not arm.setpoint_js().velocity.any()
    here = arm.setpoint_js().position
    world.step(800)
    np.testing.assert_array_equal(arm.setpoint_js().position, here)
    np.testing.assert_allclose(arm.measured_js().position, here, atol=5e-3)


def test_a_new_goal_is_taken_without_a_stop():
    world = World("psm")
    arm = world.arm("PSM1")
    first = arm.move_jp(GOAL)
    world.step(400)
    velocity = arm.setpoint_js().velocity
    farther = GOAL + np.array([0.3, 0, 0, 0, 0, 0])
    second = arm.move_jp(farther)
    assert first.done
    assert not first.goal_reached
    np.testing.assert_array_equal(arm.setpoint_js().velocity, velocity)
    path = followed(world, 3)
    acceleration = np.array([j.acceleration_max for j in arm.description.joints[:6]])
    change = np.abs(np.diff(path, axis=0) / world.timestep - velocity)
    assert (change <= 3e-3 * acceleration + 1e-9).all()
    assert second.wait(5.0)
    np.testing.assert_array_equal(arm.setpoint_js().position, farther)


def test_waiting_gives_up_after_a_while_and_the_move_goes_on():
    world = World("psm")
    motion = world.arm("PSM1").move_jp(GOAL)
    assert not motion.wait(0.1)
    assert world.time == pytest.approx(0.1, abs=2e-3)
    assert not motion.done
    assert motion.wait(10.0)
    assert motion.goal_reached


def test_a_move_that_is_there_already_is_over_after_a_period():
    world = World("psm")
    motion = world.arm("PSM1").move_jp(world.arm("PSM1").setpoint_js().position)
    assert motion.wait(0.01)
    assert world.time <= 2e-3


def test_arms_move_at_the_same_time():
    world = World("two_psm_ecm")
    start = {n: world.arm(n).measured_js().position for n in ("PSM1", "PSM2")}
    one = world.arm("PSM1").move_jp(start["PSM1"] + [0.2, 0, 0, 0, 0, 0])
    other = world.arm("PSM2").move_jp(start["PSM2"] + [-0.1, 0, 0, 0, 0, 0])
    assert one.wait(5.0)
    assert other.wait(5.0)
    both = world.time
    world.reset()
    assert world.arm("PSM1").move_jp(start["PSM1"] + [0.2, 0, 0, 0, 0, 0]).wait(5.0)
    assert both == pytest.approx(world.time, abs=2e-3)


def test_the_jaw_moves_beside_the_arm_and_neither_ends_the_other():
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    reach = arm.move_jp(GOAL)
    world.step(50)
    opening = arm.jaw.open()
    assert not reach.done
    world.step(50)
    assert not opening.done
    assert arm.jaw.setpoint_js().velocity[0] > 0.0
    assert opening.wait(5.0)
    assert reach.wait(5.0)


def test_a_named_pose_moves_arm_and_jaw():
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    motion = arm.move_to("work")
    assert motion.wait(10.0)
    pose = world.rig.poses["work"]["PSM1"]
    np.testing.assert_array_equal(motion.goal, pose)
    np.testing.assert_array_equal(arm.setpoint_js().position, pose[:6])
    np.testing.assert_array_equal(arm.jaw.setpoint_js().position, pose[6:])


def test_a_jaw_that_is_taken_over_lets_the_arm_go_on_to_its_pose():
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    motion = arm.move_to("work")
    world.step(30)
    assert arm.jaw.servo_jp([0.2])
    assert not motion.done
    assert not motion.wait(10.0)  # over, but not all of it arrived
    assert motion.done
    np.testing.assert_array_equal(arm.setpoint_js().position, world.rig.poses["work"]["PSM1"][:6])
    np.testing.assert_array_equal(arm.jaw.setpoint_js().position, [0.2])


def test_an_arm_that_is_taken_over_leaves_its_jaw_at_rest_or_going():
    """A servo command for the arm must not freeze the jaw with a velocity."""
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    arm.move_to("work")
    world.step(30)
    assert arm.servo_jp(arm.setpoint_js().position)
    world.step(2000)
    np.testing.assert_array_equal(
        arm.jaw.setpoint_js().position, world.rig.poses["work"]["PSM1"][6:]
    )
    assert not arm.jaw.setpoint_js().velocity.any()


def test_a_move_in_set_mode_is_followed_exactly():
    world = World("psm")
    arm = world.arm("PSM1")
    arm.joints.set_mode("set")
    assert arm.move_jp(GOAL).wait(5.0)
    np.testing.assert_allclose(arm.measured_js().position, GOAL, atol=1e-6)


def test_set_points_go_on_at_a_velocity_until_a_limit_or_the_next_command():
    world = World("psm")
    arm = world.arm("PSM1")
    before = arm.setpoint_js().position
    assert arm.servo_jv([0.2, -0.1, 0.01, 0.0, 0.0, 0.0])
    assert not arm.operating_state().is_busy
    world.step(500)
    setpoint = arm.setpoint_js()
    np.testing.assert_allclose(setpoint.position - before, [0.1, -0.05, 0.005, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(setpoint.velocity[:3], [0.2, -0.1, 0.01])
    np.testing.assert_allclose(arm.measured_js().velocity[:2], [0.2, -0.1], atol=5e-3)
    world.step(12_000)
    limits = [arm.joints.upper[0], arm.joints.lower[1], arm.joints.upper[2]]
    np.testing.assert_allclose(arm.setpoint_js().position[:3], limits, atol=1e-9)
    assert arm.setpoint_js().velocity[0] == 0.0
    assert arm.servo_jv(np.zeros(6))
    here = arm.setpoint_js().position
    world.step(100)
    np.testing.assert_array_equal(arm.setpoint_js().position, here)
    arm.servo_jv([-0.1, 0, 0, 0, 0, 0])
    arm.move_jp(GOAL).wait(10.0)
    np.testing.assert_array_equal(arm.setpoint_js().position, GOAL)


def test_a_velocity_beyond_the_limit_is_clipped_with_a_warning():
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.servo_jv([9.0, 0, 0, 0, 0, 0])
    assert "clipped" in arm.rejections.last
    world.step(100)
    most = arm.description.joints[0].velocity_max
    assert arm.setpoint_js().position[0] == pytest.approx(0.1 * most)


def test_set_point_velocities_beyond_the_limit_are_clipped_with_a_warning(caplog):
    world = World("psm")
    arm = world.arm("PSM1")
    most = np.array([joint.velocity_max for joint in arm.description.joints])
    here = arm.setpoint_js().position
    with caplog.at_level("WARNING", "trocar"):
        assert arm.servo_jp(here, [1e6, -1e6, 0.1, 0.0, 0.0, 0.0])
    assert caplog.messages == ["PSM1: servo_jp: yaw, pitch: velocity clipped to the limit"]
    np.testing.assert_array_equal(
        arm.setpoint_js().velocity, [most[0], -most[1], 0.1, 0.0, 0.0, 0.0]
    )
    assert arm.jaw is not None and arm.jaw.servo_jp([0.3], [1e6])
    assert arm.jaw.setpoint_js().velocity == most[-1]
    assert "velocity clipped" in arm.rejections.last


def test_velocities_at_the_limit_are_taken_as_they_are():
    arm = World("psm").arm("PSM1")
    most = [joint.velocity_max for joint in arm.description.joints[:6]]
    assert arm.servo_jp(arm.setpoint_js().position, most)
    np.testing.assert_array_equal(arm.setpoint_js().velocity, most)
    assert arm.rejections.count == 0
