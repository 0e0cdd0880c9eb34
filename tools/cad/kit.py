"""Tools of the trade for the solids: hinges from the mechanism, plates, pins, caps, housings.

Everything is in millimetres, in the frame of the link that is being drawn. A dimension between two
axes comes from `hinge`; what a function here is told as a number is thickness and shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from build123d import (
    Axis,
    BuildSketch,
    Circle,
    Face,
    GeomType,
    Location,
    Locations,
    Plane,
    Polyline,
    Pos,
    Rectangle,
    RectangleRounded,
    Rot,
    Sketch,
    Solid,
    Vector,
    Wire,
    chamfer,
    extrude,
    fillet,
    loft,
    make_hull,
)
from build123d.topology import Shape
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, UnknownNameError
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import pose
from trocar.kinematics.mechanism import Closure, Mechanism

Array = NDArray[np.float64]
#: A circle of an outline: x, y of its centre and its radius [mm].
Disc = tuple[float, float, float]
#: Millimetres in a metre.
MM = 1000.0


@dataclass(frozen=True, eq=False)
class Hinge:
    """The axis of a joint as one link sees it.

    Attributes:
        point: a point on the axis, (3,) [mm]; the other frame's origin, or the closing point
        direction: unit vector along the axis, (3,)
    """

    point: Array
    direction: Array

    def at(self, z: float) -> Array:
        """Return where the axis crosses the plane z of the link's frame, (3,) [mm]."""
        return self.point + self.direction * ((z - self.point[2]) / self.direction[2])

    def disc(self, radius: float, dx: float = 0.0, dy: float = 0.0) -> Disc:
        """Return a circle about the axis in the plane z = 0, moved by (dx, dy) [mm]."""
        x, y, _ = self.at(0.0)
        return (float(x) + dx, float(y) + dy, radius)

    def plane(self, along: float = 0.0) -> Plane:
        """Return the plane across the axis, `along` past its point [mm]."""
        origin = self.point + along * self.direction
        return Plane(origin=Vector(*origin), z_dir=Vector(*self.direction))


def hinge(mechanism: Mechanism, link: str, name: str) -> Hinge:
    """Return the axis of frame or closing point `name`, as the body of frame `link` carries it.

    Args:
        mechanism: of the arm, calibrated or not
        link: the frame that the body moves with
        name: `link` itself, a frame that hangs on it (over fixed frames too), or a closure

    Raises:
        UnknownNameError: no such frame, or its axis does not stand still on this body
    """
    closure = next((c for c in mechanism.closures if c.name == name), None)
    if closure is not None:
        return _closing(mechanism, link, closure)
    if name == link:
        own = inverse(mechanism.frame(link).after)
        return Hinge(own[:3, 3] * MM, own[:3, 2])
    pose = axis_pose(mechanism, link, name)
    return Hinge(pose[:3, 3] * MM, pose[:3, 2])


def _closing(mechanism: Mechanism, link: str, closure: Closure) -> Hinge:
    """Return the axis of a closing hinge; a pin that slides belongs to the link it slides in."""
    along = np.array([0.0, 0.0, 1.0])
    if link == closure.frame_a:
        return Hinge(closure.point_a * MM, along)
    if link == closure.frame_b:
        return Hinge(closure.point_b * MM, along)
    pin = mechanism.frame(closure.frame_b)
    if pin.parent != link:
        raise UnknownNameError("axis", closure.name, [closure.frame_a, closure.frame_b], link)
    return Hinge(pin.before[:3, 3] * MM, pin.before[:3, 2])


def axis_pose(mechanism: Mechanism, link: str, name: str) -> Array:
    """Return where frame `name` stands on the body of frame `link` at coordinate 0, (4, 4) [m].

    Raises:
        UnknownNameError: another joint lies between them
    """
    frame = mechanism.frame(name)
    pose = frame.before if frame.motion != "fixed" else frame.before @ frame.after
    while frame.parent != link:
        if frame.parent is None or mechanism.frame(frame.parent).motion != "fixed":
            known = [f.name for f in mechanism.frames if f.parent == link]
            raise UnknownNameError("axis", name, known, link)
        frame = mechanism.frame(frame.parent)
        pose = frame.before @ frame.after @ pose
    return pose


