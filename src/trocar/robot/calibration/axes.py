"""The axes of a linkage as tracks show them, and home: the joint positions 0 of the still start.

Distances are taken inside one link that carries both axes, so they need no home; angles are those
of the still start.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.axis_lines import Line, line_angle
from trocar.descriptions.calibration_plan import Pair
from trocar.errors import InputError, TracksError
from trocar.fitting import (
    LEAST_SPAN,
    SMALL_SPAN,
    STILL_S,
    Axis,
    HingeFit,
    SharedHinge,
    axis_distance,
    fit_hinge,
    likely_cause,
    refine_hinges,
    still_start,
)
from trocar.fitting.adjust import slopes
from trocar.geometry import inverse, rotation_z, transform
from trocar.robot.calibration.linkage import APART_M, HingeAxis, LoopedPart, plane_across
from trocar.robot.calibration.tracks import Tracks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Source: our own choice: twice what a hinge has unknown, and then some.
LEAST_SAMPLES = 30
#: A hinge whose poses are this far from any turn about an axis is no hinge. Source: our own choice;
#: a hundred times the noise of a camera system, a tenth of what mixed conventions leave. [m]
WRONG_M = 5e-3
#: Or whose rotation is this far from any. Source: our own choice, as above. [rad]
WRONG_RAD = 0.05

#: Number of neighbouring angles that are averaged. Source: our own choice; 0.04 s at 120 Hz, in
#: which a sweep of 0.1 Hz is all but still at its ends.
NEIGHBOURS = 5
#: Noise below this is the rounding of a file with six decimals. [m]
ROUNDED_M = 2e-6


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
        fit, hinge = self.fits[name], self.linkage.hinge[name]
        axis, sign = fit.in_a if body == hinge.body_a else fit.in_b, self.signs[name]
        turned = axis.influence * np.repeat([1.0, sign], 3)
        return Axis(axis.point, sign * axis.direction, turned)

    def of_first_hinge(self) -> dict[str, Axis]:
        """Return the first hinge's axis in each of its bodies, {} where it is not measured."""
        hinge = self.linkage.hinges[0]
        bodies = (hinge.body_a, hinge.body_b) if hinge.name in self.fits else ()
        return {body: self.axis(hinge.name, body) for body in bodies}

    def angles(self, name: str) -> Array:
        """Return a hinge's angles, positive as in the description, (n,) [rad]."""
        return self.signs[name] * self.fits[name].angles

    @property
    def noise(self) -> tuple[float, float]:
        """Noise of a pose, position [m] and rotation [rad] per axis: the median of the hinges'."""
        return _noise(self.fits)

    @property
    def widened(self) -> float:
        """Return the median factor by which noise correlated in time widens standard deviations."""
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
    hinges = [linkage.hinge[name] for name in fits]
    bodies = list(dict.fromkeys(body for h in hinges for body in (h.body_a, h.body_b)))
    return bodies, [
        SharedHinge(bodies.index(h.body_a), bodies.index(h.body_b), fits[h.name], h.closure)
        for h in hinges
    ]


