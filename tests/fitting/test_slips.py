"""Slips of convention are named, and noise is told from motion."""

import numpy as np
import pytest

from tests.fitting.simulated import NOISE, fit_hinge_least_squares, one_hinge, two_hinges
from trocar.errors import InputError
from trocar.fitting import (
    fit_hinge,
    likely_cause,
    white_noise,
)
from trocar.geometry import inverse, matrix_from_quaternion, quaternion_from_matrix


def misread(T, order):
    """Read quaternions in another order than they were written in."""
    T = T.copy()
    T[:, :3, :3] = matrix_from_quaternion(quaternion_from_matrix(T[:, :3, :3])[:, order])
    return T


def mirrored(T, axis):
    T = T.copy()
    T[:, axis, 3] *= -1
    return T


def inverted(T):
    T = T.copy()
    T[:, :3, :3] = np.swapaxes(T[:, :3, :3], 1, 2)
    return T


@pytest.mark.parametrize(
    ("slip", "named"),
    [
        (lambda T: misread(T, [1, 2, 3, 0]), "x, y, z, w where w, x, y, z was announced"),
        (lambda T: misread(T, [3, 0, 1, 2]), "w, x, y, z where x, y, z, w was announced"),
        (lambda T: mirrored(T, 0), "the x axis of the positions is mirrored"),
        (lambda T: mirrored(T, 1), "the y axis of the positions is mirrored"),
        (lambda T: mirrored(T, 2), "the z axis of the positions is mirrored"),
        (inverted, "inverted"),
    ],
)
@pytest.mark.parametrize("seed", range(4))
def test_a_slip_of_convention_leaves_centimetres_and_is_named(slip, named, seed):
    (_, b, c), _ = two_hinges(np.random.default_rng(seed), samples=720, **NOISE)
    b, c = slip(b), slip(c)
    assert fit_hinge(inverse(b) @ c).residual_position > 0.01
    cause = likely_cause(b, c)
    assert cause is not None and named in cause


def test_no_slip_is_named_where_there_is_none():
    (a, b, c), _ = two_hinges(np.random.default_rng(5), samples=720, dropout=0.1, **NOISE)
    assert likely_cause(a, b) is None and likely_cause(b, c) is None


def test_the_sign_of_quaternions_does_not_matter():
    T, *_ = one_hinge(np.random.default_rng(6), samples=300, **NOISE)
    q = quaternion_from_matrix(T[:, :3, :3]) * np.where(np.arange(300) % 3, 1, -1)[:, None]
    flipped = T.copy()
    flipped[:, :3, :3] = matrix_from_quaternion(q)
    assert np.allclose(fit_hinge(flipped).point_a, fit_hinge(T).point_a, atol=1e-12)


def test_noise_is_told_from_motion_in_spite_of_outliers_and_dropouts():
    noise = {"position": 2e-4, "rotation": 1e-3}
    (_, _, c), _ = two_hinges(
        np.random.default_rng(7), samples=2880, outliers=0.01, dropout=0.05, **noise
    )
    position, rotation = white_noise(c)
    assert position == pytest.approx(2e-4, rel=0.1)
    assert rotation == pytest.approx(1e-3, rel=0.1)


def test_noise_of_a_body_hardly_seen_is_rejected():
    with pytest.raises(InputError, match="neighbouring samples; expected at least 20"):
        white_noise(np.full((50, 4, 4), np.nan))


def test_plain_least_squares_finds_the_same_axis_without_noise():
    T, *_ = one_hinge(np.random.default_rng(8))
    fit, (in_a, in_b) = fit_hinge(T), fit_hinge_least_squares(T)
    for mine, plain in ((fit.in_a, in_a), (fit.in_b, in_b)):
        assert abs(mine.direction @ plain.direction) == pytest.approx(1.0, abs=1e-14)
        off = plain.point - mine.point
        assert np.linalg.norm(off - off @ mine.direction * mine.direction) < 1e-12


@pytest.mark.slow
def test_plain_least_squares_is_biased_low_on_a_small_sweep_and_maximum_likelihood_is_not():
    errors = {"plain": [], "likely": []}
    for seed in range(20):
        T, _, second, _ = one_hinge(np.random.default_rng(seed), amplitude=0.035, **NOISE)
        radius = np.linalg.norm(second[:2, 3])  # of the axis about b's origin
        for name, axis in (("plain", fit_hinge_least_squares(T)[1]), ("likely", fit_hinge(T).in_b)):
            across = axis.point - axis.point @ axis.direction * axis.direction
            errors[name].append(np.linalg.norm(across) / radius - 1)
    assert np.mean(errors["plain"]) < -1e-3
    assert abs(np.mean(errors["likely"])) < 0.3 * abs(np.mean(errors["plain"]))
