"""Shapes as geoms: their collision masks, and the meshes and materials they share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import RigDescription, Shape
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.geometry.se3 import transform
from trocar.modeling.options import (
    CONTACT_FRICTION,
    CONTACT_IMPEDANCE,
    CONTACT_STEPS,
    ModelOptions,
)

KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}
#: The bit of everything that stands still.
WORLD_BIT = 1
#: The key of movable props in `contact_masks`: no arm has such a name.
OBJECTS = "movable"
#: Groups of geoms that a viewer switches together: seen and colliding, seen, colliding.
#: Source: the last two as in MuJoCo Menagerie.
SOLID_GROUP, VISUAL_GROUP, COLLISION_GROUP = 1, 2, 3


@dataclass(frozen=True)
class ContactMask:
    """MuJoCo's contype (own bits) and conaffinity (bits of what it touches)."""

    contype: int
    conaffinity: int


#: A lone arm in a file touches whatever has MuJoCo's default of 1, but neither itself nor another
#: arm from such a file. Source: our own choice.
LONE_MASK = ContactMask(2, WORLD_BIT)


def contact_masks(rig: RigDescription) -> dict[str, ContactMask]:
    """Return the contact mask of every arm by name; fixed props under "", movable ones `OBJECTS`.

    An arm touches other arms and props, never itself nor the setup joints that carry it. Setup
    joints share the cart's column and touch neither it nor each other. Movable props touch
    everything.
    """
    bits = {arm.name: 2 << index for index, arm in enumerate(rig.arms)}
    setup = sum(bits[a.name] for a in rig.arms if a.arm.type == "SUJ")
    everything = WORLD_BIT | sum(bits.values())
    still = [prop for prop in rig.props if prop.movable is None]
    solid = any(shape.collide for prop in still for shape in prop.shapes)
    if not solid:
        everything &= ~WORLD_BIT
    masks = {"": ContactMask(WORLD_BIT, everything & ~WORLD_BIT & ~setup if solid else 0)}
    for arm in rig.arms:
        touches = everything & ~bits[arm.name]
        if arm.arm.type == "SUJ":
            touches &= ~setup & ~WORLD_BIT
            for carried in rig.arms:
                touches &= ~bits[carried.name] if carried.on == arm.name else -1
        elif arm.on:
            touches &= ~bits[arm.on]
        masks[arm.name] = ContactMask(bits[arm.name], touches)
    if not rig.objects:
        return masks
    own = 2 << len(rig.arms)
    everyone = WORLD_BIT | sum(mask.contype for name, mask in masks.items() if name) | own
    met = {name: ContactMask(m.contype, m.conaffinity | own) for name, m in masks.items()}
    return {**met, OBJECTS: ContactMask(own, everyone)}


@dataclass(frozen=True, eq=False)
class Surface:
    """A shape that may touch others: its geom, and the name of its body.

    Attributes:
        geom, shape, body: as stated
        rests: of a thread's link: spheres that touch large soft boxes in its place, if any
    """

    geom: mujoco.MjsGeom
    shape: Shape
    body: str
    rests: tuple[Surface, ...] | None = None


