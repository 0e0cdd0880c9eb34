"""A first estimate of a hinge from poses of which some are wrong, and noise correlated in time.

Whether residuals are white, and what it does to estimates: an estimate is the sum of what each
sample's residual contributes to it. White noise adds up as squares; noise that stays on one side
for a second adds up in full. The variance is then the sum of the products of all pairs of
contributions, near ones first.

Source: Newey and West, A simple, positive semi-definite, heteroskedasticity and autocorrelation
consistent covariance matrix, 1987; Geyer, Practical Markov chain Monte Carlo, 1992, for the lag at
which the sum ends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import nearest_rotation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Source: our choice; residuals below this may be the rounding of a file with six decimals, and if
# most samples are of one pose, of the others alone [m], [rad].
_ROUNDING = 4e-6
# Source: our choice; a direction that is moved less than this is not moved.
_UNMOVED = 1e-12
# Source: our choice; 5 medians are 5.9 sigma of a residual with two components.
_FAR = 5.0
_ROUNDS = 12
#: Smallest distance of a gross outlier from a point, however small the others' distances: real
#: remote centres wander by up to 3.7 mm, and a mistaken marker is centimetres off. Source:
#: closed-loop paper, Table 7; the rest our choice. [m]
GROSS_M = 5e-3
# Source: our choice; of normal noise one sample in 10^8 is beyond 3.5 times what 70 % are within,
# of a point that wanders smoothly none. Up to 30 % of outliers are found.
_BULK, _BEYOND = 0.7, 3.5


def shared_direction(R: Array) -> tuple[Array, Array, Array]:
    """Find the direction that all rotations leave where it is.

    Least absolute deviations by reweighting, then a redescending weight.

    Args:
        R: rotations of b in a, (n, 3, 3)

    Returns:
        the unit direction in a and in b, (3,) each, and by how much each sample misses it, (n,)
        [rad, for small ones]
    """
    weights = np.ones(len(R))
    h_a = h_b = np.zeros(3)
    residual = np.zeros(len(R))
    for round_ in range(_ROUNDS):
        left, _, right = np.linalg.svd(np.tensordot(weights, R, 1) / weights.sum())
        h_a, h_b = left[:, 0], right[0]
        residual = np.linalg.norm(R @ h_b - h_a, axis=1)
        weights = _reweighted(residual, round_)
    return h_a, h_b, residual


def shared_point(
    R: Array, p: Array, start: Array, free: int = 2, least: float = _ROUNDING
) -> tuple[Array, Array, Array]:
    """Find the point that all poses leave where it is: R_k x_b + p_k = x_a.

    Where a whole line stays, the point of it that is nearest to b is taken.

    Args:
        R: rotations of b in a, (n, 3, 3)
        p: origins of b in a, (n, 3) [m]
        start: weight of each sample to begin with, (n,)
        free: directions in which the point is sought, 2 for one on a line
        least: samples that miss it by less count alike [m]

    Returns:
        the point in a and in b, (3,) each [m], and by how much each sample misses it, (n,) [m]
    """
    weights = start
    x_a = x_b = np.zeros(3)
    residual = np.zeros(len(R))
    for round_ in range(_ROUNDS):
        x_a, x_b = weighted_point(R, p, weights, free)
        residual = np.linalg.norm(R @ x_b + p - x_a, axis=1)
        weights = start * _reweighted(residual, round_, least)
    return x_a, x_b, residual


def shared_rotation(R: Array) -> tuple[Array, Array]:
    """Find the rotation that most of some rotations have.

    Args:
        R: rotations, (n, 3, 3)

    Returns:
        the rotation, (3, 3), and by how much each sample differs from it, (n,) [rad, small ones]
    """
    weights, mean, residual = np.ones(len(R)), np.eye(3), np.zeros(len(R))
    for round_ in range(_ROUNDS):
        mean = nearest_rotation(np.tensordot(weights, R, 1))
        residual = np.linalg.norm(R - mean, axis=(1, 2)) / np.sqrt(2.0)
        weights = _reweighted(residual, round_)
    return mean, residual


def shared_line(p: Array, start: Array) -> tuple[Array, Array, Array]:
    """Find the line that most points are on.

    Args:
        p: points, (n, 3) [m]
        start: weight of each to begin with, (n,)

    Returns:
        a point of it and its unit direction, (3,) each, and how far each sample is from it, (n,)
    """
    weights, middle, along, residual = start, np.zeros(3), np.zeros(3), np.zeros(len(p))
    for round_ in range(_ROUNDS):
        middle = weights @ p / weights.sum()
        away = p - middle
        along = np.linalg.svd(np.sqrt(weights)[:, None] * away, full_matrices=False)[2][0]
        residual = np.linalg.norm(away - np.outer(away @ along, along), axis=1)
        weights = start * _reweighted(residual, round_)
    return middle, along, residual


def weighted_point(R: Array, p: Array, weights: Array, free: int = 2) -> tuple[Array, Array]:
    """Solve R_k x_b + p_k = x_a by weighted least squares, see `shared_point`.

    With two free directions nothing is moved along that in which the poses say least: the axis.
    """
    total = weights.sum()
    mean_R = np.tensordot(weights, R, 1) / total
    mean_p = weights @ p / total
    mean_Rp = np.einsum("k,kji,kj->i", weights, R, p) / total
    # x_a eliminated: (I - mean_R^T mean_R) x_b = mean_R^T mean_p - mean(R^T p)
    values, vectors = np.linalg.eigh(np.eye(3) - mean_R.T @ mean_R)
    values, across = np.maximum(values[-free:], _UNMOVED), vectors[:, -free:]
    x_b = across @ ((mean_R.T @ mean_p - mean_Rp) @ across / values)
    return mean_R @ x_b + mean_p, x_b


def near(residual: Array) -> Mask:
    """Mask the samples that are not gross outliers, (n,)."""
    return residual < _FAR * max(float(np.median(residual)), _ROUNDING)


def not_gross(missed: Array) -> Mask:
    """Mask the samples that miss a point by no more than noise and its wander.

    A point that wanders is missed systematically, near the ends of a sweep by many times the
    median; such samples belong to it, and only what is far beyond the bulk of all does not.

    Args:
        missed: by how much each sample misses the point, (n,) [m]; NaN where not known

    Returns:
        (n,); not those that are not known
    """
    bulk = float(np.nanquantile(missed, _BULK))
    return np.asarray(missed < max(_BEYOND * bulk, GROSS_M))


def _reweighted(residual: Array, round_: int, least: float = _ROUNDING) -> Array:
    scale = max(float(np.median(residual)), least)
    if round_ < _ROUNDS // 2:
        return 1.0 / np.maximum(residual / scale, 0.5)
    return 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2) ** 2


#: Residuals of a fit below this are rounding, which follows the motion and is no measure of noise.
#: Source: the last digit of a file with six decimals, a tenth of what cameras resolve. [m], [rad]
ROUNDED = (2e-6, 4e-6)
#: Neighbouring samples that the test of whiteness compares. Source: our choice.
NEIGHBOURS = 10
#: Residuals are not white where their correlation is off by so many of its standard deviations.
#: Source: our choice, once in 30,000.
SIGNIFICANT = 4.0
#: Products are summed up to this share of all samples. Source: our choice; beyond it there are too
#: few to average over.
LONGEST = 0.25


def widening(influence: Array, left: tuple[float, float] = (np.inf, np.inf)) -> float:
    """Return the factor by which correlation in time widens standard deviations, 1 if it is white.

    Args:
        influence: what each sample contributes to k estimates, in order of time, (n, k); zeros
            where a sample was not used
        left: root mean square of the residuals, position [m] and rotation [rad]; white where
            neither exceeds `ROUNDED`
    """
    if left[0] <= ROUNDED[0] and left[1] <= ROUNDED[1]:
        return 1.0
    count = int(np.any(influence != 0.0, axis=1).sum())
    squares = np.sum(influence**2, axis=0)
    known = squares > 0.0
    if count <= 2 * NEIGHBOURS or not known.any():
        return 1.0
    scaled = influence[:, known] / np.sqrt(squares[known])
    padded = np.fft.rfft(scaled, 2 * len(scaled), axis=0)
    every = np.fft.irfft(np.abs(padded) ** 2, axis=0)[1 : int(LONGEST * len(scaled))]
    correlation = every.mean(axis=1)
    independent = max(1, scaled.shape[1] // 2)  # estimates have residuals in common
    # Samples that count for little tell little: of n that count alike this is n.
    weight = np.mean(scaled**2, axis=1)
    count = 1.0 / float(np.mean([weight[:-k] @ weight[k:] for k in range(1, NEIGHBOURS + 1)]))
    deviation = 1.0 / np.sqrt(count * independent * NEIGHBOURS)
    if correlation[:NEIGHBOURS].mean() < SIGNIFICANT * deviation:
        return 1.0
    grown = 1.0 + 2.0 * float(np.cumsum(correlation).max())
    # A fit takes a share of the noise: about two unknowns for each of its residuals.
    return float(np.sqrt(grown / max(1.0 - 2.0 * grown / count, 0.5)))
