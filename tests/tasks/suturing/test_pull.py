"""Straight pulls of a thread."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.geometry.se3 import transform
from trocar.tasks.suturing.pull import Pull


def pull(start: NDArray[np.float64], way: NDArray[np.float64]) -> Pull:
    """Return a pull of 0.1 m without a turn."""
    return Pull(transform(np.eye(3), start), way / np.linalg.norm(way), np.zeros(3), 0.1)


@pytest.mark.parametrize("seed", range(5))
def test_a_pull_after_a_blocked_one_ends_as_far_from_the_wound(seed: int):
    rng = np.random.default_rng(seed)
    first = pull(rng.normal(size=3), rng.normal(size=3))
    there = first.pose(rng.uniform(0.0, 0.1))[:3, 3]
    other = pull(there, rng.normal(size=3)).continuing(first)
    end = other.pose(other.length)[:3, 3]
    assert np.linalg.norm(end - first.start[:3, 3]) == pytest.approx(0.1, abs=1e-12)
    assert first.continuing(first).length == pytest.approx(0.1, abs=1e-12)


def test_a_pull_beyond_the_end_of_a_blocked_one_has_no_length_left():
    first = pull(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    assert (
        pull(np.array([0.2, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])).continuing(first).length == 0.0
    )