class Geoms:
    """Adds shapes to the bodies of a model.

    Args:
        spec: the model that grows
        options: choices for the whole model

    Attributes:
        meshes: {name in the model: mesh}, each mesh once however often it is used
        surfaces: what may touch
    """

    def __init__(self, spec: mujoco.MjSpec, options: ModelOptions) -> None:
        self._spec, self._options = spec, options
        self.meshes: dict[str, Mesh] = {}
        self.surfaces: list[Surface] = []

    def add(self, body: mujoco.MjsBody, name: str, shape: Shape, mask: ContactMask) -> None:
        """Add massless geoms for a shape where it collides or, by the options, is seen."""
        options = self._options
        collides = shape.collide and options.collisions and mask.conaffinity != 0
        if options.standalone:
            if shape.visible:
                self._add(body, "", shape, None, VISUAL_GROUP)
            if collides:
                hull = capsule_about(shape) if shape.hull == "capsule" else shape
                self._add(body, "", hull, mask, COLLISION_GROUP)
            return
        if not collides and not (options.decoration and shape.visible):
            return
        if collides and not options.decoration and shape.hull == "capsule":
            shape = capsule_about(shape)
        seen = SOLID_GROUP if shape.collide else VISUAL_GROUP
        group = seen if shape.visible else COLLISION_GROUP
        self._add(body, name, shape, mask if collides else ContactMask(0, 0), group)

    def _add(
        self, body: mujoco.MjsBody, name: str, shape: Shape, mask: ContactMask | None, group: int
    ) -> None:
        looks: dict[str, str] = {}
        if shape.mesh is not None:
            looks["meshname"] = self._mesh(shape.mesh, convex=not shape.visible)
        if self._options.decoration or (self._options.standalone and mask is None):
            looks["material"] = self._material(shape.material)
        geom = body.add_geom(
            name=name,
            type=KINDS[shape.kind],
            size=np.zeros(3) if shape.mesh else shape.size,
            pos=shape.pose[:3, 3],
            quat=quaternion_from_matrix(shape.pose[:3, :3]),
            mass=0.0,
            group=group,
            contype=mask.contype if mask else 0,
            conaffinity=mask.conaffinity if mask else 0,
            **looks,
        )
        if mask is not None:
            set_contact(geom, self._options)
            if shape.friction is not None:  # prevails over shapes that give none
                geom.friction, geom.priority = [shape.friction, *geom.friction[1:]], 1
            if mask.contype or mask.conaffinity:
                self.surfaces.append(Surface(geom, shape, body.name))

    def _mesh(self, mesh: Mesh, convex: bool) -> str:
        """Return a mesh's name in the model; different meshes of one name are numbered.

        Args:
            mesh: the triangles
            convex: whether its hull collides; else it is only seen
        """
        name, number = mesh.name or "mesh", 1
        while (there := self.meshes.get(name)) is not None:
            same = np.array_equal(there.vertices, mesh.vertices)
            if same and np.array_equal(there.faces, mesh.faces):
                return name
            number += 1
            name = f"{mesh.name}_{number}"
        self.meshes[name] = mesh
        made = self._spec.add_mesh(
            name=name, uservert=mesh.vertices.ravel(), userface=mesh.faces.astype("int32").ravel()
        )
        kinds = mujoco.mjtMeshInertia
        made.inertia = kinds.mjMESH_INERTIA_CONVEX if convex else kinds.mjMESH_INERTIA_SHELL
        if mesh.normals is not None:
            made.usernormal = mesh.normals.ravel()
            made.userfacenormal = mesh.faces.astype("int32").ravel()
        return name

    def _material(self, name: str) -> str:
        """Return the name of a row of `materials`, which the model then has."""
        if self._spec.material(name) is None:
            look = MATERIALS[name]
            self._spec.add_material(
                name=name,
                rgba=look.rgba,
                specular=look.gloss,
                shininess=look.gloss,
                reflectance=0.0,
            )
        return name


def set_contact(geom: mujoco.MjsGeom, options: ModelOptions) -> None:
    """Give a geom the friction and the stiffness of contacts."""
    geom.condim = 4
    geom.friction = CONTACT_FRICTION
    geom.solref = [CONTACT_STEPS * options.timestep, 1.0]
    geom.solimp = CONTACT_IMPEDANCE


def capsule_about(shape: Shape) -> Shape:
    """Return the capsule along a box's longest edge (or a cylinder's axis), as thick as it is wide.

    It has the length of the shape, so corners stick out and the middle of flat sides does not.
    """
    if shape.kind != "box":
        radius, half, _ = shape.size
        length = max(half - radius, 1e-4)
        return replace(shape, kind="capsule", size=np.array([radius, length, 0.0]))
    order = np.argsort(shape.size)
    axis = int(order[2])
    radius = float(shape.size[order[1]])
    turn = np.roll(np.eye(3), 2 - axis, axis=1)
    pose = shape.pose @ transform(turn, np.zeros(3))
    half = max(float(shape.size[axis]) - radius, 1e-4)
    return replace(shape, kind="capsule", pose=pose, size=np.array([radius, half, 0.0]))
