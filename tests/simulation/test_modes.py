"""Set, position and effort: what each does, and switching between them live."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.descriptions.inertial import apparent_inertias
from trocar.errors import InputError, UnknownNameError
from trocar.kinematics import forward
from trocar.simulation import World

TARGET = np.array([0.5, -0.4, 0.18, 0.7, 0.3, -0.2])


def test_a_set_joint_is_there_after_one_step_with_its_loops_closed_and_stays():
    world = World("psm")
    arm = world.arm("PSM1")
    arm.joints.set_mode("set")
    arm.servo_jp(TARGET)
    world.step()
    # Held by stiff constraints against gravity: to a tenth of a micron or microradian.
    np.testing.assert_allclose(arm.measured_js().position, TARGET, atol=1e-7)
    assert arm.joints.health().loop_gap_m < 1e-7  # the figure that loops are held to
    world.step(1000)
    np.testing.assert_allclose(arm.measured_js().position, TARGET, atol=1e-6)
    assert arm.joints.health().loop_gap_m < 1e-7  # the figure that loops are held to


def test_a_set_joint_stands_against_a_load_that_bends_a_servo():
    bent = {}
    for mode in ("set", "position"):
        world = World("psm", tip_load_n=10.0)
        world.arm("PSM1").joints.set_mode(mode)
        start = world.arm("PSM1").measured_js().position
        world.step(300)
        bent[mode] = np.abs(world.arm("PSM1").measured_js().position - start)[:3]
    assert bent["set"].max() < 1e-5
    assert bent["position"].max() > 1e-3


def test_only_the_chosen_joints_are_set():
    world = World("psm", friction="paper")
    arm = world.arm("PSM1")
    arm.joints.set_mode("set", ["pitch"])
    arm.servo_jp([0.3, 0.4, 0.12, 0, 0, 0])
    world.step()
    reached = arm.measured_js().position
    assert reached[1] == pytest.approx(0.4, abs=1e-6)
    assert abs(reached[0]) < 0.01  # its servo has only begun
    assert [arm.joints.mode(j) for j in ("yaw", "pitch", "insertion")] == [
        "position",
        "set",
        "position",
    ]


@pytest.mark.parametrize(("joint", "effort"), [("yaw", 0.5), ("pitch", -0.4), ("insertion", 1.0)])
def test_an_effort_accelerates_its_joint_by_effort_over_apparent_inertia(joint, effort):
    """The other joints are held, so the inertia is the diagonal of the joint-space one."""
    world = World("psm", friction="paper")
    arm = world.arm("PSM1")
    described = world.rig.arm("PSM1").arm
    index = arm.joints.names.index(joint)
    q = np.array([0.0, 0.2, 0.12, 0.0, 0.0, 0.0, 0.0])
    world.set_state("PSM1", q)
    arm.joints.set_mode("set")
    arm.joints.set_mode("effort", [joint])
    push = np.zeros(6)
    push[index] = effort
    assert arm.servo_jf(push)
    steps = 20
    world.step(steps)
    gained = arm.measured_js().velocity[index] / (steps * world.timestep)
    inertia = apparent_inertias(described, q)[index]
    # Damping of 0.1 takes at most 0.1 v / effort: half a percent of it here; gravity is balanced.
    assert gained == pytest.approx(effort / inertia, rel=0.01)


def test_an_effort_lasts_until_it_is_changed():
    world = World("psm", friction="paper")
    arm = world.arm("PSM1")
    arm.joints.set_mode("effort", ["insertion"])
    arm.servo_jf([0, 0, 0.5, 0, 0, 0])
    world.step(50)
    first = arm.measured_js().velocity[2]
    world.step(50)
    assert arm.measured_js().velocity[2] == pytest.approx(2 * first, rel=0.05)
    assert arm.measured_js().effort[2] == pytest.approx(arm.setpoint_js().effort[2], abs=0.2)
    arm.servo_jf(np.zeros(6))
    before = arm.measured_js().velocity[2]
    world.step(50)
    assert arm.measured_js().velocity[2] <= before


def test_efforts_of_joints_in_other_modes_are_ignored():
    world = World("psm")
    arm = world.arm("PSM1")
    arm.joints.set_mode("effort", ["yaw"])
    arm.servo_jf([0.1, 3.0, 9.0, 0.3, 0.2, 0.2])
    np.testing.assert_array_equal(arm.setpoint_js().effort, [0.1, 0, 0, 0, 0, 0])
    still = World("psm")
    still.arm("PSM1").joints.set_mode("effort", ["yaw"])
    still.arm("PSM1").servo_jf([0.1, 0, 0, 0, 0, 0])
    for w in (world, still):
        w.step(100)
    np.testing.assert_array_equal(world.mj_data.qpos, still.mj_data.qpos)


def test_switching_back_to_position_starts_where_the_arm_is():
    world = World("psm", friction="paper", gravity_compensation=False)
    arm = world.arm("PSM1")
    world.set_state("PSM1", np.array([0.4, 0.3, 0.12, 0, 0, 0, 0.0]))
    arm.joints.set_mode("effort")
    world.step(300)
    fallen = arm.joints.readings()[0]
    assert np.abs(fallen[:3] - [0.4, 0.3, 0.12]).max() > 0.01
    speed = np.abs(arm.joints.readings()[1]).max()
    arm.joints.set_mode("position")
    np.testing.assert_allclose(
        arm.setpoint_js().position, np.clip(fallen, arm.joints.lower, arm.joints.upper)[:6], atol=0
    )
    world.step()
    jump = np.abs(arm.joints.readings()[0] - fallen).max()
    assert jump <= 1.5 * speed * world.timestep  # no faster than it was


def test_a_live_switch_at_rest_moves_nothing():
    """With compensation and no load, no mode moves a resting arm by more than 10 um or urad."""
    world = World("psm")
    arm = world.arm("PSM1")
    world.step(500)
    before = arm.joints.readings()[0]
    for mode in ("set", "position", "effort", "position", "set", "effort"):
        arm.joints.set_mode(mode)
        world.step(100)
        assert np.abs(arm.joints.readings()[0] - before)[:6].max() < 1e-5, mode
    assert world.health().branch_ok


def test_switching_one_joint_keeps_the_efforts_of_the_others():
    world = World("psm")
    arm = world.arm("PSM1")
    arm.joints.set_mode("effort", ["yaw", "pitch"])
    arm.servo_jf([0.2, 0.3, 0, 0, 0, 0])
    arm.joints.set_mode("position", ["pitch"])
    np.testing.assert_allclose(arm.setpoint_js().effort[:2], [0.2, 0.0])


def test_servo_and_move_say_when_no_joint_can_follow():
    world = World("psm")
    arm = world.arm("PSM1")
    arm.joints.set_mode("effort")
    assert not arm.servo_jp(TARGET)
    motion = arm.move_jp(TARGET)
    assert motion.done
    assert not motion.goal_reached
    assert "effort" in arm.rejections.last
    assert arm.rejections.count == 2


def test_a_set_arm_is_where_its_kinematics_say():
    """Every frame of the model, loops included, stands where forward kinematics has it."""
    world = World("psm")
    arm = world.arm("PSM1")
    arm.joints.set_mode("set")
    arm.servo_jp(TARGET)
    mechanism = world.rig.arm("PSM1").arm.mechanism
    mujoco.mj_kinematics(world.mj_model, world.mj_data)
    poses = forward.poses(mechanism, np.append(TARGET, 0.0), relative_to="base")
    root = world.mj_data.body("PSM1/base")
    for frame in ("pitch_top", "pitch_front", "pitch_end", "counterweight", "finger_left"):
        there = root.xmat.reshape(3, 3) @ poses[frame][:3, 3] + root.xpos
        np.testing.assert_allclose(world.mj_data.body(f"PSM1/{frame}").xpos, there, atol=1e-9)


def test_unknown_modes_and_joints_are_told_with_the_known_ones():
    arm = World("psm").arm("PSM1")
    with pytest.raises(InputError, match=r"'torque'; allowed: position, effort, set"):
        arm.joints.set_mode("torque")  # pyright: ignore[reportArgumentType]
    with pytest.raises(UnknownNameError, match=r"unknown joint 'yow' \(did you mean 'yaw'\?\)"):
        arm.joints.set_mode("effort", ["yow"])
    with pytest.raises(UnknownNameError, match="yaw, pitch, insertion"):
        arm.joints.mode("elbow")
    with pytest.raises(UnknownNameError, match="yaw, pitch, insertion"):
        arm.joints.gains("elbow")
    assert arm.joints.mode("yaw") == "position"


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf, "stiff"])
def test_impossible_gains_are_rejected_and_none_is_changed(bad):
    arm = World("psm").arm("PSM1")
    before = arm.joints.gains("yaw")
    with pytest.raises(InputError, match="allowed: 0 to"):
        arm.joints.set_gains("yaw", p=10.0, d=bad)
    assert arm.joints.gains("yaw") == before
