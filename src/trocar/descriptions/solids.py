"""Solids that `make cad` has drawn: appearance, colliding shapes and mass of a link.

A folder of solids holds solids.toml and the OBJ files that it names, in millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape, Touches
from trocar.descriptions.table import Table, read_table
from trocar.errors import DescriptionError
from trocar.geometry.se3 import transform
from trocar.inputs import is_file

Array = NDArray[np.float64]

DATA = Path(__file__).parent / "data" / "solids"
INDEX = "solids.toml"
#: Material of convex pieces, for viewers that show hidden shapes.
UNSEEN = "joint"


@dataclass(frozen=True, eq=False)
class Solid:
    """A link as it was drawn, in the frame that it moves with.

    Attributes:
        name: "set/link"
        frame: the description's frame that it was drawn in
        volume: [m^3]
        com: its centre of mass, (3,) [m]
        gyration: inertia of 1 kg about that centre, (3, 3) [m^2]
        lower, upper: what it fills, (3,) [m]
        visual: meshes that are looked at, one a material
        convex: convex meshes that may touch, none of them seen
    """

    name: str
    frame: str
    volume: float
    com: Array
    gyration: Array
    lower: Array
    upper: Array
    visual: tuple[Shape, ...]
    convex: tuple[Shape, ...]


def seen_and_touched(solid: Solid, touches: Touches) -> tuple[Shape, ...]:
    """Return the shapes of a solid: the visible ones and the colliding ones."""
    pieces = (replace(piece, collide=touches == "pieces") for piece in solid.convex)
    if touches in ("nothing", "pieces"):
        return (*solid.visual, *pieces)
    about = box_about(solid.convex)
    if touches == "capsule":
        about = replace(about, hull="capsule")
    return (*solid.visual, *pieces, about)


def box_about(pieces: tuple[Shape, ...]) -> Shape:
    """Return the box about meshes, which is not seen."""
    corners = [
        piece.mesh.vertices @ piece.pose[:3, :3].T + piece.pose[:3, 3]
        for piece in pieces
        if piece.mesh is not None
    ]
    points = np.concatenate(corners)
    lower, upper = points.min(axis=0), points.max(axis=0)
    pose = transform(np.eye(3), 0.5 * (lower + upper))
    size = 0.5 * (upper - lower)
    return Shape("box", pose, size, UNSEEN, weigh=False, visible=False)


def solid_names(folder: Path = DATA) -> tuple[str, ...]:
    """Return every solid of a folder of sets as "set/link", sorted."""
    files = sorted(folder.glob(f"*/{INDEX}"))
    return tuple(
        f"{file.parent.name}/{link}" for file in files for link in read_table(file).entries()
    )


@lru_cache(maxsize=1024)
def read_solid(name: str, folder: Path = DATA) -> Solid:
    """Read a solid.

    Args:
        name: "set/link"
        folder: where the sets lie

    Raises:
        DescriptionError: a broken solids.toml, or a file that does not hold what it says
        KeyError: no such solid
    """
    group, _, link = name.partition("/")
    file = folder / group / INDEX
    if not is_file(file):
        raise KeyError(name)
    index = _index(file)
    if link not in index:
        raise KeyError(name)
    row = index.table(link)
    xx, yy, zz, xy, xz, yz = row.vector("gyration", 6, "area")
    solid = Solid(
        name,
        row.text("frame"),
        row.quantity("volume", "volume"),
        row.vector("com", 3, "length"),
        np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
        row.vector("lower", 3, "length"),
        row.vector("upper", 3, "length"),
        row.each("visual", lambda piece: _shape(piece, file.parent, group, seen=True)),
        row.each("convex", lambda piece: _shape(piece, file.parent, group, seen=False)),
    )
    row.done()
    return solid


@lru_cache(maxsize=64)
def _index(file: Path) -> Table:
    return read_table(file)


def _shape(row: Table, folder: Path, group: str, seen: bool) -> Shape:
    material = row.text("material", allowed=tuple(MATERIALS)) if seen else UNSEEN
    path = folder / row.text("file")
    name = f"{group}_{path.stem.replace('.', '_')}"
    mesh = _read(path, name)
    expected = row.number("triangles")
    if len(mesh.faces) != expected:
        raise row.fail("triangles", f"got {expected:g}; {path} holds {len(mesh.faces)}")
    reach = np.abs(mesh.vertices).max(axis=0)
    return Shape(
        "mesh", np.eye(4), reach, material, collide=False, weigh=False, mesh=mesh, visible=seen
    )


def _read(path: Path, name: str) -> Mesh:
    """Read an OBJ file as `make cad` writes it: all corners, then normals of these, then faces.

    Raises:
        DescriptionError: it is not one
    """
    try:
        text = path.read_text(encoding="ascii")
        corners, rest = text.split("\nf ", 1)
        points, _, normals = corners.partition("\nvn ")
        vertices = _numbers(points.replace("v ", " ")).reshape(-1, 3)
        normal = _numbers(normals.replace("vn ", " ")).reshape(-1, 3)
        step = 2 if len(normal) else 1  # each corner of a face as k//k, or as k
        faces = _numbers(rest.replace("f ", " ").replace("//", " ")).reshape(-1, 3 * step)
    except (OSError, ValueError) as problem:
        raise DescriptionError(str(path), "", f"is no OBJ file of make cad: {problem}") from None
    corners_of = faces[:, ::step].astype(np.int64) - 1
    if (
        len(normal) not in (0, len(vertices))
        or not len(corners_of)
        or corners_of.max() >= len(vertices)
    ):
        raise DescriptionError(str(path), "", "has faces whose corners are not there")
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return Mesh(vertices * 1e-3, corners_of, name, normal / length if len(normal) else None)


def _numbers(text: str) -> Array:
    return np.array(text.split(), dtype=np.float64)
