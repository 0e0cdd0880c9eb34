"""Tip errors of the presets."""

from __future__ import annotations

import pytest

from benchmarks.errors import BOUNDS, errors, tip_error


@pytest.mark.slow
def test_the_tip_is_off_by_what_was_measured_on_real_robots() -> None:
    figures = errors(seeds=4, poses=3)
    assert [figure.name.split()[1].rstrip(":") for figure in figures] == list(BOUNDS)
    assert all(figure.met for figure in figures), figures


def test_the_tip_error_depends_on_the_seed_alone() -> None:
    assert tip_error("lab", 1, 2) == tip_error("lab", 1, 2)
    assert tip_error("lab", 1, 2) == pytest.approx(3e-3, abs=2.5e-3)
