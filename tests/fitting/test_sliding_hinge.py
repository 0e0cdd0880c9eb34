"""A pin that slides along its axis as it turns, as pins of loops with leaning axes do."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.fitting import HingeFit, fit_hinge
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import exp_twist, inverse, transform

NOISE = np.repeat([1e-4, np.deg2rad(0.05)], 3)


def taken(rng: np.random.Generator, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return poses of b in a, (n, 4, 4), and the axis' direction in a, (3,)."""
    before, after = (exp_twist(rng.normal(size=6) * np.repeat([0.1, 1.0], 3)) for _ in range(2))
    theta = 0.6 * np.sin(np.linspace(0.0, 12.0, 900))
    slide = 1e-3 * np.sin(theta + 0.4)  # of axes that lean by 7 mrad over 15 cm
    turn = np.stack(
        [transform(rotation_z(t), [0.0, 0.0, z]) for t, z in zip(theta, slide, strict=True)]
    )
    a, b = (exp_twist(noise * NOISE * rng.normal(size=(900, 6))) for _ in range(2))
    return inverse(a) @ before @ turn @ after @ b, before[:3, 2]


def pull(fit: HingeFit, direction: np.ndarray, known: HingeFit | None = None) -> float:
    """Return by how many deviations of a fit, its own or a known one's, the direction is off."""
    sign, influence = np.sign(fit.direction_a @ direction), (known or fit).influence_a[:, 3:]
    sigma = np.sqrt(np.diag(influence.T @ influence))
    return float(np.max(np.abs(sign * fit.direction_a - direction) / sigma))


@pytest.mark.parametrize("seed", range(4))
def test_the_direction_of_a_sliding_pin_is_within_its_deviations(seed: int) -> None:
    poses, direction = taken(np.random.default_rng(seed), 1.0)
    slides, stays = fit_hinge(poses, slides=True), fit_hinge(poses)
    assert pull(slides, direction) < 4.0
    # Without the slide it is taken for a lean; its own deviations are wide, as its residuals follow
    # the motion.
    assert pull(stays, direction, slides) > 4.0


def test_a_sliding_pin_without_noise_is_found_exactly() -> None:
    poses, direction = taken(np.random.default_rng(5), 0.0)
    fit = fit_hinge(poses, slides=True)
    assert abs(fit.direction_a @ direction) == pytest.approx(1.0, abs=1e-14)
    turned = inverse(fit.before) @ poses @ inverse(fit.after)
    assert np.abs(turned[:, :2, 3]).max() < 1e-9
    assert np.ptp(turned[:, 2, 3]) > 5e-4  # what is left is the slide
    assert fit.outliers == 0
