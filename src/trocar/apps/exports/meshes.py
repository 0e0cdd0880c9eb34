"""The meshes of an export: a name for each, and the files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from trocar.descriptions.meshes import Mesh
from trocar.modeling.links import LinkModel


def mesh_names(model: LinkModel) -> dict[Mesh, str]:
    """Return a name for each mesh of a model; meshes that are alike have the same name."""
    found: dict[Mesh, str] = {}
    owners: dict[str, Mesh] = {}
    for link in model.links:
        for shape in link.shapes:
            if shape.mesh is None or shape.mesh in found:
                continue
            stem = getattr(shape.mesh, "name", "") or link.name
            name, k = stem, 1
            while name in owners and not _alike(owners[name], shape.mesh):
                k += 1
                name = f"{stem}_{k}"
            owners.setdefault(name, shape.mesh)
            found[shape.mesh] = name
    return found


def _alike(one: Mesh, other: Mesh) -> bool:
    same = np.array_equal(one.vertices, other.vertices)
    return same and np.array_equal(one.faces, other.faces)


def write_meshes(meshes: Mapping[Mesh, str], folder: Path) -> None:
    """Write each mesh as NAME.obj, in metres."""
    if meshes:
        folder.mkdir(parents=True, exist_ok=True)
    for name, mesh in {name: mesh for mesh, name in meshes.items()}.items():
        (folder / f"{name}.obj").write_bytes(obj(mesh))


def obj(mesh: Mesh) -> bytes:
    """Return a mesh as a Wavefront OBJ file: corners to a nanometre, triangles."""
    corners = [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in np.round(mesh.vertices, 9) + 0.0]
    faces = [f"f {a} {b} {c}\n" for a, b, c in mesh.faces + 1]
    return "".join(corners + faces).encode()
