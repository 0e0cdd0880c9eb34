"""Identifying simulated arms of an Si returns what they were made with."""

from __future__ import annotations

import pytest

from benchmarks.si_round_trip import si_round_trip


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "least"), [("psm_si", 50), ("ecm_si", 15)])
def test_half_of_the_identifiable_parameters_of_an_si_return_within_half_a_per_cent(
    rig: str, least: int
) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    found = si_round_trip((rig,))
    assert (
        found[0].value < 0.5
    )  # the median; the benchmark prints how many are farther off than 2 %
    assert int(found[0].name.split(" base parameters")[0].rpartition(" ")[2]) >= least
