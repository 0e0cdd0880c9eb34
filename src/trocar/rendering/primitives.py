"""Triangles and normals of the shapes of a rig, in each shape's own frame.

Edges are as sharp as the shape's, so that pictures show what collides. Round ones are one surface:
a small sphere whose points are carried outwards, each to its corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.inputs import check_numbers
from trocar.simulation.records import Drawing, DrawnSurface, ShapeRecord

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Points around a circle, and rings from the equator of a sphere to a pole. Source: our own choice;
#: chords of a shaft of 5 mm then miss its circle by 3 um.
AROUND, RINGS = 64, 12
#: Points around a tube. Source: our own choice; chords miss its circle by 3.4 % of the radius.
TUBE_AROUND = 12
#: Points of a rounded edge from one side to the next. Source: our own choice.
CORNER = 4


@dataclass(frozen=True, eq=False)
class TriangleSurface:
    """Triangles, outside seen anticlockwise.

    Attributes:
        points: (n, 3) [m]
        normals: (n, 3), unit
        faces: (m, 3)
    """

    points: Floats
    normals: Floats
    faces: Ints


def surface(shape: ShapeRecord) -> TriangleSurface:
    """Return a shape's surface in the frame of the body that carries it.

    Raises:
        InputError: an unknown kind of shape
    """
    own = _own_surface(shape)
    turn, shift = shape.pose[:3, :3], shape.pose[:3, 3]
    return TriangleSurface(own.points @ turn.T + shift, own.normals @ turn.T, own.faces)


def drawn_surface(drawing: Drawing) -> TriangleSurface:
    """Return the surface of a drawing, in the world.

    Raises:
        InputError: arrays of a wrong shape, numbers that are not finite, faces of vertices that are
            not there, or a look that no surface has
    """
    where = f"drawing {drawing.name}"
    check_numbers(drawing.rgba, (4,), f"{where}: rgba", 0.0, 1.0)
    check_numbers((drawing.gloss, drawing.metal), (2,), f"{where}: gloss, metal", 0.0, 1.0)
    if isinstance(drawing, DrawnSurface):
        points = check_numbers(drawing.vertices, (-1, 3), f"{where}: vertices [m]")
        faces = check_numbers(drawing.faces, (-1, 3), f"{where}: faces", 0, len(points) - 1)
        faces = faces.astype(np.int64)
        if drawing.rest is not None:
            check_numbers(drawing.rest, points.shape, f"{where}: rest [m]")
        return TriangleSurface(points, vertex_normals(points, faces), faces)
    points = check_numbers(drawing.points, (-1, 3), f"{where}: points [m]")
    if len(points) < 2:
        raise InputError(f"{where}: points [m]: got one; allowed: two or more")
    check_numbers(drawing.radius, (), f"{where}: radius [m]", 1e-6, 1.0)
    return TriangleSurface(*tube(points, drawing.radius))


def joined(parts: list[TriangleSurface]) -> TriangleSurface:
    """Return many surfaces as one."""
    starts = np.cumsum([0, *(len(part.points) for part in parts[:-1])])
    return TriangleSurface(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
    )


def _own_surface(shape: ShapeRecord) -> TriangleSurface:
    size = np.asarray(shape.size, dtype=np.float64)
    if shape.triangles is not None:
        points, faces = shape.triangles
        if shape.normals is None:
            return _faceted(points[faces])
        return TriangleSurface(points, shape.normals, faces)
    if shape.kind == "box":
        return _rounded_box(size, shape.rounding) if shape.rounding > 0.0 else _box(size)
    if shape.kind == "cylinder":
        return _cylinder(float(size[0]), float(size[1]))
    if shape.kind in ("capsule", "sphere"):
        half = float(size[1]) if shape.kind == "capsule" else 0.0
        angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
        return _shell(angle, np.zeros((AROUND, 2)), half, float(size[0]), RINGS)
    raise InputError(f"no picture of a shape of kind {shape.kind!r}: box, capsule, cylinder, "
                     "sphere, mesh")  # fmt: skip


def _faceted(corners: Floats) -> TriangleSurface:
    """Return triangles (m, 3, 3) that are flat each."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(length > 0.0, length, 1.0)
    count = 3 * len(corners)
    return TriangleSurface(
        corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), np.arange(count).reshape(-1, 3)
    )


