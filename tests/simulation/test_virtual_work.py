"""Efforts, Jacobians and wrenches of broken loops agree with virtual work along the constraints.

MuJoCo's own constraints give how every hinge follows the joints where the arm is: independent of
the kinematics that the arm's verbs use, and of any fixed ratio.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.overlay_records import ClosurePatch, Overlay
from trocar.modeling import naming
from trocar.simulation import Batch, World
from trocar.simulation.controllers import WrenchFrame
from trocar.simulation.readout import Reader

#: Rounding over chains of twenty products with 10 kg at 1 m.
AGREED = 1e-9
ARMS = (("psm", "PSM1"), ("ecm", "ECM"))
#: Small enough for every motor. [N, N m]
WRENCH = np.array([0.3, -0.2, 0.5, 0.01, 0.02, -0.03])


def broken_loops(kind: str) -> Overlay:
    """Both loops 1 mm from parallelograms, as the paper's Table 6 has it."""
    by = np.array([0.8e-3, 0.6e-3, 0.0])
    closures = load_arm(kind).mechanism.closures
    patches = {c.name: ClosurePatch(c.point_a + by, c.point_b) for c in closures}
    return Overlay(kind, "general", {}, patches)


def hinge_rates(world: World) -> np.ndarray:
    """Return d (every degree of freedom) / d q that satisfies MuJoCo's constraints, (nv, J)."""
    model, data = world.mj_model, mujoco.MjData(world.mj_model)
    data.qpos[:] = world.mj_data.qpos
    mujoco.mj_forward(model, data)
    J = data.efc_J.reshape(-1, model.nv)
    closed = J[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    rows = np.vstack([closed, world.joints.rate])
    goal = np.vstack([np.zeros((len(closed), len(world.joints))), np.eye(len(world.joints))])
    rates = np.linalg.lstsq(rows, goal)[0]
    # A millimetre leans nothing: plane loops close exactly, so the constraints have a solution.
    assert np.abs(rows @ rates - goal).max() < AGREED
    return rates


def arm_positions(world: World, name: str) -> np.ndarray:
    return world.arm(name).joints.readings()[0]


def places(world: World, name: str, count: int = 5) -> np.ndarray:
    rng, arm = np.random.default_rng(4), world.arm(name)
    return rng.uniform(arm.joints.lower, arm.joints.upper, (count, len(arm.joints.lower)))


@pytest.mark.parametrize(("kind", "name"), ARMS)
def test_gravity_of_broken_loops_is_the_work_of_the_weights_along_the_constraints(kind, name):
    world = World(kind, calibration=broken_loops(kind), dynamics="cad")
    for q in places(world, name):
        world.set_state(name, q)
        data = mujoco.MjData(world.mj_model)
        data.qpos[:] = world.mj_data.qpos
        mujoco.mj_forward(world.mj_model, data)
        expected = hinge_rates(world).T @ data.qfrc_bias
        np.testing.assert_allclose(world.servos.holding, expected, atol=AGREED)
        batch = Batch(world, 1)
        moved = batch.step(n=40).q[0]  # two renewals of the compensation
        world.step(40)
        np.testing.assert_array_equal(moved, arm_positions(world, name))


@pytest.mark.parametrize(("kind", "name"), ARMS)
@pytest.mark.parametrize("frame", ["body", "spatial"])
def test_jacobians_of_broken_loops_move_the_tip_as_the_constraints_do(
    kind: str, name: str, frame: WrenchFrame
) -> None:
    world = World(kind, calibration=broken_loops(kind))
    arm, reader = world.arm(name), Reader(world.model)
    for q in places(world, name):
        world.set_state(name, q)
        J = getattr(arm, frame).jacobian()
        np.testing.assert_allclose(J, tip_jacobian(world, name, frame), atol=AGREED)
        read = reader.read(world.sample()).arm(name)
        np.testing.assert_allclose(read.jacobian(frame), J, atol=AGREED)


def tip_jacobian(world: World, name: str, frame: WrenchFrame) -> np.ndarray:
    """Return J with (linear; angular) = J @ qd by MuJoCo's constraints and kinematics, (6, n)."""
    model, data = world.mj_model, mujoco.MjData(world.mj_model)
    data.qpos[:] = world.mj_data.qpos
    mujoco.mj_forward(model, data)
    tip, own = (model.site(naming.frame_site(name, f)).id for f in ("tip", "reference"))
    seen, turns = tip if frame == "body" else own, np.zeros((6, model.nv))
    at, body = data.site_xpos[seen], int(model.site_bodyid[tip])
    mujoco.mj_jac(model, data, turns[:3], turns[3:], at, body)
    axes = data.site_xmat[seen].reshape(3, 3)
    rates = hinge_rates(world)[:, : world.arm(name).description.own_joints]
    return np.concatenate([axes.T @ turns[:3] @ rates, axes.T @ turns[3:] @ rates])


@pytest.mark.parametrize(("kind", "name"), ARMS)
@pytest.mark.parametrize("frame", ["body", "spatial"])
def test_a_commanded_wrench_on_broken_loops_is_exerted_by_efforts_of_virtual_work(
    kind: str, name: str, frame: WrenchFrame
) -> None:
    world = World(kind, calibration=broken_loops(kind))
    arm = world.arm(name)
    for q in places(world, name, 3):
        world.set_state(name, q)
        J = tip_jacobian(world, name, frame)
        getattr(arm, frame).servo_cf(WRENCH)
        world.step(1)
        efforts = world.servos.commanded[: J.shape[1]]
        np.testing.assert_allclose(efforts, J.T @ WRENCH, atol=AGREED)
        arm.hold()


@pytest.mark.parametrize(("kind", "name"), ARMS)
@pytest.mark.parametrize("frame", ["body", "spatial"])
def test_a_measured_wrench_of_broken_loops_does_the_work_of_the_motors_that_gravity_leaves(
    kind: str, name: str, frame: WrenchFrame
) -> None:
    world = World(kind, calibration=broken_loops(kind))
    arm = world.arm(name)
    for q in places(world, name, 3):
        world.set_state(name, q)
        arm.servo_jp(
            np.clip(q + 1e-3, arm.joints.lower, arm.joints.upper)[: arm.description.own_joints]
        )
        J, efforts = tip_jacobian(world, name, frame), arm.measured_js().effort
        left = (efforts - world.servos.holding[: len(efforts)])[: J.shape[1]]
        wrench = getattr(arm, frame).measured_cf()
        work = J.T @ np.concatenate([wrench.force, wrench.torque])
        assert np.abs(left).max() > 0.1
        np.testing.assert_allclose(work, left, atol=AGREED * max(1.0, np.abs(left).max()))
