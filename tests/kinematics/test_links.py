"""Links counted as the dVRK counts them agree with its published tables."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.geometry.dh import modified_dh
from trocar.kinematics.forward import pose
from trocar.kinematics.links import link_pose

Q = np.pi / 2
#: (alpha, a, d, slides, theta at zero). Source: SAW share/kinematic/PSM.json with the tool
#: 400006, and ECM.json.
TABLES = {
    "psm": (
        (Q, 0.0, 0.0, False, Q),
        (-Q, 0.0, 0.0, False, -Q),
        (Q, 0.0, -0.4318, True, 0.0),
        (0.0, 0.0, 0.4162, False, 0.0),
        (-Q, 0.0, 0.0, False, -Q),
        (-Q, 0.0091, 0.0, False, -Q),
    ),
    "ecm": (
        (Q, 0.0, 0.0, False, Q),
        (-Q, 0.0, 0.0, False, -Q),
        (Q, 0.0, -0.3822, True, 0.0),
        (0.0, 0.0, 0.3829, False, 0.0),
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_every_link_is_where_the_table_has_it(name):
    arm, rng = load_arm(name), np.random.default_rng(7)
    q = rng.uniform(arm.mechanism.lower, arm.mechanism.upper)
    T = np.eye(4)
    for k, (alpha, a, d, slides, zero) in enumerate(TABLES[name]):
        shift, turn = (q[k], 0.0) if slides else (0.0, q[k])
        T = T @ modified_dh(a, alpha, d + shift, zero + turn)
        found = link_pose(arm.mechanism, arm.inverse_kinematics, q[: k + 1])
        np.testing.assert_allclose(found, T, atol=1e-12)


@pytest.mark.parametrize("name", ["mtml", "suj_psm1"])
def test_links_of_other_arms_are_their_frames(name):
    arm, rng = load_arm(name), np.random.default_rng(8)
    q = rng.uniform(arm.mechanism.lower, arm.mechanism.upper)
    for k in range(1, arm.own_joints + 1):
        whole = np.where(np.arange(len(q)) < k, q, 0.0)
        found = link_pose(arm.mechanism, arm.inverse_kinematics, q[:k])
        np.testing.assert_array_equal(
            found, pose(arm.mechanism, whole, arm.mechanism.joint_names[k - 1])
        )


def test_no_joints_lead_to_the_reference_frame():
    arm = load_arm("psm")
    np.testing.assert_array_equal(link_pose(arm.mechanism, arm.inverse_kinematics, []), np.eye(4))


@pytest.mark.parametrize("q", [[0.0] * 7, [np.nan], [[0.0]]])
def test_what_is_no_part_of_a_joint_vector_is_rejected(q):
    arm = load_arm("psm")
    with pytest.raises(InputError, match="allowed: up to 6 finite numbers"):
        link_pose(arm.mechanism, arm.inverse_kinematics, q)
