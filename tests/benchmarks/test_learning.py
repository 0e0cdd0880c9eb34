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
