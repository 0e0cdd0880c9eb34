"""Poses and twists: laws of the group, round trips, finite differences, messages."""

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.geometry import rotations, se3

# Rounding of products of matrices whose positions are a few units long.
ROUNDING = 2e-14


def random_poses(rng, n=500):
    R = rotations.matrix_from_quaternion(rng.standard_normal((n, 4)))
    return se3.transform(R, rng.standard_normal((n, 3)))


@pytest.fixture
def rng():
    return np.random.default_rng(2)


def test_products_of_poses_are_poses(rng):
    se3.check_transform(random_poses(rng) @ random_poses(rng))


def test_inverse_undoes_a_pose_from_both_sides(rng):
    T = random_poses(rng)
    assert np.abs(T @ se3.inverse(T) - np.eye(4)).max() < ROUNDING
    assert np.abs(se3.inverse(T) @ T - np.eye(4)).max() < ROUNDING


def test_composition_is_associative_and_reverses_under_inverse(rng):
    A, B, C = random_poses(rng), random_poses(rng), random_poses(rng)
    assert np.abs((A @ B) @ C - A @ (B @ C)).max() < ROUNDING
    assert np.abs(se3.inverse(A @ B) - se3.inverse(B) @ se3.inverse(A)).max() < ROUNDING


def test_points_move_as_the_matrix_says(rng):
    T, p = random_poses(rng), rng.standard_normal((500, 3))
    by_hand = (T @ np.concatenate([p, np.ones((500, 1))], -1)[..., None])[..., :3, 0]
    assert np.abs(se3.transform_points(T, p) - by_hand).max() < ROUNDING
    assert se3.transform_points(se3.translation([1, 2, 3]), [1, 1, 1]).tolist() == [2, 3, 4]


@pytest.mark.parametrize("angle", [0, 1e-12, 1e-8, 1e-4, 0.0099, 0.0101, 1, 3, np.pi - 1e-9])
def test_twists_return_through_the_pose(rng, angle):
    axes = rng.standard_normal((300, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    xi = np.concatenate([rng.standard_normal((300, 3)), axes * angle], -1)
    assert np.abs(se3.log_transform(se3.exp_twist(xi)) - xi).max() < ROUNDING


def test_poses_return_through_the_twist_also_at_half_turns(rng):
    T = random_poses(rng)
    T[:100, :3, :3] = rotations.matrix_from_quaternion(
        np.concatenate([np.zeros((100, 1)), rng.standard_normal((100, 3))], -1)
    )
    assert np.abs(se3.exp_twist(se3.log_transform(T)) - T).max() < ROUNDING


def test_exponential_solves_its_differential_equation(rng):
    xi = rng.standard_normal((50, 6))
    twist = np.zeros((50, 4, 4))
    twist[:, :3, :3] = rotations.skew(xi[:, 3:])
    twist[:, :3, 3] = xi[:, :3]
    h = 1e-5
    for t in (0.0, 1e-3, 0.02, 1.0):
        slope = (se3.exp_twist(xi * (t + h)) - se3.exp_twist(xi * (t - h))) / (2 * h)
        # Central difference: h^2 |xi|^3 / 6 of truncation, below 4e-9 for these twists.
        assert np.abs(slope - twist @ se3.exp_twist(xi * t)).max() < 4e-9


def test_pose_residuals_are_the_shift_and_turn_that_were_applied(rng):
    expected = se3.exp_twist(rng.standard_normal((50, 6)))
    shift, turn = rng.standard_normal((2, 50, 3))
    for size in (1.0, 1e-6, 0.0):
        measured = expected.copy()
        measured[:, :3, 3] += size * shift
        rotation = rotations.matrix_from_rotation_vector(size * turn)
        measured[:, :3, :3] = rotation @ expected[:, :3, :3]
        found = se3.pose_residuals(measured, expected)
        # Rounding of unit numbers; turns of up to 3 rad lose a digit near a half turn.
        assert np.abs(found - size * np.hstack([shift, turn])).max() < 1e-13


def test_adjoint_carries_twists_between_frames(rng):
    T, xi = random_poses(rng), 0.5 * rng.standard_normal((500, 6))
    carried = (se3.adjoint(T) @ xi[..., None])[..., 0]
    expected = T @ se3.exp_twist(xi) @ se3.inverse(T)
    assert np.abs(se3.exp_twist(carried) - expected).max() < ROUNDING


def test_adjoint_of_a_product_is_the_product_of_adjoints(rng):
    A, B = random_poses(rng), random_poses(rng)
    assert np.abs(se3.adjoint(A @ B) - se3.adjoint(A) @ se3.adjoint(B)).max() < ROUNDING


def test_pose_difference_measures_shift_and_turn(rng):
    T = random_poses(rng)
    step = se3.transform(rotations.rotation_y(0.25), [0.003, 0, 0.004])
    metres, radians = se3.pose_difference(T, T @ step)
    assert np.abs(metres - 0.005).max() < ROUNDING
    assert np.abs(radians - 0.25).max() < ROUNDING


def test_leading_axes_broadcast(rng):
    T = random_poses(rng, 6).reshape(2, 3, 4, 4)
    assert se3.log_transform(T).shape == (2, 3, 6)
    assert se3.adjoint(T).shape == (2, 3, 6, 6)
    assert se3.transform(np.eye(3), np.zeros((5, 3))).shape == (5, 4, 4)
    assert se3.transform_points(T[0, 0], np.zeros((7, 3))).shape == (7, 3)


def test_inputs_are_not_written_to(rng):
    T = random_poses(rng, 3)
    T.setflags(write=False)
    se3.exp_twist(se3.log_transform(se3.inverse(T)))
    assert not np.shares_memory(se3.transform(T[:, :3, :3], T[:, :3, 3]), T)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.eye(3), r"pose: expected shape \(..., 4, 4\), got \(3, 3\)"),
        (np.full((4, 4), np.inf), "pose: expected finite numbers"),
        (2 * np.eye(4), r"pose: expected last row \(0, 0, 0, 1\), got \[0.0, 0.0, 0.0, 2.0\]"),
        (np.diag([2, 1, 1, 1]), "pose: rotation part: not orthonormal"),
        (np.diag([1, -1, 1, 1]), "pose: rotation part: a reflection"),
    ],
)
def test_check_transform_says_what_is_wrong(bad, message):
    with pytest.raises(InputError, match=message):
        se3.check_transform(bad)
