"""Rows of trained policies as figures."""

import pytest

pytest.importorskip("stable_baselines3", reason="training actors needs Stable-Baselines3")

from benchmarks.learning import figures


def test_goals_are_bounds() -> None:
    least, most, printed = figures(
        [("a", 0.9, "", ">= 0.95"), ("b", 3.0, "s", "<= 4"), ("c", 1.0, "", "")]
    )
    assert (least.lower, least.upper, least.met) == (0.95, None, False)
    assert (most.lower, most.upper, most.met) == (None, 4.0, True)
    assert printed.met is None


def test_a_goal_that_is_none_is_an_error() -> None:
    with pytest.raises(ValueError, match="a: got the goal '95'; allowed: >= and <= with a number"):
        figures([("a", 0.9, "", "95")])


def test_what_is_not_measured_is_not_missed() -> None:
    (row,) = figures([("a", None, "/s", ">= 345000")])
    assert row.met is None
    assert row.text(row.value) == "-"


def test_a_number_is_a_bound_and_printed_is_none() -> None:
    bound, printed = figures([("a", 30.0, "%", 20.0), ("b", 30.0, "%", "printed")])
    assert (bound.upper, bound.met) == (20.0, False)
    assert printed.met is None
