"""Axes of rotation in one frame, and how far apart they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Axis:
    """An axis of rotation, and what each sample contributed to its error.

    Attributes:
        point: on the axis, (3,) [m]
        direction: along it, a unit vector, (3,)
        influence: first-order effect of each sample's own residual on (point, direction), (n, 6)
            [m; 1], across the axis only: sliding the point along the axis changes nothing
    """

    point: Array
    direction: Array
    influence: Array


@dataclass(frozen=True, eq=False)
class AxisDistance:
    """The distance of two axes.

    Attributes:
        value: [m]
        sigma: its standard deviation [m]
        influence: effect of each sample's residual on it, (n,) [m]; those of two distances from
            the same samples give their covariance, `influence_1 @ influence_2`
    """

    value: float
    sigma: float
    influence: Array


def axis_distance(first: Axis, second: Axis, across: Sequence[Axis] = ()) -> AxisDistance:
    """Measure the distance of two axes in the plane across their mean direction.

    Both are cut by the plane that lies midway between their points. The directions may differ in
    sign.

    Args:
        first, second: in one frame, estimated from the same n samples
        across: every axis whose direction counts for the mean, in the same frame and from the same
            samples; the two themselves when empty

    Returns:
        the distance with its standard deviation
    """
    axes = tuple(across) or (first, second)
    signs = [1.0 if a.direction @ first.direction >= 0 else -1.0 for a in axes]
    total = np.sum([s * a.direction for s, a in zip(signs, axes, strict=True)], axis=0)
    length = float(np.linalg.norm(total))
    h = total / length
    turns = np.sum([s * a.influence[:, 3:] for s, a in zip(signs, axes, strict=True)], axis=0)
    dh = (turns - np.outer(turns @ h, h)) / length

    middle = 0.5 * (first.point + second.point)
    (p1, dp1), (p2, dp2) = (_cut(axis, middle, h, dh) for axis in (first, second))
    value = float(np.linalg.norm(p2 - p1))
    influence = (dp2 - dp1) @ ((p2 - p1) / max(value, np.finfo(float).tiny))
    return AxisDistance(value, float(np.sqrt(influence @ influence)), influence)


def _cut(axis: Axis, middle: Array, h: Array, dh: Array) -> tuple[Array, Array]:
    """Cut an axis by the plane through `middle` across h: the point, and its influence."""
    g, d = axis.point, axis.direction
    dg, dd = axis.influence[:, :3], axis.influence[:, 3:]
    along = float(d @ h)
    s = float((middle - g) @ h) / along
    ds = (dh @ (middle - g) - dg @ h - s * (dd @ h + dh @ d)) / along
    return g + s * d, dg + s * dd + np.outer(ds, d)
