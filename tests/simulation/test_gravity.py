"""Gravity compensation: two computations agree, and released arms stay."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.inertial import holding_efforts
from trocar.descriptions.overlay_records import ClosurePatch, Overlay
from trocar.kinematics import pose
from trocar.simulation import World
from trocar.simulation.supervision import Supervision

WORLD_DOWN = np.array([0.0, 0.0, -1.0])
#: Rounding over chains of twenty products with 10 kg at 1 m.
AGREED = 1e-9


def fed_forward(world: World, name: str) -> np.ndarray:
    """What compensation feeds each servo of an arm now, (n,)."""
    motors, servos = world.arm(name).runtime.motors, world.servos
    holding = world.part(Supervision).holding_efforts(np.zeros(len(servos.table)))
    return (servos.balanced * holding)[motors.index.rows]


@pytest.mark.parametrize(("rig", "name"), [("psm", "PSM1"), ("ecm", "ECM")])
def test_compensation_is_what_virtual_work_on_the_description_asks(
    rig, name, rng, random_positions
):
    world = World(rig)
    arm = world.rig.arm(name).arm
    down = world.reference_pose(name)[:3, :3].T @ WORLD_DOWN
    for q in random_positions(arm, rng, 20):
        world.set_state(name, q)
        expected = holding_efforts(arm, q, down)
        np.testing.assert_allclose(fed_forward(world, name), expected, atol=AGREED)


def test_arms_that_hang_tilted_on_setup_joints_are_balanced_as_they_hang(rng, random_positions):
    world = World("full_cart")
    for setup in ("SUJ_PSM1", "SUJ_ECM"):
        arm = world.rig.arm(setup).arm
        world.set_state(setup, random_positions(arm, rng, 1)[0])
    for name in ("PSM1", "PSM3", "ECM"):
        arm = world.rig.arm(name).arm
        q = random_positions(arm, rng, 1)[0]
        world.set_state(name, q)
        down = world.reference_pose(name)[:3, :3].T @ WORLD_DOWN
        assert down[2] > -0.999  # tilted
        expected = holding_efforts(arm, q, down)
        np.testing.assert_allclose(fed_forward(world, name), expected, atol=AGREED)


def test_setup_joints_carry_themselves_and_the_arm_that_hangs_on_them():
    """The vertical slide holds the whole weight of what moves with it, up or down."""
    world = World("full_cart")
    arm = world.rig.arm("SUJ_PSM1").arm
    mechanism = arm.mechanism
    slide = mechanism.frame_index[arm.joints[0].drive[0][0]]
    riding = sum(b.mass for b in arm.bodies if slide in mechanism.chain(b.frame))
    riding += sum(b.mass for b in world.rig.arm("PSM1").arm.bodies)
    assert fed_forward(world, "SUJ_PSM1")[0] == pytest.approx(9.81 * riding, rel=1e-12)


def test_turning_setup_joints_feel_the_arm_by_finite_differences():
    """Effort = d (potential energy) / d q, by moving the compiled model a little."""
    world = World("full_cart")
    model, data = world.mj_model, world.mj_data
    index = world.arm("SUJ_ECM").runtime.motors.index
    expected = fed_forward(world, "SUJ_ECM")
    for joint, address in enumerate(index.qpos):
        energy = []
        here = data.qpos[address]
        for step in (1e-5, -1e-5):
            data.qpos[address] = here + step
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            energy.append(9.81 * float(model.body_mass @ data.xipos[:, 2]))
        data.qpos[address] = here
        slope = (energy[0] - energy[1]) / 2e-5
        assert expected[joint] == pytest.approx(slope, abs=1e-5)  # of 200 N


@pytest.mark.parametrize("rig", ["psm", "ecm", "full_cart"])
def test_released_arms_stay_when_compensated_and_without_dry_friction(rig):
    world = World(rig, friction="paper")
    arms = [a for a in world.arms.values() if a.description.type in ("PSM", "ECM")]
    before = {}
    for arm in arms:
        arm.joints.set_mode("effort")
        before[arm.name] = arm.joints.readings()[0]
    world.step(1000)
    for arm in arms:
        # Renewed each 20 ms and discretised: 1 mm, 1 mrad a second, the figure of the insertion.
        assert np.abs(arm.joints.readings()[0] - before[arm.name]).max() < 1e-3, arm.name


def test_compensation_follows_an_arm_that_moves():
    """At 0.5 rad/s what is fed is at most 20 ms old."""
    world = World("psm", dynamics="cad")
    arm, described = world.arm("PSM1"), world.rig.arm("PSM1").arm
    goal = np.array([0.8, 0.5, 0.2, 0.0, 0.0, 0.0])
    arm.move_jp(goal)
    passed = [arm.joints.readings()[0]]
    fed = world.servos.setpoint[:, 2]
    for _ in range(60):
        world.step(21)
        passed.append(arm.joints.readings()[0])
        recent = holding_efforts(described, np.array(passed[-3:]))
        low, high = recent.min(axis=0), recent.max(axis=0)
        assert (fed >= low - 2e-3).all()
        assert (fed <= high + 2e-3).all()
    assert np.abs(passed[-1] - passed[0])[:2].min() > 0.3


def test_without_compensation_they_fall():
    world = World("psm", friction="paper", gravity_compensation=False)
    arm = world.arm("PSM1")
    world.set_state("PSM1", np.array([0.5, 0.3, 0.12, 0, 0, 0, 0.0]))
    assert not arm.joints.gravity_compensation
    arm.joints.set_mode("effort")
    world.step(1000)
    assert np.abs(arm.joints.readings()[0][:2] - [0.5, 0.3]).max() > 0.05


def test_compensation_is_switched_at_once_and_says_so():
    world = World("psm", dynamics="cad")
    arm = world.arm("PSM1")
    world.set_state("PSM1", np.array([0.5, 0.3, 0.12, 0, 0, 0, 0.0]))
    fed = world.servos.setpoint[:, 2]
    assert arm.joints.gravity_compensation
    assert np.abs(fed[:2]).min() > 0.05
    arm.joints.use_gravity_compensation(False)
    assert not arm.joints.gravity_compensation
    assert not fed.any()
    arm.joints.use_gravity_compensation(True)
    assert arm.joints.gravity_compensation
    assert np.abs(fed[:2]).min() > 0.05


@pytest.mark.parametrize(
    ("control", "requested", "on"),
    [("dvrk", None, True), ("paper", None, False), ("paper", True, True), ("dvrk", False, False)],
)
def test_compensation_starts_as_the_control_set_or_the_caller_has_it(control, requested, on):
    world = World("psm", control=control, gravity_compensation=requested)
    assert world.arm("PSM1").joints.gravity_compensation is on


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_static_gravity_is_at_most_half_of_each_effort_limit(name, random_positions, rng):
    arm = load_arm(name)
    limits = np.array([j.effort_max for j in arm.joints])
    q = random_positions(arm, rng, 3000)
    assert (np.abs(holding_efforts(arm, q)).max(axis=0) <= 0.5 * limits).all()


@pytest.mark.parametrize("name", ["full_cart", "suj_two_psm_ecm"])
def test_static_gravity_is_at_most_half_of_each_limit_as_the_cart_tilts_the_arms(
    name, random_positions, rng
):
    """Arms and setup joints at random setup poses, the carried arm in random poses."""
    world = World(load_rig(name), collisions=False)
    for _ in range(60):
        for rig_arm in world.rig.arms:
            world.set_state(rig_arm.name, random_positions(rig_arm.arm, rng, 1)[0])
        for rig_arm in world.rig.arms:
            limits = np.array([j.effort_max for j in rig_arm.arm.joints])
            share = np.abs(fed_forward(world, rig_arm.name)) / limits
            assert share.max() <= 0.5, (rig_arm.name, share)


def broken_psm() -> Overlay:
    """A PSM whose upper loop is 1 mm from a parallelogram, as the paper's Table 6 has it."""
    mechanism = load_arm("psm").mechanism
    c2 = next(c for c in mechanism.closures if c.name == "c2")
    return Overlay(
        "psm", "general", {}, {"c2": ClosurePatch(c2.point_a + np.array([1e-3, 0, 0]), c2.point_b)}
    )


