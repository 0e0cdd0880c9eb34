"""Triangles from STL and OBJ files: the appearance of a part, without collisions.

Sources: the STL format (3D Systems, 1989: ASCII, and 80 bytes of header, a count, 50 bytes a
triangle); the OBJ format (Wavefront, 1992: lines v and f, indices from 1, negative from the end).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.keys import key
from trocar.descriptions.table import Table
from trocar.errors import DescriptionError
from trocar.inputs import read_input

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FORMATS = (".stl", ".obj")
#: More would make the page slow to open. Source: our own choice; the whole cart has 90,000.
MOST_TRIANGLES = 200_000
#: Source: our own choice; so many triangles take some 40 MB as text.
MOST_BYTES = 100_000_000
HEADER_BYTES, TRIANGLE_BYTES = 84, 50
#: The beginning of a file whose content Git LFS keeps elsewhere. Source: git-lfs docs/spec.md.
LFS_POINTER = re.compile(rb"version https://git-lfs.github.com/spec/.*?^size (\d+)", re.M | re.S)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of a shape.

    Attributes:
        vertices: (n, 3) [m] in the shape's frame
        faces: which three vertices make one, outside seen anticlockwise, (m, 3)
        name: what a file of it is called, without ending
        normals: the surface's unit normal at each vertex, (n, 3); None: as the triangles have it
    """

    vertices: Array
    faces: Ints
    name: str = ""
    normals: Array | None = None


@dataclass(frozen=True)
class MeshKeys:
    """Keys of a mesh's file.

    Attributes:
        file: STL or OBJ beside the TOML file
        scale: its unit [m]
    """

    file: str = field(metadata=key())
    scale: float = field(metadata=key("length", above=0.0, default=1e-3))


def read_mesh(table: Table) -> Mesh:
    """Read the mesh of a shape's file, in metres.

    Raises:
        DescriptionError: no such file, an unknown format, no triangles, too many, or numbers that
            are not finite
    """
    keys = table.record(MeshKeys)
    name, scale = keys.file, keys.scale
    path = Path(table.file).parent / name
    if path.suffix.lower() not in FORMATS:
        raise table.fail("file", f"got {name!r}; allowed: a file that ends in {', '.join(FORMATS)}")
    try:
        data = read_input(path, MOST_BYTES)
    except OSError as problem:
        raise table.fail("file", f"{path} cannot be read: {problem.strerror}") from problem
    if problem := lfs_problem(data):
        raise table.fail("file", f"{path} {problem}")
    try:
        normals = None
        if path.suffix.lower() == ".obj":
            points, faces, normals = _from_obj(data)
        else:
            points, faces = _from_stl(data)
    except (ValueError, IndexError, UnicodeDecodeError) as problem:
        raise table.fail(
            "file", f"{path} is no {path.suffix[1:].upper()} file: {problem}"
        ) from None
    _check(table, path, points, faces)
    if normals is None:
        return Mesh(*welded(scale * points, faces), path.stem)
    corners = np.hstack([scale * points[faces].reshape(-1, 3), normals])
    rows, faces = welded(corners, np.arange(len(corners)).reshape(-1, 3))
    vertices, normals = np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3:])
    return Mesh(vertices, faces, path.stem, normals)


def welded(points: Array, faces: Ints) -> tuple[Array, Ints]:
    """Return triangles whose corners at the same place are one, without unused points.

    Args:
        points: all finite, (n, 3) [m], or more columns, which must be equal, too
        faces: which three make a triangle, (m, 3)

    Returns:
        the points, sorted, (k, 3), and the triangles of them, (m, 3)
    """
    used = np.zeros(len(points), dtype=bool)
    used[faces] = True
    some = points[used]
    order = np.lexsort(some.T[::-1])  # ten times as fast as np.unique(axis=0)
    row = some[order]
    first = np.ones(len(row), dtype=bool)
    first[1:] = (row[1:] != row[:-1]).any(axis=1)
    places = np.zeros(len(points), dtype=np.int64)
    places[np.flatnonzero(used)[order]] = np.cumsum(first) - 1
    return row[first], places[faces]


