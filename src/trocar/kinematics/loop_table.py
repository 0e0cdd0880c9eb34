"""What a loop's passive frames do as one joint moves, as a series of Chebyshev polynomials."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import acos

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Terms of the series. Source: a four-bar's angles are smooth where it is not flat; 0.2 rad from
#: there 48 terms leave 1e-13 rad (measured on a calibrated PSM).
TERMS = 48
ORDERS = np.arange(TERMS)
#: How far beyond its limits, in shares of its range, a joint is still in the table: a simulated one
#: passes them by a little. Source: our own choice.
MARGIN = 0.02


@dataclass(frozen=True, eq=False)
class LoopTable:
    """A series in one joint for each passive frame.

    Attributes:
        column: the joint that folds the loops
        middle, half: of the range that the series hold in [rad or m]
        series: coefficients, (TERMS, n_passive)
    """

    column: int
    middle: float
    half: float
    series: Array

    def beyond_start(self, q: Array) -> Array:
        """Return what couplings alone leave out, (..., n_passive); 0 outside the table's range."""
        share = (q[..., self.column] - self.middle) / self.half
        turn = np.arccos(np.clip(share, -1.0, 1.0))
        found = np.cos(turn[..., None] * ORDERS) @ self.series
        return np.where((np.abs(share) <= 1.0)[..., None], found, 0.0)

    def at(self, position: float) -> tuple[Array, Array] | None:
        """Return what couplings alone leave out at one position of the joint, and its slope.

        Returns:
            (n_passive,) each [rad or m, per rad or m]; None outside the table's range
        """
        share = (position - self.middle) / self.half
        if not -1.0 <= share <= 1.0:
            return None
        found = np.cos(acos(share) * ORDERS).dot(self._with_slopes)
        half = len(found) // 2
        return found[:half], found[half:]

    @cached_property
    def _with_slopes(self) -> Array:
        """Coefficients of the series and of their derivatives, (TERMS, 2 n_passive)."""
        slopes = np.zeros_like(self.series)
        slopes[:-1] = np.polynomial.chebyshev.chebder(self.series, scl=1.0 / self.half)
        return np.concatenate([self.series, slopes], axis=1)


def nodes(lower: float, upper: float) -> Array:
    """Return the positions of a joint at which a table is measured, (TERMS,)."""
    middle, half = _range(lower, upper)
    return middle + half * np.cos(_turns())


def loop_table(column: int, lower: float, upper: float, values: Array) -> LoopTable:
    """Return the table that has these values, (TERMS, n_passive), at `nodes`.

    Source: the discrete cosine transform of a function at Chebyshev's nodes has its coefficients;
    Trefethen 2013, Approximation Theory and Approximation Practice, chapter 3.
    """
    middle, half = _range(lower, upper)
    series = 2.0 / TERMS * np.cos(np.outer(np.arange(TERMS), _turns())) @ values
    series[0] *= 0.5
    return LoopTable(column, middle, half, series)


def _range(lower: float, upper: float) -> tuple[float, float]:
    return 0.5 * (lower + upper), (0.5 + MARGIN) * (upper - lower)


def _turns() -> Array:
    return np.pi * (np.arange(TERMS) + 0.5) / TERMS
