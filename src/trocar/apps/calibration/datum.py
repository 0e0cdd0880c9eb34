"""Where along the axes distances and angles are told: the datum, as each body's markers have it.

Skew axes are nearer at one end than at the other, so all are cut by one plane. A description has it
through the origin of its first axis' frame. On an arm with a remote centre the ground's own axis
passes there, so that a sweep of that axis shows it; else nothing in the tracks does, and it is put
midway between the feet, on the first axis, of the two clusters that this axis joins.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.axes import Axes
from trocar.apps.calibration.home import Home
from trocar.apps.calibration.placement import BaseAxis
from trocar.geometry import inverse

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Datum:
    """A point of the plane across the axes in which they are compared.

    Attributes:
        at_home: in the frame of `Home.poses`, (3,) [m]
        points: {body: in its markers (3,) [m]}, at home
        shown: whether the tracks show it, by the ground's own axis
    """

    at_home: Array
    points: Mapping[str, Array]
    shown: bool


def find_datum(axes: Axes, home: Home, base: BaseAxis | None) -> Datum:
    """Find the datum in the tracks.

    Args:
        axes: as measured
        home: where the bodies stand at joint positions 0
        base: the ground's own axis, where the tracks show it
    """
    first = axes.linkage.first
    first = first if first in axes.fits else next(iter(axes.fits))
    hinge = axes.linkage.hinge(first)
    body = next(b for b in (hinge.body_a, hinge.body_b) if b in home.poses)
    axis = axes.axis(first, body)
    point, shown = axis.point, base is not None and body == axes.linkage.ground
    if base is not None and shown:
        point = _nearest(axis.point, axis.direction, base.point, base.direction)
    at_home = _moved(home.poses[body], point)
    points = {b: _moved(inverse(pose), at_home) for b, pose in home.poses.items()}
    return Datum(at_home, points, shown)


def _moved(T: Array, point: Array) -> Array:
    return np.asarray(T[:3, :3] @ point + T[:3, 3], dtype=np.float64)


def _nearest(point: Array, direction: Array, other: Array, other_direction: Array) -> Array:
    """Return the point of a line that is nearest to another, both along unit vectors, (3,)."""
    cosine = float(direction @ other_direction)
    between = other - point
    along = (between @ direction - cosine * (between @ other_direction)) / (1.0 - cosine**2)
    return point + along * direction
