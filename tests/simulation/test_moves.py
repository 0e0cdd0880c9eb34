"""Moves: within limits, to the goal, one after another, several at a time."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm, names
from trocar.errors import InputError
from trocar.simulation import World
from trocar.simulation.jaw import Jaw
from trocar.simulation.moves import Profile

GOAL = np.array([0.6, -0.4, 0.19, 1.0, 0.4, -0.3])


def jaw_of(world: World) -> Jaw:
    jaw = world.arm("PSM1").jaw
    assert jaw is not None
    return jaw


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
def test_every_arm_crosses_its_whole_range_at_a_ratio_of_two_thousandths(name):
    joints = [j for j in load_arm(name).joints if np.isfinite(j.velocity_max)]  # motors alone
    lower, upper = (np.array([getattr(j, k) for j in joints]) for k in ("lower", "upper"))
    speed = 0.002 * np.array([j.velocity_max for j in joints])
    rate = 0.002 * np.array([j.acceleration_max for j in joints])
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


def goals(world: World) -> list[bool]:
    """Whether moves reached their goals, as events report it from now on."""
    found: list[bool] = []
    world.listen(lambda e: found.append(e.values["reached"]) if e.name == "goal_reached" else None)
    return found


def test_a_jaw_that_moves_during_a_move_arrives_with_the_arm_in_one_trajectory():
    """As the robot, E10 of its recorded answers: one goal_reached."""
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    reported = goals(world)
    reach = arm.move_jp(GOAL)
    world.step(50)
    opening = arm.jaw.open()
    assert not reach.done
    world.step(50)
    assert not opening.done
    assert arm.jaw.setpoint_js().velocity[0] > 0.0
    assert opening.wait(5.0)
    assert reach.done and reach.goal_reached
    assert reported == [True]
    np.testing.assert_array_equal(arm.setpoint_js().position, GOAL)
    np.testing.assert_allclose(arm.jaw.setpoint_js().position, arm.jaw.OPEN)


@pytest.mark.parametrize("mover", ["arm", "jaw"])
def test_a_servo_command_to_arm_or_jaw_ends_the_move_of_both(mover):
    """E11, E12: a move of 0.4 rad that the jaw ends after 0.3 s stops at 0.064 rad."""
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    reported = goals(world)
    if mover == "arm":
        motion = arm.move_jp([0.4, 0, 0.12, 0, 0, 0])
        world.step(round(0.285 / world.timestep))
        assert jaw_of(world).servo_jp([0.3])
        assert 0.05 < arm.setpoint_js().position[0] < 0.08
        assert arm.jaw.setpoint_js().position == 0.3
    else:
        motion = arm.jaw.move_jp([1.2])
        world.step(round(0.05 / world.timestep))
        assert arm.servo_jp(arm.setpoint_js().position)
        assert 0.0 < arm.jaw.setpoint_js().position[0] < 0.1
    assert motion.done and not motion.goal_reached
    assert reported == [False]
    assert not arm.setpoint_js().velocity.any() and not arm.jaw.setpoint_js().velocity.any()


def test_a_move_that_replaces_another_reports_one_end():
    """B3, B4: the robot says nothing of the move that was replaced."""
    world = World("psm")
    arm = world.arm("PSM1")
    reported = goals(world)
    first = arm.move_jp(GOAL)
    world.step(200)
    assert arm.move_jp([0, 0, 0.12, 0, 0, 0]).wait(5.0)
    assert first.done and not first.goal_reached
    assert reported == [True]


def test_a_move_of_the_arm_takes_a_jaw_to_the_goal_of_its_last_move(caplog):
    """E16 of the recorded answers: moved to 0.4, then put to 0.6, it goes back to 0.4."""
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    assert arm.jaw.move_jp([0.4]).wait(5.0)
    assert jaw_of(world).servo_jp([0.6])
    world.step(100)
    with caplog.at_level("WARNING", "trocar"):
        assert arm.move_jp(GOAL).wait(5.0)
    assert arm.jaw.setpoint_js().position == 0.4
    assert "the jaw moves from 0.600 to 0.400 rad" in caplog.text


def test_a_relative_move_of_the_arm_adds_the_jaws_last_goal_to_where_it_is():
    """As the robot's software: its jaw went from 0.5 to 0.9, and from there to its limit."""
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    assert arm.jaw.move_jp([0.4]).wait(5.0)
    assert jaw_of(world).servo_jp([0.5])
    for expected in (0.9, arm.joints.upper[-1]):
        assert arm.move_jr([0.1, 0, 0, 0, 0, 0]).wait(5.0)
        assert arm.jaw.setpoint_js().position == pytest.approx(expected)
    again = arm.move_jr([0.1, 0, 0, 0, 0, 0])
    world.step(50)
    assert arm.move_jr([0.1, 0, 0, 0, 0, 0]).wait(5.0)  # one under way: the jaw's goal stays
    assert again.done
    assert arm.setpoint_js().position[0] == pytest.approx(0.4)


