"""The quick inverse is the first of all solutions."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.errors import SingularError, UnreachableError
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import inverse_kinematics, nearest_solution

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
