"""The axes of a linkage as the tracks show them, each hinge by itself.

Distances are taken inside one link that carries both axes, so they need no home; angles are those
of the still start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.axis_lines import Line, along_to_plane, mean_direction
from trocar.errors import InputError
from trocar.fitting import (
    LEAST_SPAN,
    SMALL_SPAN,
    Axis,
    HingeFit,
    SharedHinge,
    axis_distance,
    fit_hinge,
    likely_cause,
    refine_hinges,
)
from trocar.geometry import inverse
from trocar.robot.calibration.linkage import APART_M, HingeAxis, LoopedPart
from trocar.robot.calibration.tracks import Tracks, check_together

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Source: our own choice: twice what a hinge has unknown, and then some.
LEAST_SAMPLES = 30
#: A hinge whose poses are this far from any turn about an axis is no hinge. Source: our own choice;
#: a hundred times the noise of a camera system, a tenth of what mixed conventions leave. [m]
WRONG_M = 5e-3
#: Or whose rotation is this far from any. Source: our own choice, as above. [rad]
WRONG_RAD = 0.05

#: So many neighbouring angles are averaged. Source: our own choice; 0.04 s at 120 Hz, in which a
#: sweep of 0.1 Hz is all but still at its ends.
NEIGHBOURS = 5
#: Noise below this is the rounding of a file with six decimals. [m]
ROUNDED_M = 2e-6

# Source: our own choice; geometry is smooth on this scale, so it leaves 1e-9 of slopes. [m, rad]
STEP = 1e-6


def slopes(of: Callable[[Array], Any], x: Array) -> Array:
    """Return the derivative of a function of x, (m, n) or (n,), by central differences."""
    steps = STEP * np.eye(len(x))
    return np.stack([(of(x + s) - of(x - s)) / (2.0 * STEP) for s in steps], axis=-1)


@dataclass(frozen=True)
class Value:
    """A number with its standard deviation, in SI units."""

    value: float
    sigma: float

    def as_dict(self) -> dict[str, float]:
        """Return plain data."""
        return {"value": self.value, "sigma": self.sigma}


@dataclass(frozen=True, eq=False)
class BaseAxis:
    """The axis about which the ground of the loops turns on the arm, as tracks show it.

    Attributes:
        point, direction: in the markers of the ground's body, (3,) [m]; directed as described
        covariance: of both, (6, 6)
    """

    point: Array
    direction: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Axes:
    """Every hinge that the tracks show.

    Attributes:
        linkage: the loops
        fits: {hinge: its fit}
        signs: {hinge: whether the fit's direction agrees with the description's (1) or not (-1)}
        warnings: what a user should know
    """

    linkage: LoopedPart
    fits: Mapping[str, HingeFit]
    signs: Mapping[str, float]
    warnings: tuple[str, ...]

    def axis(self, name: str, body: str) -> Axis:
        """Return a hinge's axis as one of its bodies has it, directed as in the description."""
        fit, hinge = self.fits[name], self.linkage.hinge(name)
        axis, sign = fit.in_a if body == hinge.body_a else fit.in_b, self.signs[name]
        turned = axis.influence * np.repeat([1.0, sign], 3)
        return Axis(axis.point, sign * axis.direction, turned)

    def angles(self, name: str) -> Array:
        """Return a hinge's angles, positive as in the description, (n,) [rad]."""
        return self.signs[name] * self.fits[name].angles

    @property
    def noise(self) -> tuple[float, float]:
        """Noise of a pose, position [m] and rotation [rad] per axis: the median of the hinges'."""
        return _noise(self.fits)

    @property
    def widened(self) -> float:
        """How much noise that is correlated in time widens standard deviations: the median."""
        return float(np.median([fit.widened for fit in self.fits.values()]))


def _noise(fits: Mapping[str, HingeFit]) -> tuple[float, float]:
    return (
        float(np.median([fit.position_sigma for fit in fits.values()])),
        float(np.median([fit.rotation_sigma for fit in fits.values()])),
    )


