"""Actuators and joints: round trips, power, published forms."""

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.kinematics import coupling as c

# Large Needle Driver, discs to (roll, wrist pitch, wrist yaw, jaw): facts section 1.
DRIVER = c.Coupling(
    np.array(
        [
            [-1.5632, 0.0, 0.0, 0.0],
            [0.0, 1.0186, 0.0, 0.0],
            [0.0, -0.8306, 0.6089, 0.6089],
            [0.0, 0.0, -1.2177, 1.2177],
        ]
    )
)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def test_actuators_return_through_the_joints(rng):
    x = rng.standard_normal((7, 5, 4))
    assert np.abs(c.actuator_from_joint(DRIVER, c.joint_from_actuator(DRIVER, x)) - x).max() < 1e-14
    there = c.actuator_effort_from_joint(DRIVER, x)
    assert np.abs(c.joint_effort_from_actuator(DRIVER, there) - x).max() < 1e-14


def test_power_is_the_same_on_both_sides(rng):
    velocity, effort = rng.standard_normal((2, 50, 4))
    actuator_power = np.sum(effort * velocity, axis=-1)
    joint_velocity = c.joint_from_actuator(DRIVER, velocity)
    joint_effort = c.joint_effort_from_actuator(DRIVER, effort)
    assert np.abs(np.sum(joint_effort * joint_velocity, axis=-1) - actuator_power).max() < 1e-13


def test_one_disc_turns_one_finger():
    # Wang's form of the same coupling: finger = -0.8306 m5 + 1.2178 m6 (facts section 1).
    for disc, side in ((2, -0.5), (3, 0.5)):
        joints = c.joint_from_actuator(DRIVER, np.eye(4)[disc])
        assert joints[2] + side * joints[3] == pytest.approx(1.2178, abs=1e-4)
        assert joints[2] - side * joints[3] == pytest.approx(0.0, abs=1e-4)
    assert c.joint_from_actuator(DRIVER, [0, 1, 0, 0]).tolist() == [0, 1.0186, -0.8306, 0]


def test_efforts_go_by_the_transpose():
    # 1 N m about the wrist yaw axis loads the wrist pitch disc and both finger discs: row 3 of A.
    expected = [0.0, -0.8306, 0.6089, 0.6089]
    assert c.actuator_effort_from_joint(DRIVER, [0, 0, 1, 0]).tolist() == expected


def test_matrices_are_kept_as_read_only_copies():
    matrix = np.eye(2)
    kept = c.Coupling(matrix)
    matrix[0, 0] = 9.0
    assert kept.actuator_to_joint[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        kept.joint_to_actuator[0, 0] = 9.0


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.ones((2, 3)), r"expected a square matrix, got shape \(2, 3\)"),
        (np.zeros((0, 0)), "expected a square matrix"),
        (np.full((2, 2), np.nan), "expected finite numbers"),
        (np.ones((2, 2)), "expected an invertible matrix, got condition"),
    ],
)
def test_matrices_that_cannot_couple_are_rejected(matrix, message):
    with pytest.raises(InputError, match=message):
        c.Coupling(matrix)


@pytest.mark.parametrize(
    "convert",
    [
        c.joint_from_actuator,
        c.actuator_from_joint,
        c.joint_effort_from_actuator,
        c.actuator_effort_from_joint,
    ],
)
def test_values_of_another_length_are_rejected(convert):
    with pytest.raises(InputError, match=r"expected 4 values along the last axis, got \(3,\)"):
        convert(DRIVER, [1.0, 2.0, 3.0])