def _box(half: Floats) -> TriangleSurface:
    corners: list[Floats] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            ahead, u, v = (np.eye(3)[(axis + k) % 3] for k in range(3))
            square = [sign * ahead + a * u + sign * b * v
                      for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]  # fmt: skip
            corners += [np.array([square[0], square[k], square[k + 1]]) for k in (1, 2)]
    return _faceted(np.stack(corners) * half)


def _rounded_box(half: Floats, edge: float) -> TriangleSurface:
    edge = min(edge, 0.999 * float(half.min()))
    quarter = np.linspace(0.0, 0.5 * np.pi, CORNER)
    angle = np.concatenate([quarter + k * 0.5 * np.pi for k in range(4)])
    signs = np.repeat([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]], CORNER, axis=0)
    return _shell(angle, signs * (half[:2] - edge), float(half[2]) - edge, edge, CORNER - 1)


def _shell(
    angle: Floats, corners: Floats, half: float, radius: float, rings: int
) -> TriangleSurface:
    """Carry a sphere's points outwards: (n,) angles to their corners (n, 2), and up or down."""
    up = np.linspace(0.0, 0.5 * np.pi, rings + 1)
    latitude = np.concatenate([-up[::-1], up])[:, None]
    lift = np.where(np.arange(latitude.size) <= rings, -half, half)[:, None]
    x, y = np.cos(latitude) * np.cos(angle), np.cos(latitude) * np.sin(angle)
    z = np.sin(latitude) * np.ones(angle.size)
    normals = np.stack([x, y, z], axis=-1)
    shift = np.stack(
        [corners[:, 0] * np.ones_like(z), corners[:, 1] * np.ones_like(z), lift + 0.0 * z], axis=-1
    )
    points = shift + radius * normals
    return TriangleSurface(
        points.reshape(-1, 3), normals.reshape(-1, 3), _grid_faces(latitude.size, angle.size)
    )


def _cylinder(radius: float, half: float) -> TriangleSurface:
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    round_ = np.stack([np.cos(angle), np.sin(angle), np.zeros(AROUND)], axis=1)
    parts: list[TriangleSurface] = []
    rim = [radius * round_ + [0.0, 0.0, z] for z in (-half, half)]
    around = np.arange(AROUND)
    after = (around + 1) % AROUND
    sides = [[around, after, after + AROUND], [around, after + AROUND, around + AROUND]]
    faces = np.concatenate([np.stack(side, axis=1) for side in sides])
    parts.append(TriangleSurface(np.concatenate(rim), np.concatenate([round_, round_]), faces))
    fan = np.stack([np.zeros(AROUND - 2, int), around[1:-1], around[2:]], axis=1)
    for edge, sign in zip(rim, (-1.0, 1.0), strict=True):
        cap = fan if sign > 0.0 else fan[:, ::-1]
        parts.append(TriangleSurface(edge, np.tile([0.0, 0.0, sign], (AROUND, 1)), cap))
    return joined(parts)


def _grid_faces(rows: int, n: int) -> Ints:
    """Return triangles between rows of n points that close around, and the ends' lids."""
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(n), indexing="ij")
    here, right = row * n + column, row * n + (column + 1) % n
    sides = [np.stack([here, right, right + n], -1), np.stack([here, right + n, here + n], -1)]
    fan = np.stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)], axis=1)
    return np.concatenate(
        [*(side.reshape(-1, 3) for side in sides), fan[:, ::-1], fan + (rows - 1) * n]
    )


#: Edges of cells, finest first [m]. Source: our own choice.
CELLS = (0.001, 0.002, 0.004, 0.008, 0.016)
#: Largest ratio of triangles at which a coarser surface is kept. Source: our own choice.
WORTH = 0.8
#: Largest displacement of a point, in cells, from a corner to the mean. Source: half of a diagonal
#: is the root mean square of the worst case; measured on our own parts, 0.9 is never passed.
MOVES = 0.9


def coarser(surface: TriangleSurface, cell: float) -> TriangleSurface:
    """Return a surface whose points within a cell of this edge [m] are one."""
    place = np.floor(surface.points / cell).astype(np.int64)
    _, of_cell = np.unique(place, axis=0, return_inverse=True)
    of_cell = of_cell.reshape(-1)
    axis = np.abs(surface.normals).argmax(axis=1)
    side = 2 * axis + (np.take_along_axis(surface.normals, axis[:, None], 1)[:, 0] < 0.0)
    _, of_point = np.unique(6 * of_cell + side, return_inverse=True)
    of_point = of_point.reshape(-1)
    points = _means(surface.points, of_cell)
    normals = _means(surface.normals, of_point)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    where = np.zeros(len(normals), dtype=np.int64)
    where[of_point] = of_cell
    corners = of_cell[surface.faces]
    alive = (
        (corners[:, 0] != corners[:, 1])
        & (corners[:, 1] != corners[:, 2])
        & (corners[:, 2] != corners[:, 0])
    )
    faces = of_point[surface.faces[alive]]
    return TriangleSurface(points[where], normals / np.where(length > 0.0, length, 1.0), faces)


