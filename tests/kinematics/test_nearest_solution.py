"""The quick inverse is the first of all solutions."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.errors import SingularError, UnreachableError
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.closed_form import fit_chain
from trocar.kinematics.inverse import inverse_kinematics, nearest_solution, nearest_solutions

RIG = "full_cart"


@pytest.mark.parametrize("name", ["PSM1", "PSM3", "ECM"])
def test_the_nearest_solution_is_the_first_of_all(name, rng, random_positions):
    arm = load_rig(RIG).arm(name).arm
    mechanism, structure = arm.mechanism, arm.inverse_kinematics
    q = random_positions(arm, rng, 200)
    own = arm.own_joints
    seeds = q[:, :own] + 0.2 * rng.standard_normal((len(q), own)) * [1, 1, 0.1, 1, 1, 1][:own]
    for at, seed in zip(chain_pose(mechanism)(q), seeds, strict=True):
        try:
            expected = inverse_kinematics(mechanism, structure, at, seed)[0]
        except SingularError:
            with pytest.raises(SingularError):
                nearest_solution(mechanism, structure, at, seed)
            continue
        found = nearest_solution(mechanism, structure, at, seed)
        np.testing.assert_allclose(found, expected, atol=1e-11)


@pytest.mark.parametrize("pitch", [0.0, 0.3, np.pi / 4])
def test_rounding_does_not_decide_between_solutions_that_are_equally_near(pitch):
    arm = load_rig(RIG).arm("PSM1").arm
    at = chain_pose(arm.mechanism)(np.array([0.0, pitch, 0.1, np.pi, 0.0, 0.0, 0.0]))
    rng, middle = np.random.default_rng(0), np.zeros(6)
    for _ in range(10):
        again = at.copy()
        again[:3] += 1e-16 * rng.normal(size=(3, 4))
        for found in (
            inverse_kinematics(arm.mechanism, arm.inverse_kinematics, again)[0],
            nearest_solution(arm.mechanism, arm.inverse_kinematics, again, middle),
        ):
            np.testing.assert_allclose(found, [0.0, pitch, 0.1, np.pi, 0.0, 0.0], atol=1e-9)


def test_a_pose_out_of_reach_is_rejected_with_the_reason():
    arm = load_rig(RIG).arm("PSM1").arm
    far = chain_pose(arm.mechanism)(np.array([0.1, 0.1, 0.24, 0, 0, 0, 0]))
    far = far.copy()
    far[:3, 3] *= 2.0
    with pytest.raises(UnreachableError, match="insertion"):
        nearest_solution(arm.mechanism, arm.inverse_kinematics, far, np.zeros(6))


def test_a_calibrated_arm_comes_back_to_its_pose(skew_overlay, rng):
    from trocar.descriptions.calibrated import calibrated_rig

    rig = calibrated_rig(load_rig("psm"), skew_overlay("psm", rng))
    arm = rig.arm("PSM1").arm
    q = np.array([0.2, -0.3, 0.15, 0.4, 0.3, -0.2, 0.0])
    at = chain_pose(arm.mechanism)(q)
    found = nearest_solution(arm.mechanism, arm.inverse_kinematics, at, q[:6])
    np.testing.assert_allclose(found, q[:6], atol=1e-8)


@pytest.mark.parametrize("name", ["PSM1", "ECM"])
def test_many_poses_have_the_solutions_that_each_has_alone_to_the_last_bit(
    name, rng, random_positions
):
    arm = load_rig(RIG).arm(name).arm
    mechanism, structure, own = arm.mechanism, arm.inverse_kinematics, arm.own_joints
    q = random_positions(arm, rng, 1500)
    q[:200, 3] = np.where(rng.random(200) < 0.5, mechanism.lower[3], mechanism.upper[3])  # limits
    q[200:400, 0] = np.where(rng.random(200) < 0.5, mechanism.lower[0], mechanism.upper[0])
    T = chain_pose(mechanism)(q)
    T[:300, :3, 3] *= rng.uniform(0.3, 1.7, (300, 1))  # some out of reach
    seeds = q[:, :own] + 0.3 * rng.standard_normal((len(q), own)) * [1, 1, 0.1, 4, 1, 1][:own]
    found = nearest_solutions(mechanism, structure, T, seeds)
    reached = 0
    for row, at, seed in zip(found, T, seeds, strict=True):
        try:
            expected = nearest_solution(mechanism, structure, at, seed)
            reached += 1
        except (UnreachableError, SingularError):
            expected = np.full(own, np.nan)
        np.testing.assert_array_equal(row, expected)
    assert 1200 < reached < 1500


@pytest.mark.parametrize("pitch", [0.0, 0.3, np.pi / 4])
def test_of_many_solutions_that_are_equally_near_the_same_is_taken(pitch):
    arm = load_rig(RIG).arm("PSM1").arm
    q = np.array([0.0, pitch, 0.1, np.pi, 0.0, 0.0, 0.0])
    T = np.tile(chain_pose(arm.mechanism)(q), (10, 1, 1))
    T[:, :3] += 1e-16 * np.random.default_rng(0).normal(size=(10, 3, 4))
    found = nearest_solutions(arm.mechanism, arm.inverse_kinematics, T, np.zeros((10, 6)))
    np.testing.assert_allclose(found, np.tile(q[:6], (10, 1)), atol=1e-9)


def test_singular_poses_among_many_have_the_solution_that_they_have_alone():
    arm = load_rig(RIG).arm("PSM1").arm
    depth = fit_chain(arm.mechanism, arm.inverse_kinematics).chain.depth
    q = np.array([[0, 0, insertion, 0.2, 0.1, 0, 0] for insertion in (-depth, 0.1)])
    T = chain_pose(arm.mechanism)(q)  # of the first, the wrist is in the remote centre
    found = nearest_solutions(arm.mechanism, arm.inverse_kinematics, T, np.zeros((2, 6)))
    assert np.isnan(found[0]).all() and np.isfinite(found[1]).all()
