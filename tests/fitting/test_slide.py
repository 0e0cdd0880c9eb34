"""Slides from poses: exact, and with samples that are wrong or missing."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.fitting import fit_slide
from trocar.geometry import matrix_from_rotation_vector

AWAY = np.array([0.1, -0.4, 0.2])
ALONG = np.array([2.0, -1.0, 2.0]) / 3.0
TURN = matrix_from_rotation_vector(np.array([0.3, -1.1, 0.4]))


def slide(count: int = 600, noise_m: float = 0.0, noise_rad: float = 0.0, seed: int = 0):
    """Poses along ALONG, +- 0.1 m; each of the two bodies has noise."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    s = 0.1 * np.sin(np.linspace(0.0, 12.0, count))
    eps_a, eps_b = noise_rad * rng.normal(size=(2, count, 3))
    turned = matrix_from_rotation_vector(-eps_a)
    T[:, :3, :3] = turned @ matrix_from_rotation_vector(eps_b) @ TURN
    place = AWAY + s[:, None] * ALONG
    T[:, :3, 3] = np.einsum("kij,kj->ki", turned, place)
    T[:, :3, 3] += np.sqrt(2.0) * noise_m * rng.normal(size=(count, 3))
    return T


def test_exact_poses_give_the_direction_in_both_bodies():
    found = fit_slide(slide())
    sign = np.sign(found.direction_a @ ALONG)
    np.testing.assert_allclose(sign * found.direction_a, ALONG, atol=1e-12)
    np.testing.assert_allclose(sign * found.direction_b, TURN.T @ ALONG, atol=1e-12)
    np.testing.assert_allclose(found.rotation, TURN, atol=1e-12)
    assert found.span == pytest.approx(0.2, abs=1e-4)
    assert found.outliers == 0


def test_lost_and_wrong_samples_are_left_out():
    T, rng = slide(noise_m=1e-4, noise_rad=1e-3), np.random.default_rng(1)
    clean = fit_slide(T)
    T[100:130] = np.nan
    wrong = rng.choice(np.r_[0:100, 130:600], 12, replace=False)
    T[wrong[:6], :3, 3] += 0.02 * np.array([0.0, 0.8, 0.4])  # a marker taken for its neighbour
    T[wrong[6:], :3, :3] = matrix_from_rotation_vector(rng.normal(size=(6, 3)))
    found = fit_slide(T)
    assert not found.used[wrong].any() and not found.used[100:130].any()
    assert found.outliers <= 12 + 6  # none but those, and what is far out of the noise by chance
    assert np.degrees(np.arccos(abs(found.direction_a @ clean.direction_a))) < 0.02


def test_standard_deviations_hold():
    scaled = []
    for seed in range(60):
        found = fit_slide(slide(300, 1e-4, 1e-3, seed))
        direction = np.sign(found.direction_a @ ALONG) * found.direction_a
        covariance = found.influence_a[:, :3].T @ found.influence_a[:, :3]
        for across in np.linalg.svd(ALONG[None])[2][1:]:
            scaled.append((direction - ALONG) @ across / np.sqrt(across @ covariance @ across))
    assert 0.85 < np.std(scaled) < 1.15


def test_too_few_poses_are_refused():
    with pytest.raises(InputError, match="expected at least"):
        fit_slide(slide(3))
