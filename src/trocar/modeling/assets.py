"""Meshes and materials of a model, each once however often it is used."""

from __future__ import annotations

import mujoco

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh


def add_mesh(spec: mujoco.MjSpec, mesh: Mesh, convex: bool) -> str:
    """Make sure that a model has a mesh, and return its name there.

    Two meshes of one name, such as those of arms with different calibrations, are told apart by a
    number.

    Args:
        spec: the model that grows
        mesh: the triangles
        convex: whether its hull is what touches; else it is only looked at
    """
    name, number = mesh.name or "mesh", 1
    while (there := spec.mesh(name)) is not None:
        if _same(there, mesh):
            return name
        number += 1
        name = f"{mesh.name}_{number}"
    made = spec.add_mesh(
        name=name, uservert=mesh.vertices.ravel(), userface=mesh.faces.astype("int32").ravel()
    )
    kinds = mujoco.mjtMeshInertia
    made.inertia = kinds.mjMESH_INERTIA_CONVEX if convex else kinds.mjMESH_INERTIA_SHELL
    if mesh.normals is not None:
        made.usernormal = mesh.normals.ravel()
        made.userfacenormal = mesh.faces.astype("int32").ravel()
    return name


def add_material(spec: mujoco.MjSpec, name: str) -> str:
    """Make sure that a model has a row of `materials`, and return its name there."""
    if spec.material(name) is None:
        look = MATERIALS[name]
        spec.add_material(
            name=name, rgba=look.rgba, specular=look.gloss, shininess=look.gloss, reflectance=0.0
        )
    return name


def _same(there: mujoco.MjsMesh, mesh: Mesh) -> bool:
    return len(there.uservert) == mesh.vertices.size and bool(
        (there.uservert == mesh.vertices.ravel()).all()
    )
