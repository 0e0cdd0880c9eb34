"""Identifying from the simulation's own log returns what the simulation was made with."""

from __future__ import annotations

import pytest

from benchmarks.drives import round_trip


@pytest.mark.slow
def test_identifying_a_simulated_log_returns_the_parameters_it_was_made_with() -> None:
    """A standard error of up to 1 % leaves a parameter in twenty farther off than 2 %."""
    pytest.importorskip("clarabel")
    median, within, farthest = (figure.value for figure in round_trip(10.0, 2))
    assert median < 0.5
    assert within >= 95.0
    assert farthest < 5.0
