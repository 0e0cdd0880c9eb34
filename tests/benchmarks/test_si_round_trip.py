"""Identifying simulated arms of an Si returns what they were made with."""

from __future__ import annotations

import pytest

from benchmarks.si_round_trip import si_round_trip


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "least"), [("psm_si", 95), ("ecm_si", 42)])
def test_every_identifiable_parameter_of_an_si_returns_within_two_per_cent(
    rig: str, least: int
) -> None:
    """Identifiable is a base parameter whose predicted standard error is below 1 %."""
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    median, within, farthest = si_round_trip((rig,))
    assert within.value == 100.0
    assert farthest.value < 2.0
    assert median.value < 0.05
    assert int(median.name.split(" of ")[0].rpartition(" ")[2]) >= least