def lfs_problem(data: bytes) -> str:
    """Return the problem of a file that Git LFS has not fetched, "" for any other."""
    pointer = LFS_POINTER.match(data)
    return "" if pointer is None else (
        f"is a Git LFS pointer to a file of {int(pointer[1])} bytes; allowed: the file itself"
        " (run `git lfs pull` in its repository)"
    )  # fmt: skip


def _check(table: Table, path: Path, points: Array, faces: Ints) -> None:
    problem = ""
    if not len(faces):
        problem = "has no triangles"
    elif len(faces) > MOST_TRIANGLES:
        problem = f"has {len(faces)} triangles; allowed: up to {MOST_TRIANGLES}"
    elif not np.isfinite(points).all():
        problem = "has coordinates that are not finite"
    if problem:
        raise DescriptionError(table.file, f"{table.path}.file", f"{path} {problem}")


def _from_stl(data: bytes) -> tuple[Array, Ints]:
    """Return points, (3 m, 3), and which three make a triangle, (m, 3)."""
    count = int.from_bytes(data[80:HEADER_BYTES], "little") if len(data) >= HEADER_BYTES else -1
    if len(data) == HEADER_BYTES + TRIANGLE_BYTES * count:
        row = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        corners = np.frombuffer(data, row, offset=HEADER_BYTES)["corners"].astype(np.float64)
        return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    text = data.decode("ascii")
    if not text.lstrip().startswith("solid"):
        raise ValueError("it neither starts with `solid` nor has the length that its count says")
    lines = [words for line in text.splitlines() if (words := line.split())[:1] == ["vertex"]]
    if len(lines) % 3 or any(len(words) != 4 for words in lines):
        raise ValueError("a triangle has three lines `vertex x y z`")
    corners = np.array([[float(w) for w in words[1:]] for words in lines]).reshape(-1, 3)
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _from_obj(data: bytes) -> tuple[Array, Ints, Array | None]:
    """Return points, (n, 3), which three make a triangle, (m, 3), and normals of corners, (3 m, 3).

    Faces with more corners become fans. Normals are None unless every corner has one.
    """
    points: list[list[float]] = []
    faces: list[list[int]] = []
    directions: list[list[float]] = []
    turned: list[list[int]] = []
    for line in data.decode("utf-8").splitlines():
        key, *words = line.split() or [""]
        if key == "v":
            points.append(list(map(float, words[:3])))
        elif key == "vn":
            directions.append(list(map(float, words[:3])))
        elif key == "f":
            indices = (
                [int(w.split("/")[0]) for w in words] if "/" in line else list(map(int, words))
            )
            corners = [k - 1 if k > 0 else len(points) + k for k in indices]
            if min(corners, default=0) < 0 or max(corners, default=-1) >= len(points):
                raise ValueError(f"face {' '.join(words)} has a corner that is not there")
            faces += [[corners[0], a, b] for a, b in pairwise(corners[1:])]
            own = [int(part[2]) for w in words if len(part := w.split("/")) > 2 and part[2]]
            own = [k - 1 if k > 0 else len(directions) + k for k in own]
            turned += [[own[0], a, b] for a, b in pairwise(own[1:])]
    if any(len(point) != 3 for point in points):
        raise ValueError("a corner is a line `v x y z`")
    normals = None
    if turned and len(turned) == len(faces):
        normals = np.array(directions).reshape(-1, 3)[np.array(turned).ravel()]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / length if np.isfinite(length).all() and length.all() else None
    return np.array(points).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3), normals


def open_edges(vertices: Array, faces: Ints) -> int:
    """Return the number of edges of triangles without an opposite edge in another triangle.

    A closed surface has 0. Vertices at the same place count as one.
    """
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    corners = place.reshape(-1)[faces]
    ways = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    there = ways[:, 0] * len(vertices) + ways[:, 1]
    back = ways[:, 1] * len(vertices) + ways[:, 0]
    each, counts = np.unique(there, return_counts=True)
    other, backs = np.unique(back, return_counts=True)
    here = dict(zip(other.tolist(), backs.tolist(), strict=True))
    return sum(
        abs(n - here.get(edge, 0)) for edge, n in zip(each.tolist(), counts.tolist(), strict=True)
    )