def measure_axes(
    tracks: Tracks,
    linkage: LoopedPart,
    watch: Callable[[str], None] = lambda _: None,
    *,
    sliding: bool = False,
) -> Axes:
    """Find every axis whose two bodies are in the tracks.

    Args:
        tracks: a sweep of the joints that move the loops
        linkage: the loops
        watch: is told what is being done
        sliding: whether the pins that close the loops may slide, as axes that lean make them

    Raises:
        InputError: bodies that are never seen together, a sweep too small to fix an axis, or
            motion that is no turn about one
    """
    fits: dict[str, HingeFit] = {}
    for hinge in linkage.hinges:
        if hinge.body_a in tracks.poses and hinge.body_b in tracks.poses:
            watch(f"axis {hinge.label}")
            fits[hinge.name] = _fit(tracks, hinge, sliding and hinge.closure)
    if not fits:
        raise InputError(
            f"{tracks.file}: no two bodies are joined by a hinge; found: "
            f"{', '.join(tracks.poses)}; expected: {', '.join(linkage.bodies)}"
        )
    _check_hinges(tracks, linkage, fits)
    watch("all axes")
    fits = _jointly(tracks, linkage, fits)
    warnings = tuple(
        f"axis {hinge.label} was swept by {fits[hinge.name].span:.3f} rad only; below"
        f" {SMALL_SPAN} rad its place is loose (condition number"
        f" {fits[hinge.name].condition:.0f})"
        for hinge in linkage.hinges
        if hinge.name in fits and fits[hinge.name].span < SMALL_SPAN
    )
    widened = max(fit.widened for fit in fits.values())
    if widened > 1.0 and _noise(fits)[0] > ROUNDED_M:
        warnings += (
            "the residuals are correlated in time: noise is not white, and standard deviations are"
            f" widened, up to {widened:.1f} times",
        )
    return Axes(linkage, fits, _signs(linkage, fits), warnings)


def _fit(tracks: Tracks, hinge: HingeAxis, slides: bool) -> HingeFit:
    check_together(tracks, hinge.body_a, hinge.body_b, LEAST_SAMPLES)
    poses = inverse(tracks.poses[hinge.body_a]) @ tracks.poses[hinge.body_b]
    fit = fit_hinge(poses, slides=slides)
    # Means of neighbours, lest noise makes the sweep larger.
    swept = np.convolve(fit.angles[fit.used], np.full(NEIGHBOURS, 1.0 / NEIGHBOURS), "valid")
    check_span(tracks.file, hinge, float(np.ptp(swept)))
    return fit


def check_span(file: str, hinge: HingeAxis, span: float) -> None:
    """Refuse a sweep that is too small to fix an axis.

    Raises:
        InputError: with what is allowed
    """
    if span < LEAST_SPAN:
        raise InputError(
            f"{file}: axis {hinge.label} ({hinge.body_a} to {hinge.body_b}) was swept by"
            f" {span:.4f} rad; allowed: {LEAST_SPAN} rad or more ({SMALL_SPAN} rad for a reliable"
            " result, 1.2 rad for the stated accuracy)"
        )


def _jointly(
    tracks: Tracks, linkage: LoopedPart, fits: Mapping[str, HingeFit]
) -> dict[str, HingeFit]:
    """Weigh all hinges together: each body's poses tell of every hinge that it carries."""
    bodies, shared = joined_hinges(linkage, fits)
    poses = np.stack([tracks.poses[body] for body in bodies], axis=1)
    sigmas = _noise(fits)
    return dict(zip(fits, refine_hinges(poses, shared, sigmas), strict=True))


def joined_hinges(
    linkage: LoopedPart, fits: Mapping[str, HingeFit]
) -> tuple[list[str], list[SharedHinge]]:
    """Return the bodies that hinges join, and each hinge by the places of its two among them."""
    hinges = [linkage.hinge(name) for name in fits]
    bodies = list(dict.fromkeys(body for h in hinges for body in (h.body_a, h.body_b)))
    return bodies, [
        SharedHinge(bodies.index(h.body_a), bodies.index(h.body_b), fits[h.name], h.closure)
        for h in hinges
    ]


def _check_hinges(tracks: Tracks, linkage: LoopedPart, fits: Mapping[str, HingeFit]) -> None:
    """Refuse motion that is no turn about an axis, and name the likely cause."""
    bad = [n for n, fit in fits.items() if _wrong(fit, tracks, linkage.hinge(n))]
    if not bad:
        return
    worst = max(bad, key=lambda name: fits[name].residual_position)
    fit, hinge = fits[worst], linkage.hinge(worst)
    others = sorted({b for n in bad for b in (linkage.hinge(n).body_a, linkage.hinge(n).body_b)})
    cause = likely_cause(tracks.poses[hinge.body_a], tracks.poses[hinge.body_b])
    if cause is None:
        cause = f"wrong names, or a loose cluster on one of {', '.join(others)}"
    share = fit.outliers / max(1, fit.outliers + int(fit.used.sum()))
    raise InputError(
        f"{tracks.file}: {hinge.body_a} and {hinge.body_b} do not rotate about a common axis"
        f" ({hinge.label}):"
        f" {1e3 * fit.residual_position:.1f} mm and {fit.residual_rotation:.3f} rad from the"
        f" nearest hinge, {100 * share:.0f} % of the samples excluded; allowed:"
        f" {1e3 * WRONG_M:.0f} mm and 30 %. Probable cause: {cause}"
    )


