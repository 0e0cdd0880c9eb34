"""Limits, whole turns and order of solutions."""

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.kinematics import solutions as s

LIMITS = s.joint_range(("turn", "slide"), (False, True), [-4.5, 0.0], [4.5, 0.2])


def test_turning_joints_are_unwound_and_sliding_ones_are_not():
    found = s.inside(np.array([[21.0, 0.1], [0.0, 0.1 + 2 * np.pi]]), LIMITS)
    assert np.allclose(np.sort(found[:, 0]), [21 - 8 * np.pi, 21 - 6 * np.pi])
    assert (found[:, 1] == 0.1).all()


def test_a_long_slide_is_not_taken_for_turns():
    long = s.joint_range(("slide",), (True,), [0.0], [20.0])
    assert s.inside(np.array([[1.0]]), long).tolist() == [[1.0]]


def test_rounding_beyond_a_limit_is_set_to_the_limit():
    found = s.inside(np.array([[1.0, 0.2 + 9e-10], [1.0, -9e-10], [1.0, 0.2 + 2e-9]]), LIMITS)
    assert found[:, 1].tolist() == [0.2, 0.0]


def test_nearness_counts_in_shares_of_each_joint_s_range():
    both = np.array([[0.0, 0.02], [0.7, 0.0]])  # 0.02 is a tenth of the slide, 0.7 less of the turn
    assert s.nearest_first(both, LIMITS, [0.0, 0.0])[0].tolist() == [0.7, 0.0]
    assert s.nearest_first(both, LIMITS, None)[0].tolist() == [0.0, 0.02]


@pytest.mark.parametrize("rounding", [-1e-15, 0.0, 1e-15])
def test_of_solutions_equally_near_the_larger_comes_first(rounding):
    both = np.array([[-np.pi - rounding, 0.1], [np.pi, 0.1]])
    for some in (both, both[::-1]):
        assert s.nearest_first(some, LIMITS, None)[0, 0] == np.pi
    assert s.nearest_turn(np.pi + rounding, 0.0, (-4.5, 4.5)) == pytest.approx(np.pi)
    assert s.nearest_turn(-np.pi + rounding, 0.0, (-4.5, 4.5)) == pytest.approx(np.pi)


@pytest.mark.parametrize("rounding", [-1e-15, 0.0, 1e-15])
def test_a_joint_as_far_from_either_limit_is_reported_from_the_upper(rounding):
    narrow = s.joint_range(("turn",), (False,), [-1.0], [1.0])
    for q in (np.pi, -np.pi):
        error = s.out_of_limits(np.array([[q + rounding]]), narrow)
        assert "upper limit" in str(error)


def test_a_joint_without_range_does_not_spoil_the_order():
    held = s.joint_range(("turn", "held"), (False, False), [-4, 1], [4, 1])
    assert s.nearest_first(np.array([[2.0, 1], [1.0, 1]]), held, [0, 0])[0].tolist() == [1, 1]


def test_solutions_that_are_there_twice_are_given_once():
    twice = np.array([[1.0, 0.1], [2.0, 0.1], [1.0 + 1e-12, 0.1]])
    assert len(s.nearest_first(twice, LIMITS, None)) == 2


def test_the_candidate_that_misses_least_is_reported():
    error = s.out_of_limits(np.array([[0.0, 0.5], [0.0, 0.21], [0.0, -0.3]]), LIMITS)
    assert error.excess == {"slide": pytest.approx(0.01)}
    assert str(error) == ("pose out of reach: slide 0.21 m is beyond its upper limit 0.2 by 0.01")


def test_a_turning_joint_is_reported_from_the_limit_that_is_nearer():
    narrow = s.joint_range(("turn",), (False,), [-1.0], [1.0])
    assert s.out_of_limits(np.array([[4.0]]), narrow).excess == {
        "turn": pytest.approx(2 * np.pi - 5.0)
    }


def test_some_joints_can_be_asked_for_alone():
    q = np.array([[0.0, 0.5]])
    assert s.some_inside(q, LIMITS, (0,))
    assert not s.some_inside(q, LIMITS, (1,))
    assert not s.some_inside(q[:0], LIMITS, (0,))


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ([0.0], [1.0, 1.0], r"expected 2 joints \(a, b\), got \(1,\) and \(2,\)"),
        ([0.0, 2.0], [1.0, 1.0], "b: expected finite lower <= upper, got 2 and 1"),
        ([np.nan, 0.0], [1.0, 1.0], "a: expected finite lower <= upper, got nan and 1"),
        ([0.0, 0.0], [1.0, np.inf], "b: expected finite lower <= upper, got 0 and inf"),
    ],
)
def test_bad_limits_are_rejected(lower, upper, message):
    with pytest.raises(InputError, match=message):
        s.joint_range(("a", "b"), (False, False), lower, upper)
