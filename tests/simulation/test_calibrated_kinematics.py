"""Kinematics of calibrated arms in a world: exact, and quick enough for a servo loop."""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from trocar.errors import UnreachableError
from trocar.geometry import matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, pose_difference
from trocar.kinematics import jacobian_body, jacobian_spatial
from trocar.kinematics.chain_pose import chain_pose
from trocar.simulation import World
from trocar.simulation.arm import Arm

#: Steps of a nominal PSM that a verb of a calibrated arm may take. Measured: 9 (servo_cp), 0.9
#: (measured_cp) and 3 (measured_cf); by Newton's method in Python 600, 13 and 90. A scope's
#: servo_cp: 1.4 as drawn and 15 calibrated, before 16 and 500.
SERVO_STEPS, POSE_STEPS, WRENCH_STEPS = 40.0, 5.0, 20.0


def skew_world(skew_overlay, seed: int) -> World:
    return World("psm", calibration=skew_overlay("psm", np.random.default_rng(seed)))


def inner_positions(world: World, rng: np.random.Generator, count: int) -> np.ndarray:
    """Draw joint positions, instruments inserted, (count, 6)."""
    mechanism = world.rig.arm("PSM1").arm.mechanism
    lower, upper = mechanism.lower[:6].copy(), mechanism.upper[:6]
    lower[2] = 0.06
    return lower + rng.uniform(size=(count, 6)) * (upper - lower)


def steps_taken_by(call: Callable[[], object], count: int = 60) -> float:
    """Return the processor time of a call over that of one step of a nominal PSM.

    Both are the shortest of as many, taken in turn: a machine that slows down slows both.
    """
    model = World("psm").model.mj
    data = mujoco.MjData(model)
    shortest = np.full(2, np.inf)
    for _ in range(count):
        begun = time.thread_time()
        call()
        called = time.thread_time()
        mujoco.mj_step(model, data)
        shortest = np.minimum(shortest, [called - begun, time.thread_time() - called])
    return float(shortest[0] / shortest[1])


@pytest.mark.parametrize("seed", range(2))
def test_servo_cp_brings_the_joints_of_a_skew_arm_to_the_pose(seed, skew_overlay, rng):
    world = skew_world(skew_overlay, seed)
    arm = world.arm("PSM1")
    kinematics = chain_pose(arm.description.mechanism)
    for q in inner_positions(world, rng, 30):
        world.set_state("PSM1", np.append(q, 0.2))
        T = arm.measured_cp().matrix
        assert arm.servo_cp(T)
        setpoint = arm.setpoint_js().position
        assert np.abs(setpoint - q).max() < 1e-8
        metres, radians = pose_difference(
            kinematics(np.append(setpoint, 0.2)), kinematics(arm.joints.positions())
        )
        assert metres < 1e-9
        assert radians < 1e-9


def test_the_inverse_of_a_skew_arm_is_the_solution_nearest_to_the_seed(skew_overlay, rng):
    world = skew_world(skew_overlay, 1)
    arm = world.arm("PSM1")
    for q in inner_positions(world, rng, 20):
        q[3] = rng.uniform(-np.pi, np.pi)
        T = arm.local.forward_kinematics(q).matrix
        for turn in (-2.0 * np.pi, 0.0, 2.0 * np.pi):
            seed = q.copy()
            seed[3] += turn
            expected = seed if arm.joints.lower[3] <= seed[3] <= arm.joints.upper[3] else q
            assert arm.local.inverse_kinematics(T, seed) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_skew_arm_reaches_its_limits_and_nothing_beyond(side, skew_overlay):
    arm = skew_world(skew_overlay, 2).arm("PSM1")
    for joint in range(6):
        reaches_its_limit(arm, joint, side)


def reaches_its_limit(arm: Arm, joint: int, side: str) -> None:
    q = np.array([0.1, -0.2, 0.15, 0.3, 0.2, -0.1])
    limit = getattr(arm.joints, side)[joint]
    q[joint] = limit
    if joint == 2 and side == "lower":
        q[joint] = limit + 0.05  # the wrist would be at the remote centre
    found = arm.local.inverse_kinematics(arm.local.forward_kinematics(q).matrix, q)
    assert found == pytest.approx(q, abs=1e-8)
    assert (found >= arm.joints.lower[:6]).all()
    assert (found <= arm.joints.upper[:6]).all()
    if q[joint] != limit:
        return
    beyond = 1e-4 if side == "upper" else -1e-4
    q[joint] += beyond
    if arm.joints.names[joint] == "roll":  # more than a turn: it comes back by one
        found = arm.local.inverse_kinematics(arm.local.forward_kinematics(q).matrix, q)
        assert found[joint] == pytest.approx(q[joint] - np.copysign(2.0 * np.pi, beyond), abs=1e-8)
        return
    with pytest.raises(UnreachableError, match=arm.joints.names[joint]):
        arm.local.inverse_kinematics(arm.local.forward_kinematics(q).matrix, q)