def _wrong(fit: HingeFit, tracks: Tracks, hinge: HingeAxis) -> bool:
    kept = int(fit.used.sum())
    if fit.residual_position > WRONG_M:
        return True
    if fit.outliers <= 0.3 * (kept + fit.outliers):
        return False
    # In tracks without noise a pin that is not quite a hinge leaves many a little off.
    poses = inverse(tracks.poses[hinge.body_a]) @ tracks.poses[hinge.body_b]
    turn = inverse(fit.before) @ poses[np.isfinite(poses).all(axis=(1, 2))] @ inverse(fit.after)
    far = (np.linalg.norm(turn[:, :3, 3], axis=1) > WRONG_M) | (turn[:, 2, 2] < np.cos(WRONG_RAD))
    return int(far.sum()) > 0.3 * (kept + fit.outliers)


def _signs(linkage: LoopedPart, fits: Mapping[str, HingeFit]) -> dict[str, float]:
    """Give all directions one sense; which of the two is up to `home`."""
    found: dict[str, float] = {}
    for start in fits:
        if start in found:
            continue
        found[start] = 1.0
        waiting = [start]
        while waiting:
            one = linkage.hinge(waiting.pop())
            for body in (one.body_a, one.body_b):
                for name in linkage.carried(body):
                    if name not in fits or name in found:
                        continue
                    agree = _direction(fits[name], linkage.hinge(name), body) @ _direction(
                        fits[one.name], one, body
                    )
                    found[name] = found[one.name] * (1.0 if agree >= 0.0 else -1.0)
                    waiting.append(name)
    return found


def _direction(fit: HingeFit, hinge: HingeAxis, body: str) -> Array:
    return fit.direction_a if body == hinge.body_a else fit.direction_b


def turned_over(axes: Axes) -> Axes:
    """Return the axes with every direction reversed."""
    return replace(axes, signs={name: -sign for name, sign in axes.signs.items()})


def distances(
    axes: Axes,
    pairs: Mapping[str, tuple[str, str]],
    through: Mapping[str, Array] | None = None,
) -> dict[str, Value]:
    """Measure distances of axes, each inside a link that carries both.

    Args:
        axes: as measured
        pairs: {label: two hinges}
        through: {body: a point (3,) [m]} of the plane, across both axes, in which their distance is
            taken; when omitted the plane lies midway between the points of the two axes

    Returns:
        {label: distance [m]} of those that the tracks show
    """
    found: dict[str, Value] = {}
    for label, (one, two) in pairs.items():
        body = shared_body(axes.linkage, one, two)
        near = np.linalg.norm(axes.linkage.points[one] - axes.linkage.points[two]) < APART_M
        if one not in axes.fits or two not in axes.fits or body is None or near:
            continue
        first, second = axes.axis(one, body), axes.axis(two, body)
        if through is not None:
            normal = mean_direction([axis_line(first), axis_line(second)])
            first, second = (slid(axis, through[body], normal) for axis in (first, second))
        distance = axis_distance(first, second)
        found[label] = Value(distance.value, distance.sigma)
    return found


def axis_line(axis: Axis) -> Line:
    """Return a measured axis as a line."""
    return Line(axis.point, axis.direction)


def slid(axis: Axis, through: Array, normal: Array) -> Axis:
    """Return an axis whose point is where it pierces a plane."""
    s = along_to_plane(axis_line(axis), through, normal)
    dg, dd = axis.influence[:, :3], axis.influence[:, 3:]
    return Axis(axis.point + s * axis.direction, axis.direction, np.hstack([dg + s * dd, dd]))


def shared_body(linkage: LoopedPart, one: str, two: str) -> str | None:
    """Return the body that carries both hinges, None when there is none."""
    return next(
        (b for b in linkage.bodies if one in linkage.carried(b) and two in linkage.carried(b)), None
    )
