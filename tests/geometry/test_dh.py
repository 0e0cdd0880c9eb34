"""Denavit-Hartenberg rows against the four elementary motions they are made of."""

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.geometry import dh, rotations, se3


@pytest.fixture
def row():
    rng = np.random.default_rng(4)
    return rng.uniform(-2, 2, (4, 100))


def along(axis, amount):
    return se3.translation(np.eye(3)[axis] * np.asarray(amount)[..., None])


def about(turn, angle):
    return se3.transform(turn(angle), np.zeros(3))


def test_modified_row_is_rx_tx_rz_tz(row):
    a, alpha, d, theta = row
    turn_x, turn_z = about(rotations.rotation_x, alpha), about(rotations.rotation_z, theta)
    expected = turn_x @ along(0, a) @ turn_z @ along(2, d)
    assert np.abs(dh.modified_dh(a, alpha, d, theta) - expected).max() < 1e-15


def test_standard_row_is_rz_tz_tx_rx(row):
    a, alpha, d, theta = row
    turn_x, turn_z = about(rotations.rotation_x, alpha), about(rotations.rotation_z, theta)
    expected = turn_z @ along(2, d) @ along(0, a) @ turn_x
    assert np.abs(dh.standard_dh(a, alpha, d, theta) - expected).max() < 1e-15


def test_constants_broadcast_against_joint_values():
    assert dh.modified_dh(0.1, 0.2, 0.3, np.zeros((2, 5))).shape == (2, 5, 4, 4)
    assert dh.standard_dh(0.1, 0.2, np.zeros(7), 0.0).shape == (7, 4, 4)
    assert dh.standard_dh(0.1, 0.2, 0.3, 0.4).shape == (4, 4)


def test_rows_are_read_back_from_their_poses(row):
    for numbers in row.T:
        modified = dh.modified_dh_parameters(dh.modified_dh(*numbers))
        standard = dh.standard_dh_parameters(dh.standard_dh(*numbers))
        assert np.abs(modified - numbers).max() < 1e-14
        assert np.abs(standard - numbers).max() < 1e-14


def test_a_pose_that_no_row_makes_is_rejected():
    shifted = se3.translation([0.1, 0.2, 0.3])
    for read, name in (
        (dh.modified_dh_parameters, "modified"),
        (dh.standard_dh_parameters, "standard"),
    ):
        with pytest.raises(InputError, match=f"no {name} DH row makes it, .* off by 0.2"):
            read(shifted)