def levels(surface: TriangleSurface) -> list[tuple[float, TriangleSurface]]:
    """Return levels of detail: [(largest error of points [m], surface)], the whole one first."""
    found = [(0.0, surface)]
    for cell in CELLS:
        fewer = coarser(surface, cell)
        if len(fewer.faces) <= WORTH * len(found[-1][1].faces):
            found.append((MOVES * cell, fewer))
    return found


def _means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the mean of each group's rows, (groups, 3)."""
    count = np.bincount(group)
    sums = [np.bincount(group, weights=values[:, k]) for k in range(values.shape[1])]
    return np.stack(sums, axis=1) / count[:, None]


def vertex_normals(points: Floats, faces: Ints) -> Floats:
    """Return unit normals at the vertices: means over their triangles, weighted by area, (n, 3).

    Args:
        points: (n, 3)
        faces: (m, 3), anticlockwise seen from outside
    """
    a, b, c = points[faces.T]
    across = np.cross(b - a, c - a)
    corners, each = faces.ravel(), np.repeat(across, 3, axis=0)
    sums = [np.bincount(corners, each[:, k], len(points)).astype(float) for k in range(3)]
    return _unit(np.stack(sums, axis=1))


def tube(points: Floats, radius: ArrayLike) -> tuple[Floats, Floats, Ints]:
    """Return a closed tube around a curve: points (n, 3), normals (n, 3) and faces (m, 3).

    Its cross-sections do not twist: each follows from the one before by the smallest rotation
    between their tangents.

    Args:
        points: of the curve, (k, 3), k > 1
        radius: the same everywhere, or at each point (k,)
    """
    k = len(points)
    ahead = _unit(np.diff(points, axis=0))
    along = _unit(np.concatenate([ahead[:1], ahead[:-1] + ahead[1:], ahead[-1:]]))
    side = _unit(np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)]))
    up = np.cross(along, side)
    # How far each section's own axes are turned from those carried over from the section before.
    t0, t1, before = along[:-1], along[1:], side[:-1]
    lean = (t1 * before).sum(axis=1) / np.maximum(1.0 + (t0 * t1).sum(axis=1), 1e-9)
    carried = before - lean[:, None] * (t0 + t1)
    step = np.arctan2((carried * up[1:]).sum(axis=1), (carried * side[1:]).sum(axis=1))
    turn = np.concatenate([[0.0], np.cumsum(step)])
    angle = turn[:, None] + np.linspace(0.0, 2.0 * np.pi, TUBE_AROUND, endpoint=False)
    out = np.cos(angle)[..., None] * side[:, None] + np.sin(angle)[..., None] * up[:, None]
    rings = points[:, None] + np.broadcast_to(radius, k)[:, None, None] * out
    ends = np.array([-along[0], along[-1]])
    row, column = np.meshgrid(np.arange(k - 1), np.arange(TUBE_AROUND), indexing="ij")
    here, right = row * TUBE_AROUND + column, row * TUBE_AROUND + (column + 1) % TUBE_AROUND
    sides = [np.stack([here, right, right + TUBE_AROUND], -1),
             np.stack([here, right + TUBE_AROUND, here + TUBE_AROUND], -1)]  # fmt: skip
    around, after = np.arange(TUBE_AROUND), np.roll(np.arange(TUBE_AROUND), -1)
    start, end = (
        k * TUBE_AROUND,
        (k + 1) * TUBE_AROUND + 1,
    )  # rings of the lids, each before its middle
    middles = np.full((2, TUBE_AROUND), [[start + TUBE_AROUND], [end + TUBE_AROUND]])
    lids = [np.stack([after + start, around + start, middles[0]], -1),
            np.stack([around + end, after + end, middles[1]], -1)]  # fmt: skip
    return (
        np.concatenate([rings.reshape(-1, 3), rings[0], points[:1], rings[-1], points[-1:]]),
        np.concatenate([out.reshape(-1, 3), np.repeat(ends, TUBE_AROUND + 1, axis=0)]),
        np.concatenate([*(each.reshape(-1, 3) for each in sides), *lids]),
    )


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0.0, length, 1.0)
