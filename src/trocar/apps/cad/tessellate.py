"""Triangles of solids, with the true normals of their surfaces.

Corners of two faces that meet smoothly are one, so that a fillet shades as the round that it is;
corners at a crease are several, so that the crease stays sharp.
"""

# pyright: reportAttributeAccessIssue=false
# OCP's type stubs name none of its classes.

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from build123d.topology import Face, Shape
from numpy.typing import NDArray
from OCP.BRep import BRep_Tool
from OCP.BRepGProp import BRepGProp_Face
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.BRepTools import BRepTools
from OCP.gp import gp_Pnt, gp_Vec
from OCP.IMeshTools import IMeshTools_Parameters
from OCP.TopAbs import TopAbs_Orientation
from OCP.TopLoc import TopLoc_Location

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Digits of a coordinate [mm] and of a normal's component that are kept.
DIGITS, NORMAL_DIGITS = 3, 2
#: A normal shorter than this share of a face's longest has no direction, and how far away, as a
#: share of the way to the middle of the face, it is looked for instead.
LOST, NUDGE = 1e-6, 1e-3


@dataclass(frozen=True)
class Fineness:
    """How near triangles come to a surface.

    Attributes:
        edges: largest distance of an edge's chord [mm]
        inside: largest distance of a triangle within a face [mm]
        angle: largest turn along an edge, and within a face, between two corners [rad]
        digits: digits of a coordinate in millimetres that are kept
    """

    edges: float
    inside: float
    angle: float = 0.8
    digits: int = DIGITS


@dataclass(frozen=True, eq=False)
class Triangles:
    """Corners (n, 3) [mm], unit normals there (n, 3), and which three make a face (m, 3)."""

    vertices: Array
    normals: Array
    faces: Ints


def tessellate(solid: Shape, fineness: Fineness) -> Triangles:
    """Return the triangles of a solid's surface, outside seen anticlockwise.

    The same solid gives the same triangles, to the last bit.
    """
    BRepTools.Clean_s(solid.wrapped)
    wanted = IMeshTools_Parameters()
    wanted.Deflection, wanted.DeflectionInterior = fineness.edges, fineness.inside
    wanted.Angle = wanted.AngleInterior = fineness.angle
    wanted.InParallel = False
    BRepMesh_IncrementalMesh(solid.wrapped, wanted)
    parts = list(_faces(solid))
    counts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return _welded(
        Triangles(
            np.concatenate([part.vertices for part in parts]),
            np.concatenate([part.normals for part in parts]),
            np.concatenate([part.faces + n for part, n in zip(parts, counts, strict=False)]),
        ),
        fineness.digits,
    )


def _faces(solid: Shape) -> Iterator[Triangles]:
    for face in solid.faces():
        place = TopLoc_Location()
        found = BRep_Tool.Triangulation_s(face.wrapped, place)
        turn = place.Transformation()
        count = range(1, found.NbNodes() + 1)
        points = [found.Node(k).Transformed(turn).Coord() for k in count]
        corners = [found.Triangle(k).Get() for k in range(1, found.NbTriangles() + 1)]
        faces = np.array(corners, dtype=np.int64).reshape(-1, 3) - 1
        if face.wrapped.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
            faces = faces[:, ::-1]
        vertices = np.array(points, dtype=np.float64)
        at = np.array([found.UVNode(k).Coord() for k in count], dtype=np.float64)
        yield Triangles(vertices, _normals(face, at), faces)


def _normals(face: Face, at: Array) -> Array:
    """Return the surface's outward unit normals at (u, v), (n, 3).

    At the apex of a cone and the poles of a sphere, where a surface has none, it is the one close
    by, towards the middle of the face.
    """
    surface, point, normal = BRepGProp_Face(face.wrapped), gp_Pnt(), gp_Vec()
    middle = 0.5 * (at.min(axis=0) + at.max(axis=0))
    found = np.empty((len(at), 3))

    def read(k: int, place: Array) -> float:
        surface.Normal(float(place[0]), float(place[1]), point, normal)
        found[k] = normal.Coord()
        return float(np.linalg.norm(found[k]))

    length = np.array([read(k, place) for k, place in enumerate(at)])
    for k in np.flatnonzero(length < LOST * max(float(length.max()), 1e-12)):
        length[k] = read(int(k), at[k] + NUDGE * (middle - at[k]))
    return found / np.maximum(length, 1e-12)[:, None]


def _welded(mesh: Triangles, digits: int) -> Triangles:
    """Return triangles whose equal corners are one, without those that have shrunk to a line."""
    vertices = np.round(mesh.vertices, digits) + 0.0
    normals = np.round(mesh.normals, NORMAL_DIGITS) + 0.0
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    spot = place.reshape(-1)[mesh.faces]
    kept = (spot[:, 0] != spot[:, 1]) & (spot[:, 1] != spot[:, 2]) & (spot[:, 2] != spot[:, 0])
    used = np.unique(mesh.faces[kept])
    rows, inverse = np.unique(
        np.hstack([vertices[used], normals[used]]), axis=0, return_inverse=True
    )
    where = np.zeros(len(vertices), dtype=np.int64)
    where[used] = inverse.reshape(-1)
    return Triangles(rows[:, :3], rows[:, 3:], where[mesh.faces[kept]])
