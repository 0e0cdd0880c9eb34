"""Shapes of foreign files as ours: primitives, and meshes that are looked up on the disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.apps.foreign.surfaces import load_surface
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape

Array = NDArray[np.float64]


def nearest_material(rgba: Array | None) -> str:
    """Return the name of our material that comes nearest to a colour, "casting" without one."""
    if rgba is None:
        return "casting"
    off = {
        name: float(np.sum((np.array(m.rgba[:3]) - rgba[:3]) ** 2)) for name, m in MATERIALS.items()
    }
    return min(off, key=lambda name: off[name])


def box(pose: Array, size: Array, material: str) -> Shape:
    """Return a box with edges `size`, (3,) [m]."""
    return Shape("box", pose, 0.5 * size, material)


def cylinder(pose: Array, radius: float, length: float, material: str) -> Shape:
    """Return a cylinder along z."""
    return Shape("cylinder", pose, np.array([radius, 0.5 * length, 0.0]), material)


def capsule(pose: Array, radius: float, length: float, material: str) -> Shape:
    """Return a capsule along z; `length` is that of its straight part."""
    return Shape("capsule", pose, np.array([radius, 0.5 * length, 0.0]), material)


def sphere(pose: Array, radius: float, material: str) -> Shape:
    """Return a ball."""
    return Shape("sphere", pose, np.array([radius, 0.0, 0.0]), material)


def mesh(pose: Array, path: Path, scale: Array, material: str) -> Shape:
    """Return a mesh from a file, its vertices in metres.

    Raises:
        ForeignFileError: the file cannot be read or holds no triangles
    """
    return given_mesh(pose, load_surface(path, scale), material)


def given_mesh(pose: Array, surface: Mesh, material: str) -> Shape:
    """Return a mesh from its triangles."""
    reach = np.abs(surface.vertices).max(axis=0)
    return Shape("mesh", pose, reach, material, collide=False, weigh=False, mesh=surface)
