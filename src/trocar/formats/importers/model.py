"""A robot or object of another tool: links, joints, loops and shapes in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import transform
from trocar.kinematics.mechanism import Motion

Array = NDArray[np.float64]

#: What URDF and SDF call the joints that we have.
KINDS: Mapping[str, Motion] = {
    "fixed": "fixed",
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
}


class ImportFileError(InputError):
    """A file that cannot be used; `line` counts from 1."""

    def __init__(self, file: str, problem: str, line: int | None = None) -> None:
        self.file = file
        self.line = line
        super().__init__(f"{file}: {problem}" if line is None else f"{file}:{line}: {problem}")


@dataclass(frozen=True, eq=False)
class LinkShape:
    """A shape in its link, and whether it is looked at, touched, or both."""

    shape: Shape
    visible: bool
    collide: bool


@dataclass(frozen=True, eq=False)
class SourceLink:
    """A rigid body.

    Attributes:
        name: as in the file
        mass: [kg], 0 of a mere frame
        com, inertia: in the link's axes, inertia about the centre of mass [m, kg m^2]
        shapes: in the link's frame
    """

    name: str
    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))
    shapes: tuple[LinkShape, ...] = ()


@dataclass(frozen=True, eq=False)
class ModelJoint:
    """How a link moves on its parent: T_parent_child = pose @ motion about (point, axis).

    Attributes:
        name: as in the file
        kind: fixed, revolute or prismatic
        parent, child: names of links
        pose: T_parent_child where the coordinate is 0, (4, 4)
        axis: unit direction in the child, (3,)
        point: a point of the axis in the child, (3,) [m]
        lower, upper: infinite where the file gives none [rad or m]
        effort, velocity: infinite where the file gives none
        damping, friction: viscous and dry
        follows: (joint, ratio, offset) of a joint that moves as another does
        driven: whether a motor may sit on it
    """

    name: str
    kind: Motion
    parent: str
    child: str
    pose: Array
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    point: Array = field(default_factory=lambda: np.zeros(3))
    lower: float = -np.inf
    upper: float = np.inf
    effort: float = np.inf
    velocity: float = np.inf
    damping: float = 0.0
    friction: float = 0.0
    follows: tuple[str, float, float] | None = None
    driven: bool = True

    def motion(self, value: float) -> Array:
        """Return the joint's motion in its child link, (4, 4)."""
        if self.kind == "prismatic":
            return transform(np.eye(3), value * self.axis)
        turn = matrix_from_rotation_vector(value * self.axis)
        return transform(turn, self.point - turn @ self.point)


@dataclass(frozen=True, eq=False)
class LoopPoint:
    """A point that two links share, (3,) in each [m]."""

    name: str
    link_a: str
    point_a: Array
    link_b: str
    point_b: Array


@dataclass(frozen=True, eq=False)
class SourceModel:
    """A tree of links with what closes loops; `links` has parents before children."""

    name: str
    file: str
    links: tuple[SourceLink, ...]
    joints: tuple[ModelJoint, ...]
    loops: tuple[LoopPoint, ...]
    warnings: tuple[str, ...]

    @property
    def moves(self) -> bool:
        """Whether any joint does."""
        return any(joint.kind != "fixed" for joint in self.joints)

    def poses(self) -> dict[str, Array]:
        """Return {link: its pose in the root (4, 4)} where all coordinates are 0."""
        at = {self.links[0].name: np.eye(4)}
        for joint in self.joints:
            at[joint.child] = at[joint.parent] @ joint.pose
        return at


def as_tree(
    file: str, links: Sequence[SourceLink], joints: Sequence[ModelJoint]
) -> tuple[tuple[SourceLink, ...], tuple[ModelJoint, ...]]:
    """Return links and joints with parents first.

    Raises:
        ImportFileError: a name twice, a joint between links that are not there, a loop, or more
            than one root
    """
    by_name = {link.name: link for link in links}
    for what, names in (("link", [k.name for k in links]), ("joint", [j.name for j in joints])):
        for again in sorted({n for n in names if names.count(n) > 1}):
            raise ImportFileError(file, f"{what} {again!r} is defined twice")
    above: dict[str, ModelJoint] = {}
    for joint in joints:
        for side in (joint.parent, joint.child):
            if side not in by_name:
                raise ImportFileError(
                    file,
                    f"joint {joint.name!r} names link {side!r}; known: {', '.join(by_name)}",
                )
        if joint.child in above:
            raise ImportFileError(
                file,
                f"link {joint.child!r} has two parent joints, {above[joint.child].name!r} and"
                f" {joint.name!r}: this format has no closed loops; allowed: one parent"
                " (SDF and MJCF support closed loops)",
            )
        above[joint.child] = joint
    roots = [name for name in by_name if name not in above]
    if len(roots) != 1:
        found = ", ".join(roots) or "none, the links go round in a ring"
        raise ImportFileError(file, f"got {len(roots)} root links ({found}); allowed: one")
    order, waiting = [roots[0]], [roots[0]]
    while waiting:
        parent = waiting.pop(0)
        children = [j.child for j in joints if j.parent == parent]
        order += children
        waiting += children
    if len(order) != len(by_name):
        lost = ", ".join(sorted(set(by_name) - set(order)))
        raise ImportFileError(file, f"links {lost} form a cycle; allowed: a tree")
    return tuple(by_name[n] for n in order), tuple(above[n] for n in order[1:])


def nearest_material(rgba: Array | None) -> str:
    """Return the name of our material that comes nearest to a colour, "casting" without one."""
    if rgba is None:
        return "casting"
    off = {
        name: float(np.sum((np.array(m.rgba[:3]) - rgba[:3]) ** 2)) for name, m in MATERIALS.items()
    }
    return min(off, key=lambda name: off[name])


def solid(kind: str, pose: Array, sizes: Sequence[float], material: str) -> Shape:
    """Return a primitive along z.

    Args:
        kind: box, sphere, cylinder or capsule
        pose: of its centre, (4, 4)
        sizes: edges of a box; radius; radius and length, of a capsule's straight part [m]
        material: its name
    """
    if kind == "box":
        return Shape("box", pose, 0.5 * np.asarray(sizes, dtype=np.float64), material)
    radius, length = (*sizes, 0.0)[:2]
    return Shape(kind, pose, np.array([radius, 0.5 * length, 0.0]), material)  # type: ignore[arg-type]


def mesh_shape(pose: Array, surface: Mesh, material: str) -> Shape:
    """Return a mesh from its triangles."""
    reach = np.abs(surface.vertices).max(axis=0)
    return Shape("mesh", pose, reach, material, collide=False, weigh=False, mesh=surface)
