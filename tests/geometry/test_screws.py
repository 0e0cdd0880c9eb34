"""Screws against rotations, and points nearest to lines."""

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.geometry import rotations, screws, se3

ROUNDING = 1e-14


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_a_hinge_turns_about_its_line(rng):
    point, axis = rng.standard_normal((2, 40, 3))
    amount = rng.uniform(-3, 3, 40)
    moved = screws.screw_motion(screws.revolute_screw(point, axis), amount)
    unit = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    R = rotations.matrix_from_rotation_vector(unit * amount[:, None])
    there, back = se3.translation(point), se3.translation(-point)
    expected = there @ se3.transform(R, np.zeros(3)) @ back
    assert np.abs(moved - expected).max() < ROUNDING
    along = point + 0.7 * unit
    assert np.abs(se3.transform_points(moved, along) - along).max() < ROUNDING


def test_a_slide_moves_along_its_direction():
    T = screws.screw_motion(screws.prismatic_screw([0, 0, 5]), 0.3)
    assert np.abs(T - se3.translation([0, 0, 0.3])).max() == 0.0


def test_motions_along_one_screw_add_up(rng):
    screw = screws.revolute_screw(rng.standard_normal(3), rng.standard_normal(3))
    two = screws.screw_motion(screw, 0.4) @ screws.screw_motion(screw, -1.1)
    assert np.abs(two - screws.screw_motion(screw, -0.7)).max() < ROUNDING


def test_distance_from_a_line_is_perpendicular():
    assert screws.point_line_distance([3, 4, 9], [0, 0, -2], [0, 0, 8]) == pytest.approx(5.0)
    many = screws.point_line_distance(np.zeros((5, 3)), [[1.0, 0, 0]], [[0.0, 1, 0]])
    assert many.shape == (5,)


def test_lines_through_one_point_find_it_wherever_it_is(rng):
    for where in (0.0, 1000.0):
        point = rng.standard_normal(3) + where
        directions = rng.standard_normal((20, 3))
        starts = point + rng.uniform(-1, 1, (20, 1)) * directions
        found, rms = screws.nearest_point_to_lines(starts, directions)
        assert np.abs(found - point).max() < 1e-14 * max(1.0, 100 * where)
        assert rms < 1e-14 * max(1.0, 100 * where)


def test_two_skew_lines_meet_halfway():
    found, rms = screws.nearest_point_to_lines([[0, 0, 1], [0, 0, -1]], [[1, 0, 0], [0, 1, 0]])
    assert np.abs(found).max() < ROUNDING
    assert rms == pytest.approx(1.0)


def test_nearest_point_has_the_least_sum_of_squares(rng):
    points, directions = rng.standard_normal((2, 10, 3))
    found, rms = screws.nearest_point_to_lines(points, directions)
    for step in 1e-3 * np.concatenate([np.eye(3), -np.eye(3)]):
        other = np.mean(screws.point_line_distance(found + step, points, directions) ** 2)
        assert np.sqrt(other) > rms


@pytest.mark.parametrize(
    ("points", "directions", "message"),
    [
        (np.zeros((2, 2)), np.zeros((2, 2)), r"shape \(n, 3\), got \(2, 2\)"),
        (np.zeros((1, 3)), np.ones((1, 3)), "expected at least two, got 1"),
        (np.eye(3), np.ones((3, 3)), "all are parallel"),
        (
            np.zeros((2, 3)),
            np.zeros((2, 3)),
            "direction: expected a finite vector of non-zero length",
        ),
    ],
)
def test_lines_without_a_nearest_point_are_rejected(points, directions, message):
    with pytest.raises(InputError, match=message):
        screws.nearest_point_to_lines(points, directions)