# ---------------------------------------------------------------- flat things: plates and links


def outline(*chains: Sequence[Disc]) -> Shape:
    """Return the union of belts: each chain of circles is joined pairwise by common tangents."""
    return together([hull(pair) for chain in chains for pair in pairwise(chain)])


def hull(discs: Sequence[Disc]) -> Shape:
    """Return the convex hull of circles."""
    with BuildSketch() as sketch:
        for x, y, radius in discs:
            with Locations((x, y)):
                Circle(radius)
        make_hull()
    return Sketch(sketch.faces())


def polygon(points: Sequence[tuple[float, float]], rounding: float = 0.0) -> Shape:
    """Return a polygon whose corners are rounded alike."""
    face = Sketch() + Face(Wire(Polyline(*points, close=True).edges()))
    return fillet(face.vertices(), rounding) if rounding else face


def plate(
    sketch: Shape, low: float, high: float, edge: float = 0.0, round_off: bool = False
) -> Shape:
    """Return an outline as a plate between the planes z = low and z = high.

    Args:
        sketch: the outline in the x-y plane
        low, high: the two faces [mm]
        edge: how much is taken off its rims [mm]
        round_off: round the rims instead of bevelling them
    """
    solid = _upright(sketch, low, high)
    if not edge:
        return solid
    rims = solid.faces().filter_by(Axis.Z).edges()
    return fillet(rims, edge) if round_off else chamfer(rims, edge)


def pad(sketch: Shape, low: float, high: float, edge: float, round_off: bool = False) -> Shape:
    """Return an outline as a plate that lies on something: only the rim at z = high is worked.

    Args:
        sketch: the outline in the x-y plane
        low: what it lies on or in; below `high` or above it [mm]
        high: its face [mm]
        edge: how much is taken off the rim of its face [mm]
        round_off: round the rim instead of bevelling it
    """
    solid = _upright(sketch, *sorted((low, high)))
    faces = solid.faces().sort_by(Axis.Z)
    rim = faces[-1 if high > low else 0].edges()
    return fillet(rim, edge) if round_off else chamfer(rim, edge)


def _upright(sketch: Shape, low: float, high: float) -> Shape:
    return extrude(Sketch((Pos(0, 0, low) * sketch).faces()), high - low, (0, 0, 1))


def mirrored(part: Shape) -> Shape:
    """Return the part and its mirror image in the plane z = 0, as one."""
    return part + part.mirror(Plane.XY)


# ---------------------------------------------------------------- round things: pins, caps, lathe


def pin(at: Hinge, low: float, high: float, radius: float, bevel: float = 0.0) -> Shape:
    """Return a cylinder about an axis, from `low` to `high` along it, measured from its point."""
    solid = Solid.make_cylinder(radius, high - low, at.plane(low))
    rims = solid.edges().filter_by(GeomType.CIRCLE)
    return chamfer(rims, bevel) if bevel else solid


def cap(at: Hinge, low: float, high: float, radius: float) -> Shape:
    """Return the cover of a joint: a disc with a bevelled face and a shallow ring in it.

    Args:
        at: the axis
        low: where it lies on the link, along the axis [mm]
        high: its face; below `low` it looks the other way [mm]
        radius: [mm]
    """
    side = 1.0 if high > low else -1.0
    tall = abs(high - low)
    rim, dip = min(0.4 * tall, 0.12 * radius), min(0.3 * tall, 1.2)
    profile = [
        (0.0, 0.0),
        (radius, 0.0),
        (radius, tall - rim),
        (radius - rim, tall),
        (0.62 * radius, tall),
        (0.54 * radius, tall - dip),
        (0.0, tall - dip),
    ]
    turned = Hinge(at.point, side * at.direction)
    return turning(turned, [(r, side * low + z) for r, z in profile])


