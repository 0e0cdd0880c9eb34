"""The links as solids, their triangles, the convex pieces that touch, and their mass properties."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from build123d.topology import Face, Shape
from numpy.typing import NDArray
from OCP.BRep import BRep_Tool
from OCP.BRepGProp import BRepGProp, BRepGProp_Face
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.BRepTools import BRepTools
from OCP.gp import gp_Pnt, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.IMeshTools import IMeshTools_Parameters
from OCP.TopAbs import TopAbs_Orientation
from OCP.TopLoc import TopLoc_Location
from scipy.spatial import ConvexHull

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import open_edges
from trocar.errors import TrocarError


@dataclass(frozen=True, eq=False)
class Part:
    """A solid of one material.

    Attributes:
        material: name of a row in `descriptions.materials`
        solid: one or several closed solids in the link's frame, in millimetres
    """

    material: str
    solid: Shape


@dataclass(frozen=True, eq=False)
class Link:
    """What moves with one frame.

    Attributes:
        name: of its files and of its section in solids.toml
        frame: the description's frame that it is drawn in and moves with
        parts: what is seen, and together what weighs; they may overlap no more than a joint does
        convex: solids of which each one's convex hull touches; empty: the one hull of all parts
    """

    name: str
    frame: str
    parts: tuple[Part, ...]
    convex: tuple[Shape, ...] = ()


# OCP's type stubs name none of its classes.


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


Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: A closed convex surface of n corners has 2 n - 4 triangles.
MOST_TRIANGLES = 64
MOST_CORNERS = MOST_TRIANGLES // 2 + 2


def few_corners(points: Array, most: int = MOST_CORNERS, slack: float = 0.2) -> Array:
    """Return the points whose hull fills the hull of all best, (k, 3) with k <= most.

    Begins with the six outermost along the axes and adds the one that is farthest out, until the
    hull misses none by more than `slack`.

    Args:
        points: (n, 3) [mm]
        most: so many corners are enough, whatever is missed
        slack: [mm]
    """
    corners = points[ConvexHull(points).vertices]
    corners = corners[np.lexsort(corners.T)]
    chosen: list[int] = _spread(corners)
    while len(chosen) < min(most, len(corners)):
        hull = ConvexHull(corners[chosen])
        out = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
        worst = int(np.argmax(out))
        if out[worst] <= slack:
            break
        chosen.append(worst)
    return corners[sorted(chosen)]


def _spread(corners: Array) -> list[int]:
    """Return four or more corners that do not lie in one plane."""
    ends = [int(k(corners[:, axis])) for axis in range(3) for k in (np.argmin, np.argmax)]
    chosen = list(dict.fromkeys(ends))
    while True:
        base = corners[chosen] - corners[chosen[0]]
        _, sizes, axes = np.linalg.svd(base, full_matrices=True)
        if len(chosen) >= 4 and sizes[2] > 1e-6 * sizes[0]:
            return chosen
        away = np.abs((corners - corners[chosen[0]]) @ axes[2])
        chosen.append(int(np.argmax(away)))


def hull_faces(points: Array) -> tuple[Array, Ints]:
    """Return the hull of points as corners (k, 3) and triangles (m, 3), outside anticlockwise."""
    hull = ConvexHull(points)
    used = np.unique(hull.simplices)
    number = np.zeros(len(points), dtype=np.int64)
    number[used] = np.arange(len(used))
    faces = hull.simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    first = np.argmin(faces, axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return points[used], number[faces[np.lexsort(faces.T[::-1])]]


# OCP's type stubs name none of its classes.


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Weight:
    """Of uniform solids together.

    Attributes:
        volume: [mm^3]
        com: centre, (3,) [mm]
        gyration: inertia about the centre of 1 kg, (3, 3) [mm^2]
    """

    volume: float
    com: Array
    gyration: Array


def weigh(solids: Sequence[Shape]) -> Weight:
    """Return the mass properties of solids of one density; where two overlap, both count."""
    each = [_one(solid) for solid in solids]
    volumes = np.array([one.volume for one in each])
    com = volumes @ np.stack([one.com for one in each]) / volumes.sum()
    total = np.zeros((3, 3))
    for one in each:
        away = one.com - com
        total += one.volume * (one.gyration + away @ away * np.eye(3) - np.outer(away, away))
    return Weight(float(volumes.sum()), com, total / volumes.sum())


def _one(solid: Shape) -> Weight:
    found = GProp_GProps()
    BRepGProp.VolumeProperties_s(solid.wrapped, found)
    inertia = found.MatrixOfInertia()
    about = [[inertia.Value(i, j) for j in (1, 2, 3)] for i in (1, 2, 3)]
    volume = found.Mass()
    return Weight(volume, np.array(found.CentreOfMass().Coord()), np.array(about) / volume)


Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Piece:
    """Triangles of one file: corners (n, 3) [mm], faces (m, 3), and normals where it is seen."""

    file: str
    material: str
    vertices: Array
    faces: Ints
    normals: Array | None = None


@dataclass(frozen=True, eq=False)
class DrawnLink:
    """A link as it is written.

    Attributes:
        name, frame: as drawn
        weight: volume, centre and inertia
        lower, upper: what it fills, (3,) [mm]
        visual: one piece a material
        convex: what touches
    """

    name: str
    frame: str
    weight: Weight
    lower: Array
    upper: Array
    visual: tuple[Piece, ...]
    convex: tuple[Piece, ...]


def drawn(link: Link, fineness: Fineness) -> DrawnLink:
    """Return a link's triangles, convex pieces and mass properties.

    Raises:
        TrocarError: a part is open, inside out or of an unknown material
    """
    meshes = [(part, tessellate(part.solid, fineness)) for part in link.parts]
    for number, (part, mesh) in enumerate(meshes):
        _check(f"{link.name}: part {number} ({part.material})", part.material, mesh)
    visual = tuple(
        _joined(
            f"{link.name}.{material}.obj",
            material,
            [m for p, m in meshes if p.material == material],
        )
        for material in dict.fromkeys(part.material for part in link.parts)
    )
    corners = np.concatenate([piece.vertices for piece in visual])
    return DrawnLink(
        link.name,
        link.frame,
        weigh([part.solid for part in link.parts]),
        corners.min(axis=0),
        corners.max(axis=0),
        visual,
        tuple(_hulls(link, [mesh for _, mesh in meshes], fineness)),
    )


def _check(where: str, material: str, mesh: Triangles) -> None:
    if material not in MATERIALS:
        raise TrocarError(f"{where}: unknown material; known: {', '.join(MATERIALS)}")
    torn = open_edges(mesh.vertices, mesh.faces)
    if torn:
        raise TrocarError(f"{where}: is not closed: {torn} edges are not shared by two triangles")
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    if np.einsum("ij,ij->", a, np.cross(b, c)) <= 0.0:
        raise TrocarError(f"{where}: is inside out")


def _joined(file: str, material: str, meshes: list[Triangles]) -> Piece:
    counts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Piece(
        file,
        material,
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + n for mesh, n in zip(meshes, counts, strict=False)]),
        np.concatenate([mesh.normals for mesh in meshes]),
    )


def _hulls(link: Link, meshes: list[Triangles], fineness: Fineness) -> Iterator[Piece]:
    """Give the hull of each convex solid, or the one hull of all parts."""
    clouds = [tessellate(solid, fineness).vertices for solid in link.convex]
    for number, cloud in enumerate(clouds or [np.concatenate([m.vertices for m in meshes])]):
        corners, faces = hull_faces(few_corners(cloud, slack=fineness.inside))
        yield Piece(f"{link.name}.convex{number}.obj", "", corners, faces)