def test_poses_and_jacobians_of_a_skew_arm_in_motion_are_those_of_its_joints(skew_overlay):
    world = skew_world(skew_overlay, 3)
    arm = world.arm("PSM1")
    mechanism = arm.description.mechanism
    arm.move_jp([0.4, 0.6, 0.2, 1.0, -0.4, 0.3])
    for _ in range(5):
        world.step(100)
        q, qd, _ = arm.joints.readings()
        assert np.abs(arm.local.measured_cp().matrix - chain_pose(mechanism)(q)).max() < 1e-12
        setpoint = chain_pose(mechanism)(
            np.append(arm.setpoint_js().position, 0.0)
        )  # whatever the jaw
        assert np.abs(arm.local.setpoint_cp().matrix - setpoint).max() < 1e-12
        body = jacobian_body(mechanism, q)
        assert np.abs(arm.body.jacobian() - body[:, :6]).max() < 1e-10
        assert np.abs(arm.spatial.jacobian() - jacobian_spatial(mechanism, q)[:, :6]).max() < 1e-10
        velocity = chain_pose(mechanism)(q)[:3, :3] @ (body @ qd)[:3]
        assert arm.local.measured_cv().linear == pytest.approx(velocity, abs=1e-10)


def test_a_skew_arm_put_far_beyond_a_limit_has_the_pose_of_its_joints(skew_overlay):
    world = skew_world(skew_overlay, 4)
    arm = world.arm("PSM1")
    q = np.array([0.1, arm.joints.upper[1] + 0.1, 0.15, 0.1, 0.1, 0.1, 0.0])
    world.set_state("PSM1", q)
    mechanism = arm.description.mechanism
    assert np.abs(arm.local.measured_cp().matrix - chain_pose(mechanism)(q)).max() < 1e-9
    assert np.abs(arm.body.jacobian() - jacobian_body(mechanism, q)[:, :6]).max() < 1e-9


def test_poses_in_the_frame_of_a_skew_scope_are_those_of_its_joints(skew_overlay):
    overlay = skew_overlay("ecm", np.random.default_rng(5))
    world = World("two_psm_ecm", calibration={"ECM": overlay}, tip_load_n=10.0)
    scope, arm = world.arm("ECM"), world.arm("PSM1")
    world.step(200)
    tip = chain_pose(scope.description.mechanism)(scope.joints.positions())
    expected = inverse(world.reference_pose("ECM") @ tip) @ world.reference_pose("PSM1")
    assert np.abs(arm.local.base_frame()[0] - expected).max() < 1e-12


def test_verbs_of_a_calibrated_arm_are_quick_enough_for_a_servo_loop(skew_overlay):
    world = skew_world(skew_overlay, 0)
    arm = world.arm("PSM1")
    T = arm.forward_kinematics([0.1, 0.2, 0.13, 0.1, 0.1, 0.1]).matrix
    assert steps_taken_by(lambda: arm.servo_cp(T)) < SERVO_STEPS
    assert steps_taken_by(arm.measured_cp) < POSE_STEPS
    assert steps_taken_by(arm.body.measured_cf) < WRENCH_STEPS


@pytest.mark.parametrize("seed", range(2))
def test_a_skew_scope_takes_the_poses_it_can_and_no_other(seed, skew_overlay, rng):
    world = World("ecm", calibration=skew_overlay("ecm", np.random.default_rng(seed)))
    scope = world.arm("ECM")
    lower, upper = scope.joints.lower.copy(), scope.joints.upper
    lower[2] = 0.05
    for q in lower + rng.uniform(size=(20, 4)) * (upper - lower):
        T = scope.local.forward_kinematics(q).matrix
        near = np.clip(q + 0.02 * rng.standard_normal(4), scope.joints.lower, upper)
        assert scope.local.inverse_kinematics(T, near) == pytest.approx(q, abs=1e-8)
        T = T.copy()
        T[:3, :3] = T[:3, :3] @ matrix_from_rotation_vector([1e-4, 0.0, 0.0])
        with pytest.raises(UnreachableError, match="misses"):
            scope.local.inverse_kinematics(T, near)


@pytest.mark.parametrize("calibrated", [False, True])
def test_servo_cp_of_a_scope_is_quick_enough_for_a_servo_loop(calibrated, skew_overlay):
    overlay = skew_overlay("ecm", np.random.default_rng(0)) if calibrated else None
    world = World("ecm", calibration=overlay)
    scope = world.arm("ECM")
    T = scope.forward_kinematics([0.1, 0.2, 0.13, 0.1]).matrix
    assert steps_taken_by(lambda: scope.servo_cp(T)) < (60.0 if calibrated else 8.0)