def turning(at: Hinge, profile: Sequence[tuple[float, float]], rounding: float = 0.0) -> Shape:
    """Return a turned part: a closed profile of (radius, height along the axis) points [mm].

    Args:
        at: the axis, and the height 0 at its point
        profile: closed polygon; points at radius 0 lie on the axis
        rounding: of every corner off the axis [mm]
    """
    face = Face(Wire(Polyline(*[(r, 0.0, z) for r, z in profile], close=True).edges()))
    if rounding:
        corners = [v for v in face.vertices() if v.X > 1e-6]
        face = face.fillet_2d(rounding, corners)
    solid = Solid.revolve(face, 360.0, Axis.Z)
    return at.plane().location * solid


def tube(at: Hinge, low: float, high: float, radius: float, bore: float) -> Shape:
    """Return a tube about an axis."""
    return turning(at, [(bore, low), (radius, low), (radius, high), (bore, high)])


# ---------------------------------------------------------------- boxes and lofts


def rounded_box(
    center: ArrayLike, size: ArrayLike, edge: float, upright: float | None = None
) -> Shape:
    """Return a box with rounded edges.

    Args:
        center: (3,) [mm]
        size: full edges, (3,) [mm]
        edge: radius of the edges [mm]
        upright: radius of the four edges along z, `edge` when omitted [mm]
    """
    x, y, z = (float(v) for v in np.asarray(center))
    a, b, c = (float(v) for v in np.asarray(size))
    solid = extrude(Pos(0, 0, -c / 2) * RectangleRounded(a, b, upright or edge), c)
    rims = solid.faces().filter_by(Axis.Z).edges()
    return Pos(x, y, z) * fillet(rims, edge)


def lofted(sections: Sequence[tuple[float, float, float, float, float, float]]) -> Shape:
    """Return a body along x through rounded rectangles.

    Args:
        sections: (x, y, z, tall along y, wide along z, corner radius) in ascending x [mm]
    """
    faces: list[Sketch] = []
    for x, y, z, tall, wide, corner in sections:
        at = Pos(x, y, z) * Rot(0, 90, 0)
        faces.append(at * RectangleRounded(wide, tall, corner))
    return loft(faces, ruled=True)


def box(low: ArrayLike, high: ArrayLike) -> Shape:
    """Return a plain box between two corners; for cutting."""
    a, b = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    x, y, z = (float(v) for v in (a + b) / 2)
    size = b - a
    blank = extrude(Rectangle(float(size[0]), float(size[1])), float(size[2]) / 2, both=True)
    return Pos(x, y, z) * blank


def block(low: ArrayLike, high: ArrayLike, bevel: float) -> Shape:
    """Return a box between two corners with bevelled edges, which costs few triangles."""
    return chamfer(box(low, high).edges(), bevel)


def prism(at: Hinge, low: float, high: float, radius: float, sides: int = 8) -> Shape:
    """Return a prism about an axis that a cylinder of `radius` fits into; for what touches."""
    turns = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    reach = radius / np.cos(np.pi / sides)
    corners = [(float(reach * np.cos(t)), float(reach * np.sin(t))) for t in turns]
    return at.plane(low).location * plate(polygon(corners), 0.0, high - low)


def location(pose: Array) -> Location:
    """Return a pose [m] as build123d moves things by it [mm]."""
    x, y, z = (float(v) for v in MM * pose[:3, 3])
    across, along = Vector(*pose[:3, 0]), Vector(*pose[:3, 2])
    return Plane(origin=Vector(x, y, z), x_dir=across, z_dir=along).location


def point(pose: Array, x: float, y: float, z: float) -> Array:
    """Return the point (x, y, z) [mm] of a frame that stands at `pose` [m], (3,) [mm]."""
    return pose[:3, :3] @ np.array([x, y, z]) + MM * pose[:3, 3]


def together(shapes: Sequence[Shape]) -> Shape:
    """Return the union of shapes."""
    whole = shapes[0]
    for shape in shapes[1:]:
        whole = whole + shape
    return whole


def split(body: Shape, cutter: Shape) -> tuple[Shape, Shape]:
    """Return what of a body lies outside and what inside a cutter that goes through it.

    Raises:
        InputError: they have nothing in common
    """
    inside = body & cutter
    if not inside:
        raise InputError("the cutter misses the body")
    return body - cutter, inside


