"""Fewer points that draw the same line: what a curve reaches is kept."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def thinned(time: Array, values: Array, bins: int) -> tuple[Array, Array]:
    """Return the lowest and the highest point of each stretch of a curve.

    Args:
        time: (k,), rising
        values: (k,)
        bins: stretches at most; a curve of twice as many points is returned as it is
    """
    count = len(time)
    if count <= 2 * bins:
        return time, values
    edges = np.linspace(0, count, bins + 1).astype(int)
    kept: list[int] = [0]
    for begin, end in pairwise(edges):
        part = values[begin:end]
        if np.isnan(part).all():
            kept.append(int(begin))
            continue
        kept += sorted({int(begin + np.nanargmin(part)), int(begin + np.nanargmax(part))})
    kept.append(count - 1)
    index = np.unique(kept)
    return time[index], values[index]
