"""Virtual fixtures from TOML: regions of space for tool tips, and how a fixture acts.

A region is the set of allowed points. One function describes it: `nearest` returns the allowed
point nearest to a point. The potential k/2 d^2 of the distance d = |nearest(p) - p| then has the
gradient k (p - nearest(p)), so that force and filter follow from it.

Source: Rosenberg, "Virtual fixtures", IEEE VRAIS, 1993; Bowyer, Davies and Rodriguez y Baena,
"Active constraints/virtual fixtures: a survey", IEEE Trans. Robotics 30(1), 2014 (regional
constraints, potential fields).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, Protocol, cast, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.keys import key
from trocar.descriptions.table import Table, read_table

Array = NDArray[np.float64]
Mode = Literal["force", "filter"]
MODES: tuple[str, ...] = get_args(Mode)

#: The frame that stands still.
WORLD = "world"
#: Largest force unless a file gives another. Source: our own choice; a master's outer yaw exerts
#: up to 1.86 N m (SAW), 5 N at the handle. [N]
FORCE_MAX_N = 5.0
#: Cosine between the radius of an arc and its normal that counts as none. Source: our own choice,
#: rounding of numbers in a file.
SQUARE = 1e-3


class Region(Protocol):
    """A closed set of allowed points."""

    def nearest(self, p: Array) -> Array:
        """Return the allowed point nearest to a point; both (3,) [m]."""
        ...


@dataclass(frozen=True, eq=False)
class Plane:
    """Half of space.

    Attributes:
        point: on the border, (3,) [m]
        normal: points to the allowed side, unit vector, (3,)
    """

    point: Array = field(metadata=key("length", size=3))
    normal: Array = field(metadata=key(form="direction"))

    def nearest(self, p: Array) -> Array:
        """Return the allowed point nearest to a point; both (3,) [m]."""
        return p + max(0.0, float(self.normal @ (self.point - p))) * self.normal


@dataclass(frozen=True, eq=False)
class Cone:
    """The inside of a cone, which narrows towards its apex.

    Attributes:
        apex: its point, (3,) [m]
        axis: from the apex into the cone, unit vector, (3,)
        half_angle: between axis and surface, above 0 and below pi/2 [rad]
    """

    apex: Array = field(metadata=key("length", size=3))
    axis: Array = field(metadata=key(form="direction"))
    half_angle: float = field(metadata=key("angle"))

    def nearest(self, p: Array) -> Array:
        """Return the allowed point nearest to a point; both (3,) [m]."""
        way = p - self.apex
        along = float(way @ self.axis)
        across = way - along * self.axis
        radius = float(np.linalg.norm(across))
        cosine, sine = math.cos(self.half_angle), math.sin(self.half_angle)
        if radius * cosine <= along * sine:
            return p.copy()
        slant = along * cosine + radius * sine
        if slant <= 0.0:
            return self.apex.copy()
        return self.apex + slant * (cosine * self.axis + sine / radius * across)


@dataclass(frozen=True, eq=False)
class Tube:
    """All points within a clearance of a path of straight pieces.

    Attributes:
        points: corners of the path, two or more, (k, 3) [m]
        clearance: radius of the tube [m]
    """

    points: Array = field(metadata=key(name="points_mm", form="any"))
    clearance: float = field(metadata=key("length", above=0.0))

    def nearest(self, p: Array) -> Array:
        """Return the allowed point nearest to a point; both (3,) [m]."""
        starts, ways = self.points[:-1], np.diff(self.points, axis=0)
        ratios = ((p - starts) * ways).sum(axis=1) / (ways * ways).sum(axis=1)
        feet = starts + np.clip(ratios, 0.0, 1.0)[:, None] * ways
        foot = feet[((p - feet) ** 2).sum(axis=1).argmin()]
        return _within(p, foot, self.clearance)


@dataclass(frozen=True, eq=False)
class NeedleArc:
    """All points within a clearance of an arc of a circle, the path of a curved needle.

    Attributes:
        center: of the circle, (3,) [m]
        normal: axis about which the arc runs, right-handed, unit vector, (3,)
        start: first point of the arc, (3,) [m]
        sweep: angle of the arc, above 0 to 2 pi [rad]
        clearance: radius of the tube about the arc [m]
    """

    center: Array = field(metadata=key("length", size=3))
    normal: Array = field(metadata=key(form="direction"))
    start: Array = field(metadata=key("length", size=3))
    sweep: float = field(metadata=key("angle"))
    clearance: float = field(metadata=key("length", above=0.0))

    def nearest(self, p: Array) -> Array:
        """Return the allowed point nearest to a point; both (3,) [m]."""
        radial = self.start - self.center
        way = p - self.center
        x, y = float(way @ radial), float(way @ np.cross(self.normal, radial))
        angle = math.atan2(y, x) % math.tau
        if angle > self.sweep:  # the nearer end
            angle = 0.0 if math.tau - angle < angle - self.sweep else self.sweep
        return _within(p, self.at(angle), self.clearance)

    def at(self, angle: float) -> Array:
        """Return the point of the circle at an angle from the start [rad], (3,) [m]."""
        radial = self.start - self.center
        across = np.cross(self.normal, radial)
        return self.center + math.cos(angle) * radial + math.sin(angle) * across


@dataclass(frozen=True, eq=False)
class Fixture:
    """A region, and how it acts on the tip of an arm.

    Attributes:
        name: unique in the file; default: its kind
        arm: the PSM whose tip it guides
        mode: `force`: masters push the hand back into the region; `filter`: commanded tip positions
            are replaced by the nearest allowed ones
        frame: the world, an arm (its reference frame) or a movable prop
        region: allowed points in that frame
        stiffness: at the master's handle; 0 of a filter [N/m]
        force_max: largest force [N]
        file, key: place of its table
    """

    name: str = field(metadata=key(default=""))
    arm: str = field(metadata=key())
    mode: Mode = field(metadata=key())
    frame: str = field(metadata=key(default=WORLD))
    region: Region
    stiffness: float = field(
        default=0.0,
        metadata=key("linear stiffness", above=0.0, of=("force",), default=...),
    )
    force_max: float = field(
        default=0.0, metadata=key("force", above=0.0, of=("force",), default=FORCE_MAX_N)
    )
    file: str = ""
    key: str = ""

    def force(self, p: Array, scale: float = 1.0) -> Array:
        """Return the force at the master for a tip at p, in axes of the fixture's frame, (3,) [N].

        The negative gradient of a potential of the master's position: k/2 d^2 of the distance d to
        the region, and linear in d from where the force is the largest. The slave's distance counts
        as d = distance / scale at the master.

        Args:
            p: tip in the fixture's frame, (3,) [m]
            scale: the slave's translation over the master's
        """
        force = self.stiffness / scale * (self.region.nearest(p) - p)
        size = float(np.linalg.norm(force))
        return force if size <= self.force_max else self.force_max / size * force


def read_fixtures(path: str | Path) -> tuple[Fixture, ...]:
    """Read the fixtures of a TOML file.

    Raises:
        DescriptionError: the file cannot be read, or an entry is wrong or missing; names file, key,
            what was got and what is allowed
    """
    table = read_table(Path(path).expanduser())
    table.check_schema()
    found = table.each("fixture", _read_fixture, again="name")
    if not found:
        raise table.fail("fixture", "is missing; allowed: one or more [[fixture]] tables")
    table.done()
    return found


def _read_fixture(row: Table) -> Fixture:
    kind = row.text("kind", allowed=tuple(REGIONS))
    region = REGIONS[kind](row)
    mode = row.text("mode", allowed=MODES)
    return row.record(
        Fixture, mode, region=region, defaults={"name": kind}, file=row.file, key=row.path
    )


def _plane(row: Table) -> Plane:
    return row.record(Plane)


def _cone(row: Table) -> Cone:
    cone = row.record(Cone)
    if not 0.0 < cone.half_angle < 0.5 * math.pi:
        raise row.fail(
            "half_angle", f"got {cone.half_angle:g} rad; allowed: above 0 and below pi/2 (90 deg)"
        )
    return cone


def _tube(row: Table) -> Tube:
    rows = row.raw("points_mm")
    if not isinstance(rows, list) or len(cast(list[object], rows)) < 2:
        raise row.fail("points_mm", f"got {rows!r}; allowed: 2 or more points of 3 numbers")
    points = 1e-3 * row.matrix("points_mm", len(cast(list[object], rows)), 3)
    if (np.diff(points, axis=0) == 0.0).all(axis=1).any():
        raise row.fail("points_mm", "got the same point twice in a row; allowed: different ones")
    return row.record(Tube, points=points)


def _needle_arc(row: Table) -> NeedleArc:
    arc = row.record(NeedleArc)
    out = arc.start - arc.center
    radius, rise = float(np.linalg.norm(out)), float(arc.normal @ out)
    if radius == 0.0 or abs(rise) > SQUARE * radius:
        raise row.fail("start", "allowed: a point in the plane through center, square to normal")
    if not 0.0 < arc.sweep <= math.tau:
        raise row.fail("sweep", f"got {arc.sweep:g} rad; allowed: above 0 to 2 pi (360 deg)")
    if arc.clearance >= radius:
        raise row.fail(
            "clearance",
            f"got {arc.clearance:g} m; allowed: below the radius of the arc, {radius:g} m",
        )
    return replace(arc, start=arc.start - (arc.normal @ out) * arc.normal)


#: {kind: reader of its region}.
REGIONS: dict[str, Callable[[Table], Region]] = {
    "plane": _plane,
    "cone": _cone,
    "tube": _tube,
    "needle_arc": _needle_arc,
}


def _within(p: Array, foot: Array, clearance: float) -> Array:
    """Return the point nearest to p in the ball about the foot, (3,)."""
    way = p - foot
    distance = float(np.linalg.norm(way))
    return p.copy() if distance <= clearance else foot + clearance / distance * way
