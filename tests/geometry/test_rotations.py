"""Rotations: laws, round trips at hard angles, and messages."""

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.geometry import rotations as r

# A few float64 rounding steps: a matrix product of unit numbers, or one trip through a quaternion.
ROUNDING = 2e-15


def random_rotations(rng, n=2000):
    return r.matrix_from_quaternion(rng.standard_normal((n, 4)))


def random_axes(rng, n=2000):
    axes = rng.standard_normal((n, 3))
    return axes / np.linalg.norm(axes, axis=-1, keepdims=True)


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def test_products_and_transposes_of_rotations_are_rotations(rng):
    Ra, Rb = random_rotations(rng), random_rotations(rng)
    r.check_rotation(Ra @ Rb)
    assert np.abs(np.swapaxes(Ra, -1, -2) @ Ra - np.eye(3)).max() < ROUNDING
    assert np.abs(np.linalg.det(Ra) - 1).max() < ROUNDING


@pytest.mark.parametrize(
    ("turn", "of", "to"), [(r.rotation_x, 1, 2), (r.rotation_y, 2, 0), (r.rotation_z, 0, 1)]
)
def test_a_quarter_turn_about_an_axis_takes_the_next_axis_to_the_one_after(turn, of, to):
    assert np.allclose(turn(np.pi / 2) @ np.eye(3)[of], np.eye(3)[to], atol=1e-16)


def test_turns_about_one_axis_add_up(rng):
    a, b = rng.uniform(-4, 4, (2, 50))
    for turn in (r.rotation_x, r.rotation_y, r.rotation_z):
        assert np.abs(turn(a) @ turn(b) - turn(a + b)).max() < ROUNDING


def test_rpy_turns_about_fixed_axes_x_then_y_then_z(rng):
    roll, pitch, yaw = rng.uniform(-3, 3, (3, 20))
    expected = r.rotation_z(yaw) @ r.rotation_y(pitch) @ r.rotation_x(roll)
    assert np.abs(r.matrix_from_rpy(roll, pitch, yaw) - expected).max() == 0.0
    # Fixed axes: a turn of the x axis by yaw alone, whatever the roll.
    assert np.allclose(r.matrix_from_rpy(0.7, 0.0, 0.3)[:, 0], [np.cos(0.3), np.sin(0.3), 0])


def test_rpy_is_read_back_from_its_matrix(rng):
    rpy = rng.uniform(-1, 1, (3, 1000)) * np.array([[np.pi], [np.pi / 2], [np.pi]])
    assert np.abs(r.rpy_from_matrix(r.matrix_from_rpy(*rpy)).T - rpy).max() < 1e-12


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_upright_pitch_leaves_no_yaw_but_the_same_matrix(pitch):
    R = r.matrix_from_rpy(0.7, pitch, 0.3)
    rpy = r.rpy_from_matrix(R)
    assert rpy[2] == 0.0
    assert np.abs(r.matrix_from_rpy(*rpy) - R).max() < ROUNDING


def test_skew_is_the_cross_product(rng):
    a, b = rng.standard_normal((2, 30, 3))
    assert np.abs((r.skew(a) @ b[..., None])[..., 0] - np.cross(a, b)).max() < ROUNDING


def test_unskew_undoes_skew_and_leaves_out_what_is_symmetric(rng):
    v, K = rng.standard_normal((30, 3)), rng.standard_normal((30, 3, 3))
    symmetric = K + np.swapaxes(K, -1, -2)
    assert np.abs(r.unskew(r.skew(v) + symmetric) - v).max() < ROUNDING


def test_quaternions_return_through_the_matrix_to_rounding(rng):
    q = rng.standard_normal((5000, 4))
    q[:4000] *= 10.0 ** rng.uniform(-12, 0, (4000, 4))  # near every axis and near half turns
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    back = r.quaternion_from_matrix(r.matrix_from_quaternion(q))
    error = np.minimum(np.abs(back - q).max(-1), np.abs(back + q).max(-1))
    assert error.max() < 1e-15
    assert (back[:, 0] >= 0).all()


def test_one_rotation_is_converted_as_a_row_of_many(rng):
    R = random_rotations(rng)
    R = np.concatenate(
        [R, np.eye(3)[None], np.diag([1.0, -1, -1])[None], np.diag([-1.0, 1, -1])[None]]
    )
    q = r.quaternion_from_matrix(R)
    back = r.matrix_from_quaternion(q)
    for k in range(len(R)):
        for one in (slice(k, k + 1), k):
            assert np.abs(r.quaternion_from_matrix(R[one]) - q[one]).max() < 4e-16
            assert np.abs(r.matrix_from_quaternion(q[one]) - back[one]).max() < 4e-16
            assert r.matrix_from_quaternion(q[one]).shape == R[one].shape


def test_quaternion_of_a_small_turn_keeps_its_relative_digits():
    for angle in (1e-3, 1e-8, 1e-15, 1e-200):
        q = r.quaternion_from_matrix(r.matrix_from_rotation_vector([0, angle, 0]))
        assert q[2] == pytest.approx(np.sin(angle / 2), rel=1e-15)


