"""What links look like and collide with, in SDF."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.geometry.rotations import rpy_from_matrix
from trocar.geometry.se3 import transform
from trocar.modeling.markup import child
from trocar.modeling.options import CONTACT_FRICTION

Array = NDArray[np.float64]


def exact(values: Iterable[float]) -> str:
    """Write numbers so that reading gives the same float64."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def add_pose(parent: Any, pose: Array, relative_to: str = "") -> None:
    """Append a `pose`, unless it is that of the parent itself.

    Args:
        parent: an element of lxml
        pose: (4, 4)
        relative_to: the link or frame that it is given in; "" for what the parent belongs to
    """
    if relative_to or not np.array_equal(pose, np.eye(4)):
        named = {"relative_to": relative_to} if relative_to else {}
        child(parent, "pose", named, exact([*pose[:3, 3], *rpy_from_matrix(pose[:3, :3])]))


def add_shape(
    link: Any, name: str, shape: Shape, frame: str, version: str, meshes: Mapping[Mesh, str]
) -> None:
    """Append the `visual` and the `collision` of a shape.

    Args:
        link: the element that gets them
        name: unique in the link
        shape: what
        frame: the frame that the shape is in, "" for the link
        version: of SDF; before 1.8 there is no capsule, which becomes a cylinder with two balls
        meshes: {mesh: its file's name without folder and ending}
    """
    parts = _capsule(shape) if shape.kind == "capsule" and version == "1.7" else (shape,)
    for k, part in enumerate(parts):
        own = name if len(parts) == 1 else f"{name}_{k}"
        if shape.visible:
            visual = child(link, "visual", {"name": f"{own}_visual"})
            add_pose(visual, part.pose, frame)
            _add_geometry(visual, part, meshes)
            _add_material(visual, shape.material)
        if shape.collide:
            collision = child(link, "collision", {"name": f"{own}_collision"})
            add_pose(collision, part.pose, frame)
            _add_geometry(collision, part, meshes)
            _add_friction(collision)


def _capsule(shape: Shape) -> tuple[Shape, ...]:
    """Return the cylinder and the two balls that make a capsule."""
    radius, half, _ = shape.size
    made = [Shape("cylinder", shape.pose, shape.size, shape.material)]
    for end in (-half, half):
        pose = shape.pose @ transform(np.eye(3), np.array([0.0, 0.0, end]))
        made.append(Shape("sphere", pose, np.array([radius, 0.0, 0.0]), shape.material))
    return tuple(made)


def _add_geometry(parent: Any, shape: Shape, meshes: Mapping[Mesh, str]) -> None:
    geometry = child(parent, "geometry")
    if shape.mesh is not None:
        made = child(geometry, "mesh")
        child(made, "uri", text=f"meshes/{meshes[shape.mesh]}.obj")
        return
    made = child(geometry, shape.kind)
    if shape.kind == "box":
        child(made, "size", text=exact(2.0 * shape.size))
        return
    child(made, "radius", text=exact(shape.size[:1]))
    if shape.kind != "sphere":
        child(made, "length", text=exact(2.0 * shape.size[1:2]))


def _add_material(visual: Any, name: str) -> None:
    row = MATERIALS[name]
    material = child(visual, "material")
    child(material, "ambient", text=exact(row.rgba))
    child(material, "diffuse", text=exact(row.rgba))
    child(material, "specular", text=exact([row.gloss] * 3 + [1.0]))


def _add_friction(collision: Any) -> None:
    ode = child(child(child(collision, "surface"), "friction"), "ode")
    for tag in ("mu", "mu2"):
        child(ode, tag, text=exact(CONTACT_FRICTION[:1]))