def test_compensation_follows_loops_that_are_no_parallelograms(rng, random_positions):
    world = World("psm", calibration=broken_psm())
    arm = world.rig.arm("PSM1").arm
    down = world.reference_pose("PSM1")[:3, :3].T @ WORLD_DOWN
    for q in random_positions(arm, rng, 10):
        world.set_state("PSM1", q)
        expected = holding_efforts(arm, q, down)
        np.testing.assert_allclose(fed_forward(world, "PSM1"), expected, atol=AGREED)


def test_a_free_arm_with_broken_loops_stays_where_it_is():
    world = World("psm", calibration=broken_psm(), friction="paper")
    arm = world.arm("PSM1")
    arm.free()
    before = arm.measured_js().position
    world.step(5000)
    assert np.abs(arm.measured_js().position - before).max() < 1e-3  # rad or m


def test_a_load_on_the_tip_is_read_off_the_motors_of_broken_loops():
    world = World("psm", calibration=broken_psm(), friction="paper", tip_load_n=10.0)
    arm = world.arm("PSM1")
    world.set_state("PSM1", np.array([0.2, 0.6, 0.12, 0.1, 0.2, -0.1, 0.0]))
    world.step(2000)
    J, state = arm.spatial.jacobian(), arm.measured_js()
    # Independent of both: differences of the closed kinematics.
    mechanism, step = world.rig.arm("PSM1").arm.mechanism, 1e-6
    column = []
    for sign in (1.0, -1.0):
        q = np.append(state.position, 0.0)
        q[1] += sign * step
        column.append(pose(mechanism, q)[:3, 3])
    slope = (column[0] - column[1]) / (2.0 * step)
    tip = pose(mechanism, np.append(state.position, 0.0))[:3, 3]
    np.testing.assert_allclose(J[:3, 1] + np.cross(J[3:, 1], tip), slope, atol=1e-6)
    force = arm.spatial.measured_cf().force
    assert np.linalg.norm(force) == pytest.approx(10.0, rel=0.05)
