"""The rest at the start of a recording."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Least duration of a still start. Source: the statement of the method. [s]
STILL_S = 0.5
# Source: our own choice. The angles are averaged over this long, and what moves between two such
# stretches by more than noise and this much is not still. [s], [rad]
WINDOW_S, MOVED_RAD = 0.1, 2e-5
# Source: our own choice: five standard deviations, which no still stretch reaches.
BEYOND_NOISE = 5.0


def still_start(times: Array, angles: Mapping[str, Array]) -> Mask | None:
    """Find the samples before anything moves.

    Args:
        times: (n,) [s]
        angles: {hinge: (n,) [rad], NaN where unknown}

    Returns:
        (n,), or None where the tracks do not stand still for `STILL_S` at their start
    """
    end = np.inf
    for angle in angles.values():
        known = np.flatnonzero(np.isfinite(angle))
        end = min(end, _moves_at(times[known], angle[known]))
    if end - times[0] < STILL_S:
        return None
    return times <= end


def _moves_at(times: Array, angle: Array) -> float:
    """Return the time until which an angle keeps still, two stretches on the safe side."""
    edges = np.arange(times[0], times[-1] + WINDOW_S, WINDOW_S)
    which = np.searchsorted(edges, times, side="right") - 1
    counts = np.bincount(which)
    means = np.bincount(which, angle) / np.maximum(counts, 1)
    noise = float(np.median(np.abs(np.diff(angle)))) * 1.4826 / np.sqrt(2.0)
    full = np.flatnonzero(counts > 0)
    if not len(full):
        return float(times[0])
    start, seen = means[full[0]], counts[full[0]]
    for i in full[1:]:
        allowed = BEYOND_NOISE * noise * np.sqrt(1.0 / seen + 1.0 / counts[i]) + MOVED_RAD
        if abs(means[i] - start) > allowed:
            return float(edges[max(i - 2, 0)])
        start = (start * seen + means[i] * counts[i]) / (seen + counts[i])
        seen += counts[i]
    return float(times[-1])