def test_a_ratio_slows_the_move_under_way_down():
    world = World("psm")
    arm = world.arm("PSM1")
    motion = arm.move_jp([-0.5, 0, 0.12, 0, 0, 0])
    world.step(round(0.3 / world.timestep))
    before = arm.setpoint_js().velocity[0]
    arm.joints.set_trajectory_ratio(0.2)
    path = followed(world, round(8.0 / world.timestep))
    speed = np.diff(path[:, 0]) / world.timestep
    rate = np.diff(speed) / world.timestep
    assert speed[0] == pytest.approx(before, abs=2e-3)
    joint = arm.description.joints[0]
    assert np.abs(rate).max() <= 0.2 * joint.acceleration_max * (1 + 1e-6)
    assert motion.goal_reached
    assert arm.setpoint_js().position[0] == -0.5
    # 0.5 s down to 0.2 of the speed, 1 s from there to a stop, and what is left between.
    slow, left = 0.2 * joint.velocity_max, 0.5 + path[0, 0]
    brake = (abs(before) - slow) / (0.2 * joint.acceleration_max)
    left -= brake * (abs(before) + slow) / 2 + slow / 2
    arrives = np.flatnonzero(path[:, 0] > -0.5 + 1e-9)[-1] * world.timestep
    assert arrives == pytest.approx(brake + left / slow + 1.0, abs=5e-3)


@pytest.mark.parametrize("ratio", [1e-9, 1e-300])
def test_a_ratio_that_leaves_no_trajectory_is_rejected(ratio):
    world = World("psm")
    arm = world.arm("PSM1")
    motion = arm.move_jp(GOAL)
    world.step(100)
    with pytest.raises(InputError, match="no trajectory"):
        arm.joints.set_trajectory_ratio(ratio)
    assert arm.joints.trajectory_ratio == (1.0, 1.0)
    assert motion.wait(5.0)
    arm.joints.set_trajectory_ratio(ratio)  # at rest there is nothing to plan yet
    assert not arm.move_jp([0, 0, 0.12, 0, 0, 0]).wait(1.0)
    assert "no trajectory" in arm.rejections.last


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
    assert arm.jaw is not None and jaw_of(world).servo_jp([0.3], [1e6])
    assert arm.jaw.setpoint_js().velocity == most[-1]
    assert "velocity clipped" in arm.rejections.last


def test_velocities_at_the_limit_are_taken_as_they_are():
    arm = World("psm").arm("PSM1")
    most = [joint.velocity_max for joint in arm.description.joints[:6]]
    assert arm.servo_jp(arm.setpoint_js().position, most)
    np.testing.assert_array_equal(arm.setpoint_js().velocity, most)
    assert arm.rejections.count == 0


def jaws(world: World, goals: tuple[float, ...], periods: int) -> np.ndarray:
    """The jaw's set-points while it moves to goals, begun `periods` apart, (periods * goals,)."""
    found = []
    for goal in goals:
        jaw_of(world).move_jp([goal])
        found.append(jaw_followed(world, periods))
    return np.concatenate(found)


def jaw_followed(world: World, periods: int) -> np.ndarray:
    found = []
    for _ in range(periods):
        world.step()
        found.append(float(jaw_of(world).setpoint_js().position[0]))
    return np.array(found)


def jaw_at(angle: float) -> World:
    world = World("psm")
    jaw_of(world).servo_jp([angle])
    return world


@pytest.mark.parametrize("periods", [400, 500, 1500], ids=["before the limit", "beyond", "at rest"])
def test_beyond_a_limit_the_jaw_waits_for_its_trajectory_there_and_back(periods):
    """As recorded, walk-moves 26.05 to 26.09; the same way 1 rad lower is within the limits.

    The second goal comes where the trajectory is before the limit but cannot stop there, beyond
    it, or at rest beyond it.
    """
    upper = float(World("psm").arm("PSM1").joints.upper[6])
    goals = upper + 0.5, 0.45
    free = jaws(jaw_at(-0.6), tuple(goal - 1.0 for goal in goals), periods)
    held = jaws(jaw_at(0.4), goals, periods)
    np.testing.assert_allclose(held, np.minimum(free + 1.0, upper), atol=1e-12)
    assert (held == upper).sum() > 20


def test_a_command_at_the_limit_ends_the_trajectory_beyond_it():
    world = jaw_at(0.4)
    jaw, upper = jaw_of(world), float(world.arm("PSM1").joints.upper[6])
    assert jaw.move_jp([upper + 2.0]).goal == pytest.approx([upper + 2.0])
    jaws(world, (upper + 2.0,), 400)
    jaw.servo_jp([upper])
    back = jaws(world, (0.4,), 400)
    reference = jaws(jaw_at(upper), (0.4,), 400)
    np.testing.assert_allclose(back, reference, atol=1e-12)


def test_a_relative_move_goes_on_beyond_a_limit_and_comes_back_from_there():
    world = World("psm")
    arm = world.arm("PSM1")
    upper = float(arm.joints.upper[0])
    assert arm.move_jr([upper + 0.5, 0, 0, 0, 0, 0]).wait()
    assert arm.setpoint_js().position[0] == upper
    assert "yaw clipped" in arm.rejections.last
    arm.move_jp([0.0, 0, 0.12, 0, 0, 0])
    path = followed(world, 1200)[:, 0]
    a = arm.description.joints[0].acceleration_max
    waited = np.sqrt(2 * 0.5 / a)  # until the trajectory has come back by 0.5 rad
    assert (path == upper).sum() * world.timestep == pytest.approx(waited, abs=4e-3)


def test_a_trajectory_beyond_a_limit_goes_on_after_save_and_load():
    world = jaw_at(0.4)
    jaws(world, (2.0, 0.45), 100)
    state = world.save()
    rest = jaw_followed(world, 200)
    other = World("psm")
    other.load(state)
    np.testing.assert_array_equal(jaw_followed(other, 200), rest)
