"""Verbs and readings of the tip: poses, twists, wrenches, and the frames that they are in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import pose_difference, transform
from trocar.simulation import World
from trocar.simulation.arm import Arm
from trocar.simulation.controllers import CartesianImpedance, HalfPlaneGains, TipState

POSES = {
    "psm": ("PSM1", [0.2, -0.1, 0.15, 0.3, 0.2, -0.1]),
    "ecm": ("ECM", [0.1, 0.2, 0.12, 0.3]),
}


def shifted(T: np.ndarray, *by: float) -> np.ndarray:
    moved = T.copy()
    moved[:3, 3] += by
    return moved


@pytest.fixture
def world() -> World:
    return World("psm")


@pytest.fixture
def arm(world) -> Arm:
    return world.arm("PSM1")


@pytest.mark.parametrize("rig", POSES)
def test_servo_cp_puts_the_set_point_on_the_pose(rig):
    world = World(rig)
    name, q = POSES[rig]
    arm = world.arm(name)
    T = arm.forward_kinematics(q).matrix
    world.set_state(name, np.array([*q, 0.0])[: len(arm.joints.names)])
    arm.servo_jp(np.array(q) - 0.02)
    assert arm.servo_cp(T)
    metres, radians = pose_difference(arm.setpoint_cp().matrix, T)
    assert metres < 1e-9
    assert radians < 1e-9
    np.testing.assert_allclose(arm.setpoint_js().position, q, atol=1e-8)
    world.step(1500)
    metres, radians = pose_difference(arm.measured_cp().matrix, T)
    assert metres < 2e-3
    assert radians < 2e-2


def test_move_cp_is_solved_once_and_runs_in_joint_space(world, arm):
    T = arm.forward_kinematics(POSES["psm"][1]).matrix
    begin = arm.setpoint_js().position
    motion = arm.move_cp(T)
    np.testing.assert_allclose(motion.goal, POSES["psm"][1], atol=1e-8)
    world.step(120)
    half = arm.setpoint_js().position
    shares = (half - begin) / (motion.goal - begin)
    assert motion.wait(5.0)
    assert np.ptp(shares[np.abs(motion.goal - begin) > 0.02]) < 0.35
    metres, radians = pose_difference(arm.setpoint_cp().matrix, T)
    assert metres < 1e-9
    assert radians < 1e-9


def test_servo_cr_adds_a_translation_and_turns_about_the_tip(arm):
    before = arm.setpoint_cp().matrix
    turn = matrix_from_rotation_vector(np.array([0.0, 0.0, 0.1]))
    assert arm.servo_cr(transform(turn, np.array([0.0, 0.002, -0.001])))
    after = arm.setpoint_cp().matrix
    np.testing.assert_allclose(after[:3, 3] - before[:3, 3], [0.0, 0.002, -0.001], atol=1e-9)
    np.testing.assert_allclose(after[:3, :3], turn @ before[:3, :3], atol=1e-9)


@pytest.mark.parametrize("verb", ["servo_cp", "servo_cr", "move_cp"])
@pytest.mark.parametrize(
    "bad", [np.zeros((4, 4)), np.full((4, 4), np.nan), np.eye(3), 2 * np.eye(4)]
)
def test_what_is_no_pose_is_rejected(arm, verb, bad):
    before = arm.setpoint_js().position
    answer = getattr(arm, verb)(bad)
    assert not (answer.goal_reached if verb == "move_cp" else answer)
    np.testing.assert_array_equal(arm.setpoint_js().position, before)
    assert arm.rejections.count == 1


@pytest.mark.parametrize(
    "verb",
    [
        lambda arm: arm.servo_cp(arm.setpoint_cp().matrix),
        lambda arm: arm.servo_cr(np.eye(4)),
        lambda arm: arm.move_cp(arm.setpoint_cp().matrix).wait(1.0),
        lambda arm: arm.body.servo_cf(np.zeros(6)),
        lambda arm: arm.forces.servo_ci(CartesianImpedance(arm.measured_cp().matrix[:3, 3])),
    ],
)
def test_cartesian_verbs_wait_until_the_wrist_is_43_mm_past_the_remote_centre(world, arm, verb):
    """400006: the wrist is at q3 - 15.6 mm. Source: dVRK tool and PSM files."""
    world.set_state("PSM1", np.array([0.1, 0.1, 0.0580, 0.0, 0.0, 0.0, 0.0]))
    assert not verb(arm)
    assert "42.4 mm past" in arm.rejections.last
    world.set_state("PSM1", np.array([0.1, 0.1, 0.0592, 0.0, 0.0, 0.0, 0.0]))
    assert verb(arm)


def test_measured_cv_is_how_the_measured_pose_changes(world, arm):
    arm.move_jp([0.4, -0.3, 0.2, 1.0, 0.5, -0.5])
    world.step(250)
    before = arm.measured_cp().matrix
    twist = arm.measured_cv()
    world.step(1)
    after = arm.measured_cp().matrix
    later = arm.measured_cv()
    rate = (after[:3, 3] - before[:3, 3]) / world.timestep
    mean = 0.5 * (twist.linear + later.linear)
    np.testing.assert_allclose(rate, mean, atol=1e-4)
    turned = after[:3, :3] @ before[:3, :3].T
    omega = np.array([turned[2, 1], turned[0, 2], turned[1, 0]]) / world.timestep
    np.testing.assert_allclose(omega, 0.5 * (twist.angular + later.angular), atol=5e-3)


@pytest.mark.parametrize("frame", ["body", "spatial"])
def test_the_jacobian_is_that_of_the_joints_without_the_jaw(arm, frame):
    assert getattr(arm, frame).jacobian().shape == (6, 6)
    with pytest.raises(InputError, match="body, spatial"):
        arm.runtime.tip.jacobian("tool")


@pytest.mark.parametrize("frame", ["body", "spatial"])
def test_a_commanded_wrench_is_the_measured_one(world, arm, frame):
    wrench = np.array([0.5, -0.3, 0.4, 0.01, 0.005, -0.008])
    assert getattr(arm, frame).servo_cf(wrench)
    world.step(1)
    found = getattr(arm, frame).measured_cf()
    np.testing.assert_allclose(np.r_[found.force, found.torque], wrench, atol=3e-3)


def test_a_force_pushes_the_tip_its_way_and_follows_the_arm(world, arm):
    assert arm.body.servo_cf([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    before = arm.measured_cp().matrix
    world.step(150)
    after = arm.measured_cp().matrix
    moved = before[:3, :3].T @ (after[:3, 3] - before[:3, 3])
    assert moved[2] > 1e-3
    found = arm.body.measured_cf()
    np.testing.assert_allclose(found.force, [0.0, 0.0, 2.0], atol=0.05)


def test_an_absolute_wrench_keeps_its_direction_in_the_reference_frame(world, arm):
    arm.forces.set_cf_orientation_absolute(True)
    assert arm.body.servo_cf([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    world.step(1)
    R = arm.measured_cp().matrix[:3, :3]
    np.testing.assert_allclose(R @ arm.body.measured_cf().force, [0.0, 0.0, 1.0], atol=3e-3)


def springs(arm: Arm) -> CartesianImpedance:
    T = arm.measured_cp().matrix
    stiff = HalfPlaneGains(p=np.full(3, -300.0), d=np.full(3, -15.0))
    turn = HalfPlaneGains(p=np.full(3, -0.3), d=np.full(3, -0.01))
    return CartesianImpedance(T[:3, 3], np.eye(3), T[:3, :3], stiff, stiff, turn, turn)


def tip_state(arm: Arm) -> TipState:
    """Give where an arm at rest is, as controllers get it."""
    q, body, spatial = arm.measured_js().position, arm.body.jacobian(), arm.spatial.jacobian()
    return TipState(q, 0 * q, arm.measured_cp().matrix, arm.local.base_frame()[0], body, spatial)


def test_an_impedance_pulls_the_tip_back_to_its_pose(world, arm):
    world.step(300)
    impedance = springs(arm)
    assert arm.forces.servo_ci(impedance)
    world.mj_data.qvel[world.mj_model.jnt_dofadr[world.mj_model.joint("PSM1/yaw").id]] += 0.3
    world.step(30)
    away = np.linalg.norm(arm.measured_cp().matrix[:3, 3] - impedance.force_position)
    world.step(2000)
    back = np.linalg.norm(arm.measured_cp().matrix[:3, 3] - impedance.force_position)
    assert away > 5e-4
    assert back < 0.3 * away + 1e-3
    assert arm.operating_state().state == "ENABLED"


def test_an_impedance_gives_way_by_force_over_stiffness():
    """Statically p * x = F; dry friction holds back less than a tenth."""
    controller = springs(World("psm").arm("PSM1"))
    arm = World("psm").arm("PSM1")
    now = tip_state(arm)
    away = shifted(now.T, 0.01, 0.0, 0.0)
    effort = controller.act(replace(now, T=away)).effort
    wrench = np.linalg.solve(now.body.T, effort)
    np.testing.assert_allclose(now.T[:3, :3] @ wrench[:3], [-3.0, 0.0, 0.0], atol=1e-9)


def test_a_deadband_and_a_bias_act_where_they_should():
    arm = World("psm").arm("PSM1")
    now = tip_state(arm)
    gains = HalfPlaneGains(p=np.full(3, -100.0), deadband=np.full(3, 0.02), bias=np.full(3, 1.0))
    near = CartesianImpedance(now.T[:3, 3] - 0.01, position_positive=gains)
    assert not near.act(now).effort.any()
    far = CartesianImpedance(now.T[:3, 3] - [0.05, 0.0, 0.0], position_positive=gains)
    wrench = np.linalg.solve(now.body.T, far.act(now).effort)
    np.testing.assert_allclose(now.T[:3, :3] @ wrench[:3], [-3.0 + 1.0, 0.0, 0.0], atol=1e-9)


def test_a_psm_s_pose_follows_the_endoscope_and_the_setup_joints_also_during_servo_cp():
    world = World("suj_two_psm_ecm")
    arm, scope, setup = world.arm("PSM1"), world.arm("ECM"), world.arm("SUJ_PSM1")
    world.step(500)
    assert arm.servo_cp(arm.setpoint_cp().matrix)
    first, local = arm.measured_cp(), arm.local.measured_cp().matrix
    assert first.frame_id == "ECM"
    assert scope.move_jr([-0.1, 0.05, 0.0, 0.0]).wait(5.0)
    second = arm.measured_cp().matrix
    setup.brakes.release()
    assert setup.move_jr([0.03, 0.0, 0.0, 0.0, 0.0, 0.0]).wait(10.0)
    third = arm.measured_cp().matrix
    assert pose_difference(first.matrix, second)[0] > 0.005
    assert pose_difference(second, third)[0] > 0.005
    assert pose_difference(local, arm.local.measured_cp().matrix)[0] < 1e-3
    assert arm.servo_cp(arm.setpoint_cp().matrix)


def test_a_base_frame_of_one_s_own_replaces_the_rig_s(arm):
    turn = matrix_from_rotation_vector(np.array([0.3, -0.2, 0.5]))
    base = transform(turn, np.array([0.1, 0.2, 0.3]))
    local = arm.local.measured_cp().matrix
    arm.local.set_base_frame(base, "table")
    found = arm.measured_cp()
    assert found.frame_id == "table"
    np.testing.assert_allclose(found.matrix, base @ local, atol=1e-12)
    assert arm.servo_cp(arm.setpoint_cp().matrix)
    own = arm.local.measured_cv()
    np.testing.assert_allclose(arm.measured_cv().linear, turn @ own.linear, atol=1e-12)
    arm.local.set_base_frame(None)
    np.testing.assert_allclose(arm.measured_cp().matrix, local, atol=1e-12)
    with pytest.raises(InputError):
        arm.local.set_base_frame(np.zeros((4, 4)))


def test_services_of_kinematics_are_inverse_to_each_other(arm):
    q = np.array(POSES["psm"][1])
    np.testing.assert_allclose(
        arm.inverse_kinematics(arm.local.forward_kinematics(q).matrix, seed=q), q, atol=1e-8
    )
    with pytest.raises(InputError, match="6 finite numbers"):
        arm.forward_kinematics([1.0])
