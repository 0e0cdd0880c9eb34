"""Meshes as files: a name for each, and what its file holds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.formats.links import LinkModel

MATERIAL_FILE = "materials.mtl"


def mesh_names(model: LinkModel) -> dict[Mesh, str]:
    """Return a name for each mesh of a model that is seen or touches; alike ones have the same."""
    found: dict[Mesh, str] = {}
    owners: dict[str, Mesh] = {}
    for link in model.links:
        for shape in link.shapes:
            used = shape.visible or shape.collide
            if shape.mesh is None or shape.mesh in found or not used:
                continue
            stem = shape.mesh.name or link.name
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


def seen_materials(model: LinkModel) -> dict[Mesh, str]:
    """Return what each mesh that is seen is made of: rows of `descriptions.materials`."""
    shapes = [s for link in model.links for s in link.shapes if s.visible]
    return {s.mesh: s.material for s in reversed(shapes) if s.mesh is not None}


def mesh_files(
    meshes: Mapping[Mesh, str], materials: Mapping[Mesh, str] | None = None
) -> dict[str, bytes]:
    """Return each mesh as a file NAME.obj, in metres: {name of the file: what it holds}.

    Args:
        meshes: {mesh: its name}
        materials: {mesh: a row of `descriptions.materials`}: these get their colour from a file
            beside them, for programs that look for it nowhere else
    """
    made_of = dict(materials or {})
    files = {MATERIAL_FILE: mtl(sorted(set(made_of.values())))} if meshes and made_of else {}
    return files | {
        f"{name}.obj": obj(mesh, made_of.get(mesh, "")) for mesh, name in meshes.items()
    }


def obj(mesh: Mesh, material: str = "") -> bytes:
    """Return a mesh as a Wavefront OBJ file: corners to a nanometre, normals where it has them."""
    lines = [f"mtllib {MATERIAL_FILE}\n"] if material else []
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in np.round(mesh.vertices, 9) + 0.0]
    if mesh.normals is not None:
        normals = np.round(mesh.normals, 4) + 0.0
        lines += [f"vn {x:.4g} {y:.4g} {z:.4g}\n" for x, y, z in normals]
    lines += [f"usemtl {material}\n"] if material else []
    corner = "{0}" if mesh.normals is None else "{0}//{0}"
    face = f"f {corner} {corner.replace('0', '1')} {corner.replace('0', '2')}\n"
    return "".join([*lines, *(face.format(a, b, c) for a, b, c in mesh.faces + 1)]).encode()


def mtl(materials: Iterable[str]) -> bytes:
    """Return the colours of materials as an MTL file (Wavefront), ambient light half as strong."""
    text = ""
    for name in materials:
        found = MATERIALS[name]
        red, green, blue, opaque = found.rgba
        shine = f" {found.gloss / 2:.4g}"
        text += (
            f"newmtl {name}\nKa {red / 2:.4g} {green / 2:.4g} {blue / 2:.4g}\n"
            f"Kd {red:.4g} {green:.4g} {blue:.4g}\nKs{3 * shine}\n"
            f"Ns {10 + 90 * found.gloss:.4g}\nd {opaque:.4g}\nillum 2\n"
        )
    return text.encode()
