"""Identifying simulated arms of an Si returns what they were made with."""

from __future__ import annotations

import pytest

from benchmarks.si_round_trip import si_round_trip


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "least"), [("psm_si", 50), ("ecm_si", 15)])
def test_identifiable_parameters_of_an_si_return(rig: str, least: int) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    found = si_round_trip((rig,))
    median, within, farthest = (figure.value for figure in found)
    # as of a Classic (test_drives.py): standard errors of up to 1 % leave some farther off
    assert median < 0.5 and within >= 90.0 and farthest < 5.0
    assert int(found[0].name.split(" base parameters")[0].rpartition(" ")[2]) >= least