def bar(start: float, end: float, y: float, tall: float, wide: float) -> Shape:
    """Return the smooth cover of a long link along x, slimmer at its ends.

    Args:
        start, end: along x [mm]
        y: its middle, where it is thick [mm]
        tall, wide: along y and z [mm]
    """
    slim = (0.6 * y, 0.0, 0.8 * tall, 0.8 * wide, 0.27 * tall)
    full = (y, 0.0, tall, wide, 0.34 * tall)
    stations = [(start, *slim), (start + 26, *full), (end - 26, *full), (end, *slim)]
    return together([lofted(stations[k : k + 2]) for k in range(3)])


def bored(eye: Shape, axes: Sequence[Hinge], radius: float) -> Shape:
    """Return a link with a bore along each axis; half a millimetre of it is play."""
    for at in axes:
        eye = eye - pin(at, -60.0, 60.0, radius + 0.5)
    return eye


def cap_pair(at: Hinge, layer: float, tall: float, radius: float) -> list[Shape]:
    """Return the two caps of a hinge, on the outside of plates that end at z = +-layer."""
    return [cap(at, s * layer, s * (layer + tall), radius) for s in (-1.0, 1.0)]


@dataclass(frozen=True, eq=False)
class Cannula:
    """A cannula and what holds it: the mount (casting), bands and latches (joint), the tube."""

    mount: Shape
    dark: tuple[Shape, ...]
    tube: Shape


def shaft_axis(m: Mechanism, link: str) -> Hinge:
    """Return the axis of insertion, its point at insertion 0, in the last link before it."""
    frame = m.frame("insertion")
    at_zero = frame.before
    while frame.parent is not None and frame.parent != link:
        frame = m.frame(frame.parent)
        at_zero = frame.before @ frame.after @ at_zero
    return Hinge(at_zero[:3, 3] * MM, at_zero[:3, 2])


def remote_centre(m: Mechanism, shaft: Hinge, link: str) -> float:
    """Return how far along the shaft's axis, from its point, the remote centre lies [mm]."""
    at_zero = pose(m, np.zeros(len(m.joints)), m.reference, link)
    return float((MM * at_zero[:3, 3] - shaft.point) @ shaft.direction)


def cannula(
    m: Mechanism, link: str, radius: float, past: float, rail: tuple[float, float]
) -> Cannula:
    """Return the cannula about the axis of insertion.

    Args:
        m: of the arm
        link: the frame of the link that holds it
        radius: of the tube [mm]; it is 0.8 mm thick
        past: how far it reaches beyond the remote centre [mm]
        rail: x of the middle and y of the lower end of the rail that the mount hangs on [mm]
    """
    shaft = shaft_axis(m, link)
    rcm = remote_centre(m, shaft, link)
    bore, bowl = radius - 0.8, 2.4 * radius
    heights = ((bore, -84), (bowl, -84), (bowl, -79), (0.85 * bowl, -72), (radius, -58))
    profile = [*heights, (radius, past), (bore, past)]
    x, y, _ = shaft.point + (rcm - 70) * shaft.direction
    ring = tube(shaft, rcm - 77, rcm - 63, bowl + 2.5, 0.8 * bowl)
    reach = x - 0.9 * bowl
    neck = block((rail[0] - 8, y - 7, -12), (reach, y + 7, 12), 1.5)
    strut = rounded_box((rail[0], (rail[1] + y) / 2, 0), (16, y - rail[1] + 14, 30), 5.0)
    # The remote centre is marked as on the real one: a broad band, with a narrow one on each side.
    marks = [(z, 3.5 if z == 0 else 1.3) for z in (-18, -9, 0, 9) if z + 4 < past]
    bands = [
        tube(shaft, rcm + z - half, rcm + z + half, radius + 0.3, bore + 0.4) for z, half in marks
    ]
    latches = [
        block((x - 16, y - 4, z - 4), (x - 2, y + 4, z + 4), 1.5) for z in (bowl + 4.5, -bowl - 4.5)
    ]
    turned = turning(shaft, [(r, rcm + z) for r, z in profile])
    return Cannula(together([ring, neck, strut]), (*bands, *latches), turned)
