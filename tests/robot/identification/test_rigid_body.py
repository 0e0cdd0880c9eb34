"""The inverse dynamics of a description are those of the simulated model."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar import build
from trocar.descriptions import load_arm
from trocar.descriptions.calibrated import as_overlay
from trocar.descriptions.inertial import apparent_inertias, holding_efforts
from trocar.descriptions.records import ArmDescription
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import InputError, UnknownNameError
from trocar.robot.identification import JointMotion, predicted_efforts, rigid_efforts
from trocar.robot.identification.drivetrains import described_trains
from trocar.robot.identification.rigid_body import mass_com_inertia, parameters, pseudo_inertia
from trocar.robot.standing import standing_arm
from trocar.simulation.drives import Springs, drives_of, spring_fields


def motion_of(arm: ArmDescription, rng: np.random.Generator, count: int = 20) -> JointMotion:
    mechanism = arm.mechanism
    span = mechanism.upper - mechanism.lower
    q = mechanism.lower + rng.random((count, len(span))) * span
    return JointMotion(q, rng.normal(size=q.shape), rng.normal(size=q.shape))


@pytest.mark.parametrize("name", ["psm", "ecm", "mtmr", "psm_si", "ecm_si"])
def test_predicted_efforts_are_the_inverse_dynamics_of_the_simulation(
    name: str, rng: np.random.Generator
) -> None:
    arm = load_arm(name)
    motion = motion_of(arm, rng)
    model = build(lone_arm_rig(arm))
    data, joints = mujoco.MjData(model.mj), model.joints
    found = predicted_efforts(arm, described_trains(arm), motion)
    for k in range(len(motion.q)):
        data.qpos[:] = joints.couple @ motion.q[k]
        data.qvel[:] = joints.couple @ motion.qd[k]
        data.qacc[:] = joints.couple @ motion.qdd[k]
        mujoco.mj_fwdPosition(model.mj, data)
        mujoco.mj_comVel(model.mj, data)
        force = np.zeros(model.mj.nv)
        mujoco.mj_rne(model.mj, data, 1, force)
        force += model.mj.dof_armature * data.qacc
        damping = np.asarray(model.mj.dof_damping).reshape(model.mj.nv, -1)[:, 0]
        force += damping * data.qvel + model.mj.dof_frictionloss * np.sign(data.qvel)
        # the gripper's spring is in the simulation alone
        count = arm.own_joints
        np.testing.assert_allclose(found[k][:count], (joints.share @ force)[:count], atol=1e-9)


def test_efforts_at_rest_hold_the_arm_and_accelerate_its_apparent_inertia(
    rng: np.random.Generator,
) -> None:
    arm = load_arm("psm")
    q, still = motion_of(arm, rng).q, np.zeros((20, 7))
    held = rigid_efforts(arm, JointMotion(q, still, still))
    np.testing.assert_allclose(held, holding_efforts(arm, q), atol=1e-12)
    for joint in range(7):
        pushed = rigid_efforts(arm, JointMotion(q, still, still + np.eye(7)[joint]))
        inertia = apparent_inertias(arm, q)[:, joint]
        np.testing.assert_allclose((pushed - held)[:, joint], inertia, atol=1e-12)


@pytest.mark.parametrize("name", ["psm", "psm_si", "ecm_si"])
def test_gravity_of_a_leaning_arm_comes_from_where_it_leans(
    name: str, rng: np.random.Generator
) -> None:
    stand = standing_arm(name, base_rpy=np.radians([-45.0, 10.0, 70.0]).tolist())
    arm, (count, joints) = stand.arm, motion_of(stand.arm, rng).q.shape
    q, still = motion_of(arm, rng).q, np.zeros((count, joints))
    held = rigid_efforts(arm, JointMotion(q, still, still, up=stand.up))
    np.testing.assert_allclose(held, holding_efforts(arm, q, -stand.up), atol=1e-12)
    upright = rigid_efforts(arm, JointMotion(q, still, still))
    assert np.abs(held - upright)[:, 1].max() > 0.2


def test_an_arm_of_a_rig_stands_as_the_rig_has_it() -> None:
    alone = standing_arm("psm_si", base_rpy=(np.radians(-45.0), 0.0, 0.0))
    np.testing.assert_allclose(standing_arm(None, rig="psm_si").up, alone.up, atol=1e-12)
    # setup joints turn about the vertical alone, up to the mounting pitch
    for name, lean in (("PSM1", -45.0), ("PSM2", -45.0), ("PSM3", -15.0), ("ECM", -70.0)):
        up = standing_arm(name, rig="full_cart_si").up
        angle = np.radians(lean)
        np.testing.assert_allclose(up, [0.0, np.sin(angle), np.cos(angle)], atol=1e-9)


def test_how_an_arm_stands_is_given_once_and_of_one_arm() -> None:
    with pytest.raises(InputError, match="got a rotation and a rig"):
        standing_arm("PSM1", rig="psm", base_rpy=(0.0, 0.0, 0.0))
    with pytest.raises(
        InputError, match=r"has 4 arms; allowed: the name of one \(--arm\) of PSM1, PSM2"
    ):
        standing_arm(None, rig="full_cart_si")
    with pytest.raises(InputError, match="three finite angles"):
        standing_arm("psm", base_rpy=(0.0, 0.0))
    with pytest.raises(UnknownNameError, match="PSM1"):
        standing_arm("PSM7", rig="psm")


def test_parameters_of_a_body_come_back() -> None:
    for body in load_arm("psm").bodies:
        mass, com, inertia = mass_com_inertia(parameters(body))
        assert mass == pytest.approx(body.mass)
        np.testing.assert_allclose(com, body.com, atol=1e-12)
        np.testing.assert_allclose(inertia, body.inertia, atol=1e-12)
        assert np.linalg.eigvalsh(pseudo_inertia(parameters(body))).min() > -1e-12


@pytest.mark.parametrize("name", ["psm", "mtmr"])
def test_the_simulation_has_every_force_of_the_identified_model(
    name: str, rng: np.random.Generator
) -> None:
    overlay = as_overlay(name)
    assert overlay.dynamics is not None
    arm = load_arm(name, calibration=overlay)
    where = motion_of(arm, rng, 1).q[0]
    time = np.linspace(0.0, 2.0, 200)[:, None]
    rate = 1.0 + np.arange(len(where))
    room = 0.2 * (arm.mechanism.upper - arm.mechanism.lower)
    where = np.clip(where, arm.mechanism.lower + room, arm.mechanism.upper - room)
    motion = JointMotion(
        where + room * np.sin(rate * time),
        room * rate * np.cos(rate * time),
        -room * rate**2 * np.sin(rate * time),
    )
    found = predicted_efforts(arm, overlay.dynamics.drivetrains, motion)
    model = build(lone_arm_rig(arm))
    mj, data, joints = model.mj, mujoco.MjData(model.mj), model.joints
    drives = drives_of(model.rig, joints, mj, "identified")
    assert drives is not None
    springs = Springs(spring_fields(mj), np.zeros(drives.elements))
    drives.begin(joints.couple @ motion.q[0], springs)
    tendons = drives.coordinates[len(drives.coordinates) - mj.ntendon :]
    for k in range(len(motion.q)):
        data.qpos[:] = joints.couple @ motion.q[k]
        data.qvel[:] = joints.couple @ motion.qd[k]
        data.qacc[:] = joints.couple @ motion.qdd[k]
        drives.renew(data.qpos, springs)
        mujoco.mj_fwdPosition(mj, data)
        mujoco.mj_fwdVelocity(mj, data)
        force = np.zeros(mj.nv)
        mujoco.mj_rne(mj, data, 1, force)
        force += mj.dof_armature * data.qacc - data.qfrc_passive
        force += mj.dof_frictionloss * np.sign(data.qvel)
        force += tendons.T @ (mj.tendon_armature * (tendons @ data.qacc))
        force += tendons.T @ (mj.tendon_frictionloss * np.sign(tendons @ data.qvel))
        count = arm.own_joints + (not arm.has_gripper) * (len(arm.joints) - arm.own_joints)
        np.testing.assert_allclose(
            (joints.share @ force)[:count], found[k][:count], rtol=1e-9, atol=1e-9
        )
