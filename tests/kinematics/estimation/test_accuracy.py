"""How accurate hinges and centres are under noise, and whether their intervals cover the truth.

The noise is 0.1 mm and 0.05 degrees per axis on every body's pose, 120 Hz, 24 s.
"""

from functools import cache

import numpy as np
import pytest

from trocar.geometry import inverse, rotation_x, rotation_z, transform, translation
from trocar.kinematics.estimation import (
    axis_distance,
    fit_hinge,
    fit_hinge_least_squares,
    fit_pivot_in_body,
    rest_pose,
)

from .simulated import NOISE, SAMPLES, any_rotation, measured, sweep, turned, unit

pytestmark = pytest.mark.slow
WORSE = {"dropout": 0.05, "outliers": 0.01}


def on_the_link(rng, middle):
    """Place a cluster on a link, 0.03 to 0.15 m from its middle."""
    return transform(any_rotation(rng), middle + rng.uniform(0.03, 0.15) * unit(rng))


def link_with_two_hinges(rng, amplitude, samples=SAMPLES, **noise):
    """Give three bodies in a chain, as a parallelogram turns them, and the distance of the axes.

    The first rests, as the link does that carries the driven hinge.
    """
    distance = rng.uniform(0.03, 0.5)
    theta = sweep(rng, amplitude, samples)
    first = transform(any_rotation(rng), rng.normal(size=3))
    links = [np.tile(first, (len(theta), 1, 1)), first @ turned(theta)]
    links.append(links[1] @ translation([distance, 0, 0]) @ turned(-theta))
    middles = ([0.0, 0, 0], [distance / 2, 0, 0], [0.0, 0, 0])
    bodies = [
        measured(rng, link @ on_the_link(rng, middle), **NOISE, **noise)
        for link, middle in zip(links, middles, strict=True)
    ]
    return bodies, distance


def swung(rng, **noise):
    """Give a base at rest and a body that yaws and pitches by 0.6 rad, and its still point."""
    time = np.arange(SAMPLES) / 120
    turn = rotation_z(0.6 * np.sin(2 * np.pi * time / 12))
    turn = turn @ rotation_x(0.6 * np.sin(2 * np.pi * time / 8))
    # Source: how far simulated clusters are from the centre: 0.39 m and 0.15 m.
    post, tip = 0.39 * unit(rng), 0.15 * unit(rng)
    R = any_rotation(rng) @ turn @ any_rotation(rng)
    base = transform(any_rotation(rng), rng.normal(size=3))
    at_rest = np.tile(base, (SAMPLES, 1, 1))
    body = base @ transform(R, post - R @ tip)
    return (measured(rng, at_rest, **noise), measured(rng, body, **noise)), post


@cache
def errors(amplitude, worse=False, count=60, samples=SAMPLES):
    """Errors of a distance, by maximum likelihood and by plain least squares, and its sigmas."""
    found = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        (a, b, c), distance = link_with_two_hinges(
            rng, amplitude, samples, **(WORSE if worse else {})
        )
        one, two = inverse(a) @ b, inverse(b) @ c
        at_rest = rest_pose(a)
        assert at_rest is not None
        likely = axis_distance(fit_hinge(inverse(at_rest.pose) @ b).in_b, fit_hinge(two).in_a)
        plain = axis_distance(fit_hinge_least_squares(one)[1], fit_hinge_least_squares(two)[0])
        found.append((likely.value - distance, plain.value - distance, likely.sigma))
    return np.array(found).T


# Source: 60 robots tell a median, and a 95 % quantile, to about 15 %.
SAMPLING = 1.15


@pytest.mark.parametrize(
    ("amplitude", "worse", "median", "most"),
    [
        # Source: the project's figures for the distances of a PSM's and an ECM's axes [m].
        (0.6, False, 8e-6, 32e-6),
        (0.6, True, 8e-6, 32e-6),
        (0.8, False, 6e-6, 22e-6),
        (0.3, False, 18e-6, 70e-6),
    ],
)
def test_the_distance_of_two_axes_of_a_link_is_known_to_micrometres(amplitude, worse, median, most):
    error = np.abs(errors(amplitude, worse)[0])
    assert np.median(error) < SAMPLING * median
    assert np.quantile(error, 0.95) < SAMPLING * most


@pytest.mark.parametrize("amplitude", [0.6, 0.8, 0.3])
def test_plain_least_squares_does_not_quite_reach_it(amplitude):
    likely, plain, _ = errors(amplitude)
    assert np.median(np.abs(plain)) > 1.1 * np.median(np.abs(likely))


def test_plain_least_squares_is_biased_low_and_lost_among_outliers():
    likely, plain, _ = errors(0.3)
    assert plain.mean() < -3 * abs(likely.mean())
    likely, plain, _ = errors(0.6, worse=True)
    assert np.median(np.abs(plain)) > 1000 * np.median(np.abs(likely))


def test_intervals_of_95_percent_cover_the_true_distance():
    likely, _, sigma = errors(0.6, worse=True, count=300, samples=480)
    # Source: 92 to 98 % is asked for; 300 draws at 95 % scatter by 1.3 %.
    assert 0.92 <= np.mean(np.abs(likely) < 1.96 * sigma) <= 0.98


@pytest.mark.parametrize("worse", [{}, WORSE])
def test_the_remote_centre_is_known_to_micrometres_and_its_intervals_cover_it(worse):
    off, within = [], []
    for seed in range(60):
        (a, b), post = swung(np.random.default_rng(seed), **NOISE, **worse)
        fit = fit_pivot_in_body(a, b)
        off.append(np.linalg.norm(fit.post - post))
        within.extend(np.abs(fit.post - post) < 1.96 * fit.sigma_post)
    # Source: the project's figures, 16 um and 30 um, and 92 to 98 %; 180 values scatter by 1.6 %.
    assert np.median(off) < SAMPLING * 16e-6
    assert np.quantile(off, 0.95) < SAMPLING * 30e-6
    assert 0.92 <= np.mean(within) <= 0.98
