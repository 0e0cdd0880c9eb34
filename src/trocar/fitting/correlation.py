"""Noise that is correlated in time: whether residuals are white, and what it does to estimates.

An estimate is the sum of what each sample's residual contributes to it. White noise adds up as
squares; noise that stays on one side for a second adds up in full. The variance is then the sum of
the products of all pairs of contributions, near ones first.

Source: Newey and West, A simple, positive semi-definite, heteroskedasticity and autocorrelation
consistent covariance matrix, 1987; Geyer, Practical Markov chain Monte Carlo, 1992, for the lag at
which the sum ends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Neighbouring samples that the test of whiteness compares. Source: our choice.
NEIGHBOURS = 10
#: Residuals are not white where their correlation is off by so many of its standard deviations.
#: Source: our choice, once in 30,000.
SIGNIFICANT = 4.0
#: Products are summed up to this share of all samples. Source: our choice; beyond it there are too
#: few to average over.
LONGEST = 0.25


def widening(influence: Array) -> float:
    """Return the factor by which correlation in time widens standard deviations, 1 if it is white.

    Args:
        influence: what each sample contributes to k estimates, in order of time, (n, k); zeros
            where a sample was not used
    """
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
