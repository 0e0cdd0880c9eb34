"""Plain forms that links are drawn with: prisms of an outline, turned bodies, boxes, pins."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal, cast

import numpy as np
from build123d import (
    Align,
    Axis,
    Box,
    Cylinder,
    Face,
    Plane,
    Polyline,
    Pos,
    Vector,
    Vertex,
    chamfer,
    extrude,
    fillet,
    make_face,
    mirror,
    revolve,
)
from build123d.topology import Shape

Point2 = tuple[float, float]
#: A corner of an outline: two coordinates, and the radius it is rounded with where that is given.
Corner = Sequence[float]
Point = Sequence[float]
Direction = Literal["x", "y", "z"]

#: Where the outline of a prism along an axis lies, and how its own two axes are turned.
PLANES = {
    "x": Plane.YZ,
    "y": Plane(origin=(0, 0, 0), x_dir=(1, 0, 0), z_dir=(0, -1, 0)),
    "z": Plane.XY,
}


def outline(corners: Sequence[Corner]) -> Face:
    """Return a plane face with straight edges and rounded corners.

    Args:
        corners: (u, v) or (u, v, radius) of each corner, in turn [mm]
    """
    points = [(corner[0], corner[1]) for corner in corners]
    face: Any = make_face(Polyline(*points, close=True))
    radii = {corner[2] for corner in corners if len(corner) == 3 and corner[2] > 0.0}
    for radius in sorted(radii):
        wanted = [Vector(c[0], c[1], 0.0) for c in corners if len(c) == 3 and c[2] == radius]
        picked = [v for v in face.vertices() if _near(v, wanted)]
        face = fillet(picked, radius)
    return cast(Face, face)


def prism(corners: Sequence[Corner], along: Direction, start: float, end: float) -> Shape:
    """Return an outline, drawn out along an axis.

    Args:
        corners: of the outline, in (y, z) along x, in (x, z) along y, in (x, y) along z [mm]
        along: the axis
        start, end: where it begins and ends on the axis [mm]
    """
    plane = PLANES[along]
    normal = plane.z_dir
    sign = normal.X + normal.Y + normal.Z
    raised: Any = extrude(outline(corners), amount=end - start)
    shifted = Pos(0, 0, start if sign > 0 else -end) * raised
    return cast(Shape, plane.location * shifted)


def turned(profile: Sequence[Corner], along: Direction = "z", angle: float = 360.0) -> Shape:
    """Return a body turned about an axis through the origin.

    Args:
        profile: (radius, height) of each corner [mm]
        along: the axis that height counts along
        angle: how far it is turned [deg]
    """
    face = Plane.XZ.location * outline(profile)  # u to x, v to z
    body: Any = revolve(face, Axis.Z, revolution_arc=angle)
    turns = {"z": Plane.XY, "x": Plane((0, 0, 0), (0, 1, 0), (1, 0, 0))}
    turns["y"] = Plane((0, 0, 0), (0, 0, 1), (0, 1, 0))
    return cast(Shape, turns[along].location * body)


def rod(start: Point, end: Point, radius: float) -> Shape:
    """Return a round rod between two points [mm]."""
    a, b = Vector(*start), Vector(*end)
    plane = Plane(origin=a, z_dir=b - a)
    body: Any = Cylinder(radius, (b - a).length, align=(Align.CENTER, Align.CENTER, Align.MIN))
    return cast(Shape, plane.location * body)


def box(lower: Point, upper: Point, rounding: float = 0.0, edges: str = "all") -> Shape:
    """Return a box between two corners, its edges rounded.

    Args:
        lower, upper: corners [mm]
        rounding: radius of the edges [mm]
        edges: all of them, or those parallel to "x", "y" or "z"
    """
    a, b = Vector(*lower), Vector(*upper)
    centre = (a + b) * 0.5
    size = b - a
    body: Any = Pos(centre.X, centre.Y, centre.Z) * Box(size.X, size.Y, size.Z)
    if rounding > 0.0:
        axis = {"x": Axis.X, "y": Axis.Y, "z": Axis.Z}.get(edges)
        chosen = body.edges().filter_by(axis) if axis else body.edges()
        body = fillet(chosen, rounding)
    return cast(Shape, body)


def fuse(*shapes: Shape) -> Shape:
    """Return what the shapes cover together."""
    first, *rest = cast("list[Any]", list(shapes))
    for other in rest:
        first = first + other
    return cast(Shape, first)


def cut(shape: Shape, *tools: Shape) -> Shape:
    """Return the shape without what the tools cover."""
    body: Any = shape
    for tool in tools:
        body = body - tool
    return cast(Shape, body)


def common(*shapes: Shape) -> Shape:
    """Return what all of the shapes cover."""
    first, *rest = cast("list[Any]", list(shapes))
    for other in rest:
        first = first & other
    return cast(Shape, first)


def rounded(edges: Iterable[Any], radius: float) -> Shape:
    """Return the shape of these edges with them rounded by a radius [mm]."""
    return cast(Shape, fillet(list(edges), radius))


def bevelled(edges: Iterable[Any], length: float) -> Shape:
    """Return the shape of these edges with them bevelled by a length [mm]."""
    return cast(Shape, chamfer(list(edges), length))


def mirrored(shape: Shape, across: Direction) -> Shape:
    """Return the mirror image in the plane across an axis through the origin."""
    plane = {"x": Plane.YZ, "y": Plane.XZ, "z": Plane.XY}[across]
    return cast(Shape, mirror(cast(Any, shape), plane))


def flipped(corners: Sequence[Corner], coordinate: int) -> list[Corner]:
    """Return an outline's mirror image, its corners in the opposite turn."""
    factors = tuple(-1.0 if k == coordinate else 1.0 for k in range(3))
    return [tuple(f * c for f, c in zip(factors, one, strict=False)) for one in reversed(corners)]


def both(half: Sequence[Corner], coordinate: int) -> list[Corner]:
    """Return half an outline and its mirror image."""
    return [*half, *flipped(half, coordinate)]


def ring(radius: float, count: int) -> list[Point2]:
    """Return the corners of a regular polygon with a flat side across the first axis."""
    turns = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    return [(float(radius * np.cos(a)), float(radius * np.sin(a))) for a in turns]


def edges_at(shape: Shape, along: Direction, position: float) -> list[Any]:
    """Return the edges that lie in a plane across an axis [mm]."""
    axis = {"x": Axis.X, "y": Axis.Y, "z": Axis.Z}[along]
    return list(shape.edges().filter_by_position(axis, position - 1e-4, position + 1e-4))


def _near(vertex: Vertex, points: Sequence[Vector]) -> bool:
    at = vertex.center()
    return any((at - point).length < 1e-6 for point in points)
