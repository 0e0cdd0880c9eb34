"""Angles between the links at home, as the paper's beta1 and beta2."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.axes import Axes, Value, shared_body
from trocar.apps.calibration.home import Home
from trocar.descriptions.axis_lines import Line, line_angle

Array = NDArray[np.float64]

# Source: our own choice; the angle is smooth, so this leaves 1e-9 of the slopes. [m, 1]
STEP = 1e-6

Pair = tuple[str, str]


def betas(
    axes: Axes, home: Home, wanted: Mapping[str, tuple[Pair, Pair]], through: Array
) -> dict[str, Value]:
    """Measure angles at home: from the second line to the first, less a right angle.

    Args:
        axes: as measured
        home: a still start
        wanted: {name: (pair, pair)}; a pair leads from its first hinge to its second
        through: a point of the plane in which they are told, as `home` has it, (3,) [m]

    Returns:
        {name: angle [rad]} of those that the tracks show
    """
    found: dict[str, Value] = {}
    for name, (to, start) in wanted.items():
        bodies = [shared_body(axes.linkage, *pair) for pair in (to, start)]
        if any(body is None or body not in home.poses for body in bodies):
            continue
        if any(hinge not in axes.fits for hinge in (*to, *start)):
            continue
        found[name] = _angle(axes, home, (to, start), (str(bodies[0]), str(bodies[1])), through)
    return found


def _angle(
    axes: Axes, home: Home, pairs: tuple[Pair, Pair], bodies: tuple[str, str], through: Array
) -> Value:
    """Measure one angle and its standard deviation.

    What each sample's noise does to the lines is summed over the axes before it is squared; the
    noise of home, which is the mean of the still start, comes on top.
    """
    ends = [(h, body) for pair, body in zip(pairs, bodies, strict=True) for h in pair]
    at = [axes.axis(hinge, body) for hinge, body in ends]
    start = np.concatenate([np.concatenate([axis.point, axis.direction]) for axis in at])

    def angle(numbers: Array) -> float:
        p = numbers.reshape(4, 6)
        a, b, c, d = (
            Line(p[i, :3], p[i, 3:]).moved(home.poses[body]) for i, (_, body) in enumerate(ends)
        )
        return line_angle((a, b), (c, d), through)

    slope = np.array([
        (angle(start + away) - angle(start - away)) / (2.0 * STEP)
        for away in STEP * np.eye(len(start))
    ])  # fmt: skip
    moved = np.concatenate([axis.influence for axis in at], axis=1) @ slope
    still = sum(home.angles[name].sigma ** 2 for name in _between(axes, home, *bodies))
    return Value(angle(start) - 0.5 * np.pi, float(np.sqrt(moved @ moved + still)))


def _between(axes: Axes, home: Home, one: str, two: str) -> list[str]:
    """Return the hinges on the way from one body to another."""
    ways: dict[str, list[str]] = {one: []}
    waiting = [one]
    while waiting and two not in ways:
        body = waiting.pop(0)
        for name in axes.linkage.carried(body):
            hinge = axes.linkage.hinge(name)
            other = hinge.body_b if body == hinge.body_a else hinge.body_a
            if name in home.angles and other not in ways:
                ways[other] = [*ways[body], name]
                waiting.append(other)
    return ways.get(two, [])
