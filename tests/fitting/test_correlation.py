"""Noise that is correlated in time widens standard deviations, white noise does not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from trocar.fitting import fit_hinge, fit_pivot, fit_slide
from trocar.fitting.robust import widening
from trocar.geometry import matrix_from_rotation_vector, transform


def slow(rng: np.random.Generator, count: int, samples: float) -> np.ndarray:
    """Return a first-order Gauss-Markov process of unit deviation, (count, 6)."""
    keep = np.exp(-1.0 / samples)
    steps = np.sqrt(1.0 - keep**2) * rng.normal(size=(count, 6))
    steps[0] = rng.normal(size=6)
    return np.asarray(lfilter([1.0], [1.0, -keep], steps, axis=0))


def test_white_noise_is_left_alone() -> None:
    found = [widening(np.random.default_rng(seed).normal(size=(3000, 6))) for seed in range(50)]
    assert found == [1.0] * 50


@pytest.mark.parametrize("samples", [5.0, 30.0, 96.0])
def test_slow_noise_widens_as_its_time_constant_says(samples: float) -> None:
    rng = np.random.default_rng(1)
    found = [widening(slow(rng, 6000, samples)) for _ in range(20)]
    keep = np.exp(-1.0 / samples)
    wanted = np.sqrt((1.0 + keep) / (1.0 - keep))  # of a mean
    assert np.mean(found) == pytest.approx(wanted, rel=0.15)


def test_samples_that_were_not_used_do_not_count() -> None:
    rng = np.random.default_rng(2)
    some = rng.normal(size=(3000, 6))
    some[rng.uniform(size=3000) < 0.3] = 0.0
    assert widening(some) == 1.0
    assert widening(np.zeros((3000, 6))) == 1.0


def test_white_noise_that_counts_during_a_part_of_the_samples_is_left_alone() -> None:
    """As of a joint that swings for a sixth of the time: the others hardly show its axis."""
    size = np.where(np.arange(6000)[:, None] < 1000, 1.0, 0.05)

    def noise(seed: int) -> np.ndarray:
        pairs = np.random.default_rng(seed).normal(size=(6000, 3))
        return size * np.repeat(pairs, 2, axis=1)  # estimates have residuals in common

    assert [widening(noise(seed)) for seed in range(50)] == [1.0] * 50


def test_rounding_is_taken_for_white_however_it_follows_the_motion() -> None:
    angle, still = np.linspace(-0.5, 0.5, 300), np.zeros(300)
    turned = matrix_from_rotation_vector(np.stack([still, still, angle], axis=1))
    both = matrix_from_rotation_vector(np.stack([np.sin(6.0 * angle), still, angle], axis=1))
    slid = np.stack([still, still, 0.1 * angle], axis=1)
    a, b = (
        transform(matrix_from_rotation_vector(np.array(turn)), np.array(at))
        for turn, at in (([0.1, -0.7, 0.6], [0.3, 0.4, 0.9]), ([0.4, 1.1, -0.8], [0.1, 0.0, 0.2]))
    )
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-15):

        def seen(turns: np.ndarray, shifts: np.ndarray, size: float = size) -> np.ndarray:
            T = a @ transform(turns, shifts) @ b
            return T * (1.0 + size * rng.normal(size=T.shape))

        still_turns = np.broadcast_to(np.eye(3), turned.shape)
        pivoted = seen(both, np.zeros((300, 3)))
        assert fit_hinge(seen(turned, np.zeros((300, 3)))).widened == 1.0
        assert fit_slide(seen(still_turns, slid)).widened == 1.0
        assert fit_pivot(pivoted[:, :3, :3], pivoted[:, :3, 3]).widened == 1.0
