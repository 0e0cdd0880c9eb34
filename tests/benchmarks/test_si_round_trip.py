"""Identifying simulated arms of an Si returns what they were made with."""

from __future__ import annotations

import pytest

from benchmarks.si_round_trip import si_round_trip


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "least"), [("psm_si", 50), ("ecm_si", 15)])
def test_identifiable_parameters_of_an_si_return_within_two_percent(rig: str, least: int) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    found = si_round_trip((rig,))
    assert [figure.name for figure in found if figure.met is not True] == []
    assert int(found[0].name.split(" base parameters")[0].rpartition(" ")[2]) >= least