def test_half_turns_choose_the_positive_axis():
    for axis in ([1, 0, 0], [0, 1, 0], [0, 0, 1]):
        R = r.matrix_from_quaternion([0, *axis])
        assert r.quaternion_from_matrix(R).tolist() == [0, *axis]


def test_quaternion_need_not_be_of_unit_length(rng):
    q = rng.standard_normal(4)
    assert np.allclose(r.matrix_from_quaternion(q), r.matrix_from_quaternion(-7 * q), atol=1e-15)


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 0.5])
def test_rotation_vectors_return_at_angles_near_zero_and_near_pi(rng, gap):
    axes = random_axes(rng)
    for angle in (gap, np.pi - gap):
        back = r.rotation_vector_from_matrix(r.matrix_from_rotation_vector(axes * angle))
        error = np.linalg.norm(back - axes * angle, axis=-1)
        if np.pi - angle < 1e-14:  # there v and -v are the same turn
            error = np.minimum(error, np.linalg.norm(back + axes * angle, axis=-1))
        assert error.max() < 4e-15


def test_many_rotation_vectors_make_the_matrices_of_each_alone_to_the_last_bit(rng):
    drawn, still = rng.standard_normal((200, 3)), np.zeros((2, 3))
    v = np.concatenate([drawn, 1e-9 * drawn, still])
    alone = [r.matrix_from_rotation_vector(one) for one in v]
    np.testing.assert_array_equal(r.matrices_from_rotation_vectors(v), alone)
    assert r.matrices_from_rotation_vectors(still[:0]).shape == (0, 3, 3)


def test_small_rotation_vectors_return_with_relative_precision(rng):
    v = random_axes(rng) * 10.0 ** rng.uniform(-250, -1, (2000, 1))
    back = r.rotation_vector_from_matrix(r.matrix_from_rotation_vector(v))
    assert (np.abs(back - v).max(-1) <= 1e-14 * np.linalg.norm(v, axis=-1)).all()


def test_exponential_solves_its_differential_equation(rng):
    axis, h = random_axes(rng, 20), 1e-5
    for angle in (0.0, 1e-4, 0.3, 3.1):
        step = r.matrix_from_rotation_vector(axis * (angle + h))
        back = r.matrix_from_rotation_vector(axis * (angle - h))
        here = r.matrix_from_rotation_vector(axis * angle)
        # Central difference: h^2 / 6 = 2e-11 of truncation, 1e-16 / h = 1e-11 of rounding.
        assert np.abs((step - back) / (2 * h) - r.skew(axis) @ here).max() < 1e-10


def test_angle_between_sees_tiny_and_half_turns(rng):
    R, axes = random_rotations(rng), random_axes(rng)
    for angle in (0.0, 1e-13, 1e-9, 1.0, np.pi - 1e-9, np.pi):
        other = R @ r.matrix_from_rotation_vector(axes * angle)
        assert np.abs(r.angle_between(R, other) - angle).max() < 4e-15


def test_leading_axes_broadcast(rng):
    R = random_rotations(rng, 6).reshape(2, 3, 3, 3)
    assert r.rotation_vector_from_matrix(R).shape == (2, 3, 3)
    assert r.quaternion_from_matrix(R).shape == (2, 3, 4)
    assert r.angle_between(R, np.eye(3)).shape == (2, 3)
    assert r.rotation_z(0.1).shape == (3, 3)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.eye(4), r"rotation: expected shape \(..., 3, 3\), got \(4, 4\)"),
        (np.full((3, 3), np.nan), "rotation: expected finite numbers, got"),
        (
            1.001 * np.eye(3),
            "rotation: not orthonormal, R\\^T R differs from the identity by 0.002",
        ),
        (np.diag([1, 1, -1]), "rotation: a reflection"),
    ],
)
def test_check_rotation_says_what_is_wrong(bad, message):
    with pytest.raises(InputError, match=message):
        r.check_rotation(bad)


def test_check_rotation_takes_float32_and_gives_float64(rng):
    R = random_rotations(rng).astype(np.float32)
    assert r.check_rotation(R).dtype == np.float64


@pytest.mark.parametrize(
    ("bad", "message"),
    [([0, 0, 0, 0], "non-zero length"), ([np.nan, 0, 0, 0], "finite"), ([1, 0, 0], "shape")],
)
def test_bad_quaternions_are_rejected(bad, message):
    with pytest.raises(InputError, match=message):
        r.matrix_from_quaternion(bad)


def test_no_rotation_is_nearer_to_a_matrix_than_the_nearest(rng):
    M, quaternions = rng.normal(size=(50, 3, 3)), rng.normal(size=(200, 1, 4))
    quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    R = r.check_rotation(r.nearest_rotation(M))
    others = r.matrix_from_quaternion(quaternions)
    far = np.linalg.norm(others - M, axis=(2, 3))
    assert (np.linalg.norm(R - M, axis=(1, 2)) <= far.min(axis=0)).all()
    np.testing.assert_allclose(r.nearest_rotation(3.0 * R), R, atol=1e-12)
