"""Home: the joint positions 0, as the still start of the tracks has them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.axes import Axes, Value, turned_over
from trocar.apps.calibration.linkage import Linkage
from trocar.geometry import inverse, rotation_z, transform

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: A start that is still for less is none. Source: the statement of the method. [s]
STILL_S = 0.5
# Source: our own choice. The angles are averaged over this long, and what moves between two such
# stretches by more than noise and this much is not still. [s], [rad]
WINDOW_S, MOVED_RAD = 0.1, 2e-5
# Source: our own choice: five standard deviations, which no still stretch reaches.
BEYOND_NOISE = 5.0
#: Samples within this of the description's own shape at home stand for it where the start is not
#: still. Source: our own choice. [rad]
LIKE_HOME_RAD = 0.02

Line = tuple[str, str]


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
    """Return until when an angle keeps still, two stretches on the safe side."""
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


def find_home(times: Array, axes: Axes) -> tuple[Axes, Home]:
    """Find home, and which way the axes point.

    Returns:
        the axes, directed as in the description, and home
    """
    samples = still_start(times, {name: axes.angles(name) for name in axes.fits})
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
            angles[name] = Value(float(here.mean()), float(here.std() / np.sqrt(len(here))))
    return Home(samples, still, _chained(axes, angles), angles)


def _chained(axes: Axes, angles: Mapping[str, Value]) -> dict[str, Array]:
    """Return where the bodies stand at these angles, from hinge to hinge."""
    linkage = axes.linkage
    first = next(b for b in linkage.bodies if any(n in angles for n in linkage.carried(b)))
    found = {first: np.eye(4)}
    waiting = [first]
    while waiting:
        body = waiting.pop(0)
        for name in linkage.carried(body):
            hinge = linkage.hinge(name)
            other = hinge.body_b if body == hinge.body_a else hinge.body_a
            if name not in angles or other in found:
                continue
            relative = _relative(axes, name, angles[name].value)
            found[other] = found[body] @ (relative if body == hinge.body_a else inverse(relative))
            waiting.append(other)
    return found


def _relative(axes: Axes, name: str, angle: float) -> Array:
    """Return T_ab of a hinge at an angle, (4, 4)."""
    fit = axes.fits[name]
    return fit.before @ transform(rotation_z(axes.signs[name] * angle), np.zeros(3)) @ fit.after


def in_plane(axes: Axes, home: Home) -> tuple[dict[tuple[str, str], Array], Array]:
    """Project the axes at home on the plane across their mean direction.

    Returns:
        {(hinge, body): (2,) [m]} as each body has it, about the first hinge; and T_first_plane
        (4, 4), whose z axis is the mean direction
    """
    points: dict[tuple[str, str], Array] = {}
    directions: list[Array] = []
    for name in axes.fits:
        hinge = axes.linkage.hinge(name)
        for body in (hinge.body_a, hinge.body_b):
            if body in home.poses:
                axis, pose = axes.axis(name, body), home.poses[body]
                points[name, body] = pose[:3, :3] @ axis.point + pose[:3, 3]
                directions.append(pose[:3, :3] @ axis.direction)
    along = np.mean(directions, axis=0)
    along /= np.linalg.norm(along)
    start = np.eye(3)[int(np.argmin(np.abs(along)))]
    one = np.cross(along, np.cross(start, along))
    one /= np.linalg.norm(one)
    turn = np.column_stack([one, np.cross(along, one), along])
    origin = next(iter(points.values()))
    flat = {key: (turn.T @ (point - origin))[:2] for key, point in points.items()}
    return flat, transform(turn, origin)


def _misfit(axes: Axes, home: Home) -> float:
    """Return how far the axes at home are from the description's, as nearly as they fit [m]."""
    flat, _ = in_plane(axes, home)
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
    name = next(n for n in axes.fits if _shape(axes, n, 0.0) is not None)
    wanted = _nominal_shape(axes.linkage, name)
    angles = axes.angles(name)
    start = _shape(axes, name, 0.0)
    # Turning a hinge by its angle turns the line behind it by as much.
    away = np.abs(_wrapped(float(start or 0.0) + angles - wanted))
    nearest = float(np.nanmin(away))
    samples = np.where(np.isfinite(away), away, np.inf) <= max(LIKE_HOME_RAD, nearest * 1.05)
    return axes, _home(axes, samples, False)


def _lines(linkage: Linkage, name: str) -> tuple[Line, Line] | None:
    """Return a line of either body of a hinge, from the hinge to another one that they carry."""
    hinge = linkage.hinge(name)
    found: list[Line] = []
    for body in (hinge.body_a, hinge.body_b):
        others = [
            n
            for n in linkage.carried(body)
            if np.linalg.norm(linkage.points[n] - linkage.points[name]) > 1e-3
        ]
        if not others:
            return None
        found.append((name, others[0]))
    return found[0], found[1]


def _nominal_shape(linkage: Linkage, name: str) -> float:
    lines = _lines(linkage, name)
    one, two = (linkage.points[b] - linkage.points[a] for a, b in lines or ())
    return float(np.arctan2(one[0] * two[1] - one[1] * two[0], one @ two))


def _shape(axes: Axes, name: str, angle: float) -> float | None:
    """Return the angle between the lines of a hinge's two bodies at its angle, as measured."""
    lines = _lines(axes.linkage, name)
    if lines is None or any(line[1] not in axes.fits for line in lines):
        return None
    hinge = axes.linkage.hinge(name)
    one = _vector(axes, lines[0], hinge.body_a)
    two = _relative(axes, name, angle)[:3, :3] @ _vector(axes, lines[1], hinge.body_b)
    return signed_angle(one, two, axes.axis(name, hinge.body_a).direction)


def _vector(axes: Axes, line: Line, body: str) -> Array:
    return axes.axis(line[1], body).point - axes.axis(line[0], body).point


def signed_angle(one: Array, two: Array, about: Array) -> float:
    """Return the angle from one vector to another as seen along an axis [rad]."""
    a, b = one - (one @ about) * about, two - (two @ about) * about
    return float(np.arctan2(np.cross(a, b) @ about, a @ b))


def _wrapped(angle: Array) -> Array:
    return np.angle(np.exp(1j * angle))


__all__ = ["Home", "find_home", "in_plane", "planar_fit", "planar_turn", "signed_angle"]
