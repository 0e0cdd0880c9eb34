"""How accurate a hinge by itself is under noise, and whether its intervals cover the truth.

The noise is 0.1 mm and 0.05 degrees per axis on every body's pose, 120 Hz, 24 s. The figures to
reach are those of all hinges of an arm together, see tests/robot/calibration.
"""

from functools import cache

import numpy as np
import pytest

from tests.fitting.simulated import (
    NOISE,
    SAMPLES,
    any_rotation,
    fit_hinge_least_squares,
    measured,
    sweep,
    turned,
    unit,
)
from trocar.fitting import (
    axis_distance,
    fit_hinge,
    rest_pose,
)
from trocar.geometry import inverse, transform, translation

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


@cache
def errors(amplitude, worse=False, count=30, samples=SAMPLES):
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


def test_plain_least_squares_does_not_quite_reach_it():
    likely, plain, _ = errors(0.6)
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
