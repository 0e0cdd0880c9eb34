"""From drawn links to what is written: triangles by material, convex pieces, mass properties."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.cad.hulls import few_corners, hull_faces
from trocar.apps.cad.link import Link
from trocar.apps.cad.tessellate import Fineness, Triangles, tessellate
from trocar.apps.cad.weigh import Weight, weigh
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import open_edges
from trocar.errors import TrocarError

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
