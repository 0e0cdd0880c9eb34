"""Identifying simulated arms of an Si returns what they were made with."""

from __future__ import annotations

import pytest

from benchmarks.si_round_trip import si_round_trip


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "least", "least_held"), [("psm_si", 105, 90), ("ecm_si", 46, 43)])
def test_every_identifiable_parameter_of_an_si_returns_within_two_per_cent(
    rig: str, least: int, least_held: int
) -> None:
    """Identifiable is a base parameter whose predicted standard error is below 1 %."""
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    figures = si_round_trip((rig,))
    for (median, within, farthest), known in zip(
        (figures[:3], figures[3:]), (least, least_held), strict=True
    ):
        assert within.value == 100.0, within
        assert farthest.value < 2.0, farthest
        assert median.value < 0.05, median
        assert int(median.name.split(" of ")[0].rpartition(" ")[2]) >= known, median