def _check_hinges(tracks: Tracks, linkage: LoopedPart, fits: Mapping[str, HingeFit]) -> None:
    """Refuse motion that is no turn about an axis, and name the likely cause."""
    bad = [n for n, fit in fits.items() if _wrong(fit, tracks, linkage.hinge[n])]
    if not bad:
        return
    worst = max(bad, key=lambda name: fits[name].residual_position)
    fit, hinge = fits[worst], linkage.hinge[worst]
    others = sorted({b for n in bad for b in (linkage.hinge[n].body_a, linkage.hinge[n].body_b)})
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
            one = linkage.hinge[waiting.pop()]
            for body in (one.body_a, one.body_b):
                for name in linkage.carried[body]:
                    if name not in fits or name in found:
                        continue
                    agree = _direction(fits[name], linkage.hinge[name], body) @ _direction(
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
        at = None if through is None else through[body]
        distance = axis_distance(axes.axis(one, body), axes.axis(two, body), at)
        found[label] = Value(distance.value, distance.sigma)
    return found


def shared_body(linkage: LoopedPart, one: str, two: str) -> str | None:
    """Return the body that carries both hinges, or None without one."""
    return next(
        (b for b in linkage.bodies if one in linkage.carried[b] and two in linkage.carried[b]), None
    )


#: Samples within this of the description's own shape at home stand for it where the start is not
#: still. Source: our own choice. [rad]
LIKE_HOME_RAD = 0.02


@dataclass(frozen=True, eq=False)
class Home:
    """The linkage at joint positions 0.

    Attributes:
        samples: which samples are taken for home, (n,)
        still: whether they are a still start; else they look like the description's home
        poses: {body: T_first_body (4, 4)} of each body's markers in the first tracked body's
        angles: {hinge: its angle there [rad]}
    """

    samples: Mask
    still: bool
    poses: Mapping[str, Array]
    angles: Mapping[str, Value]


def find_home(tracks: Tracks, axes: Axes) -> tuple[Axes, Home]:
    """Find home, and which way the axes point.

    Returns:
        the axes, directed as in the description, and home

    Raises:
        TracksError: the arm rests at the end and not at the start, as in reversed time
    """
    angles = {name: axes.angles(name) for name in axes.fits}
    samples = still_start(tracks.times, angles)
    if samples is None:
        end = still_start(-tracks.times[::-1], {k: angle[::-1] for k, angle in angles.items()})
        if end is not None:
            rest = float(np.ptp(tracks.times[::-1][end]))
            raise TracksError(
                tracks.file,
                f"the arm rests for {rest:.2f} s at the end and not at the start: is the time"
                f" reversed? allowed: a rest of {STILL_S:g} s at joint positions 0 at the start",
            )
    if samples is not None:
        home = _home(axes, samples, True)
        flipped = turned_over(axes)
        right = _misfit(axes, home) <= _misfit(flipped, home)
        return (axes, home) if right else (flipped, _home(flipped, samples, True))
    found = [_like_description(one) for one in (axes, turned_over(axes))]
    return min(found, key=lambda pair: _misfit(*pair))


def _home(axes: Axes, samples: Mask, still: bool) -> Home:
    angles: dict[str, Value] = {}
    for name in axes.fits:
        here = axes.angles(name)[samples]
        here = here[np.isfinite(here)]
        if len(here):
            angles[name] = Value(
                float(here.mean()), axes.widened * float(here.std() / np.sqrt(len(here)))
            )
    return Home(samples, still, _chained(axes, angles), angles)


def _chained(axes: Axes, angles: Mapping[str, Value]) -> dict[str, Array]:
    """Return the poses of the bodies at these angles, from hinge to hinge."""
    linkage = axes.linkage
    first = next(b for b in linkage.bodies if any(n in angles for n in linkage.carried[b]))
    found = {first: np.eye(4)}
    for body, way in _ways(linkage, first, angles).items():
        if way:
            hinge = linkage.hinge[way[-1]]
            relative = _relative(axes, hinge.name, angles[hinge.name].value)
            found[body] = (
                found[hinge.body_a] @ relative
                if body == hinge.body_b
                else found[hinge.body_b] @ inverse(relative)
            )
    return found


def _ways(linkage: LoopedPart, start: str, hinges: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Return the shortest way from a body to each that some hinges connect with it.

    Args:
        linkage: the loops
        start: a body
        hinges: names of the hinges to go by

    Returns:
        {body: hinges on the way}, the nearest first
    """
    found: dict[str, tuple[str, ...]] = {start: ()}
    waiting = [start]
    for body in waiting:
        for name in linkage.carried[body]:
            hinge = linkage.hinge[name]
            other = hinge.body_b if body == hinge.body_a else hinge.body_a
            if name in hinges and other not in found:
                found[other] = (*found[body], name)
                waiting.append(other)
    return found


def _relative(axes: Axes, name: str, angle: float) -> Array:
    """Return T_ab of a hinge at an angle, (4, 4)."""
    fit = axes.fits[name]
    return fit.before @ transform(rotation_z(axes.signs[name] * angle), np.zeros(3)) @ fit.after


@dataclass(frozen=True, eq=False)
class FlatAxes:
    """The axes at home in the plane across their mean direction.

    Attributes:
        points: {(hinge, body): (2,) [m]} as each body has it, about the first hinge
        plane: T_first_plane (4, 4), whose z axis is the mean direction
    """

    points: Mapping[tuple[str, str], Array]
    plane: Array


def in_plane(axes: Axes, home: Home) -> FlatAxes:
    """Project the axes at home on the plane across their mean direction."""
    points: dict[tuple[str, str], Array] = {}
    directions: list[Array] = []
    for name in axes.fits:
        hinge = axes.linkage.hinge[name]
        for body in (hinge.body_a, hinge.body_b):
            if body in home.poses:
                axis, pose = axes.axis(name, body), home.poses[body]
                points[name, body] = pose[:3, :3] @ axis.point + pose[:3, 3]
                directions.append(pose[:3, :3] @ axis.direction)
    along = np.mean(directions, axis=0)
    along /= np.linalg.norm(along)
    turn = plane_across(along)
    origin = next(iter(points.values()))
    flat = {key: (turn.T @ (point - origin))[:2] for key, point in points.items()}
    return FlatAxes(flat, transform(turn, origin))


def _misfit(axes: Axes, home: Home) -> float:
    """Return the RMS distance of the axes at home from the description's, laid on them [m]."""
    flat = in_plane(axes, home).points
    got = np.stack(list(flat.values()))
    nominal = np.stack([axes.linkage.points[name] for name, _ in flat])
    angle, shift = planar_fit(got, nominal)
    return float(np.sqrt(np.mean((got @ planar_turn(angle).T + shift - nominal) ** 2)))


def planar_fit(points: Array, onto: Array) -> tuple[float, Array]:
    """Return the turn [rad] and shift (2,) that bring points nearest to others, (n, 2) each."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    cross = np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    angle = float(np.arctan2(cross, np.sum(a * b)))
    return angle, onto.mean(axis=0) - planar_turn(angle) @ points.mean(axis=0)


def planar_turn(angle: float) -> Array:
    """Return a rotation in the plane, (2, 2)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


def _like_description(axes: Axes) -> tuple[Axes, Home]:
    """Take the samples for home at which the linkage looks most as the description has it."""
    # Of one hinge, compare the angle between a line of either body, to another hinge that it has.
    shapes = (_shape(axes, name) for name in axes.fits)
    name, measured, nominal = next(shape for shape in shapes if shape is not None)
    # Turning a hinge by its angle turns the line behind it by as much.
    away = np.abs(np.angle(np.exp(1j * (measured + axes.angles(name) - nominal))))
    allowed = max(LIKE_HOME_RAD, float(np.nanmin(away)) * 1.05)
    return axes, _home(axes, np.where(np.isfinite(away), away, np.inf) <= allowed, False)


def _shape(axes: Axes, name: str) -> tuple[str, float, float] | None:
    """Return a hinge and the angle between lines of its two bodies at angle 0 and as described.

    The lines lead from the hinge to another one; None where a body has none that is measured.
    """
    points, hinge = axes.linkage.points, axes.linkage.hinge[name]
    measured: list[Array] = []
    nominal: list[Array] = []
    for body in (hinge.body_a, hinge.body_b):
        other = next(
            (n for n in axes.linkage.carried[body]
             if np.linalg.norm(points[n] - points[name]) > APART_M), None,
        )  # fmt: skip
        if other not in axes.fits or other is None:
            return None
        measured.append(axes.axis(other, body).point - axes.axis(name, body).point)
        nominal.append(points[other] - points[name])
    about = axes.axis(name, hinge.body_a).direction
    a, b = measured[0], _relative(axes, name, 0.0)[:3, :3] @ measured[1]
    a, b = a - (a @ about) * about, b - (b @ about) * about
    c, d = nominal
    drawn = float(np.arctan2(c[0] * d[1] - c[1] * d[0], c @ d))
    return name, float(np.arctan2(np.cross(a, b) @ about, a @ b)), drawn


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
    hinge = axes.linkage.hinge[first]
    body = next(b for b in (hinge.body_a, hinge.body_b) if b in home.poses)
    axis = axes.axis(first, body)
    point, shown = axis.point, base is not None and body == axes.linkage.ground
    if base is not None and shown:  # the point of the first axis nearest to the ground's own
        cosine = float(axis.direction @ base.direction)
        between = base.point - point
        along = between @ axis.direction - cosine * (between @ base.direction)
        point = point + along / (1.0 - cosine**2) * axis.direction
    at_home = home.poses[body][:3, :3] @ point + home.poses[body][:3, 3]
    points = {
        b: T[:3, :3] @ at_home + T[:3, 3]
        for b, T in ((b, inverse(pose)) for b, pose in home.poses.items())
    }
    return Datum(at_home, points, shown)


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
        one, two = (shared_body(axes.linkage, *pair) for pair in (to, start))
        seen = one in home.poses and two in home.poses
        if one and two and seen and all(hinge in axes.fits for hinge in (*to, *start)):
            ends = [(hinge, one) for hinge in to] + [(hinge, two) for hinge in start]
            way = _ways(axes.linkage, one, home.angles).get(two, ())
            found[name] = _beta(axes, home, ends, way, through)
    return found


def _beta(
    axes: Axes, home: Home, ends: Sequence[Pair], way: Sequence[str], through: Array
) -> Value:
    """Measure one angle and its standard deviation.

    What each sample's noise does to the lines is summed over the axes before it is squared; the
    noise of home, which is the mean of the still start, comes on top.

    Args:
        axes: as measured
        home: a still start
        ends: (hinge, body) of each end of both lines
        way: hinges between the two bodies
        through: see `betas`
    """
    at = [axes.axis(hinge, body) for hinge, body in ends]
    start = np.concatenate([np.concatenate([axis.point, axis.direction]) for axis in at])

    def angle(numbers: Array) -> float:
        p = numbers.reshape(4, 6)
        a, b, c, d = (
            Line(p[i, :3], p[i, 3:]).moved(home.poses[body]) for i, (_, body) in enumerate(ends)
        )
        return line_angle((a, b), (c, d), through)

    moved = np.concatenate([axis.influence for axis in at], axis=1) @ slopes(angle, start)
    still = sum(home.angles[name].sigma ** 2 for name in way)
    return Value(angle(start) - 0.5 * np.pi, float(np.sqrt(moved @ moved + still)))
