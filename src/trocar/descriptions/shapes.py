"""Shapes from TOML, and the mass properties of bodies made of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.keys import key
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import read_mesh
from trocar.descriptions.needles import Needle
from trocar.descriptions.records import Body, Shape, Touches
from trocar.descriptions.revolved import cup, ring
from trocar.descriptions.solids import Solid, read_solid, seen_and_touched, solid_names
from trocar.descriptions.table import Table
from trocar.descriptions.threads import ChainThread
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]

RODS = ("capsule", "cylinder")
PRIMITIVES = ("box", *RODS, "sphere")
KINDS = (*PRIMITIVES, "mesh", "ring", "cup")
#: Rods of a ring, and up to how many. Source: our own choice.
SIDES, MOST_SIDES = 16, 64
#: Slack of the triangle inequality for rounded inertias, relative. Our own choice.
INERTIA_SLACK = 1e-3
#: Arc of a needle for each capsule that touches. Source: our own choice; their axes then lie within
#: 0.09 mm of an arc of 10 mm radius. [rad]
CAPSULE_RAD = np.pi / 12.0


def _origin() -> Array:
    return np.zeros(3)


def read_shapes(table: Table) -> tuple[Shape, ...]:
    """Return the shapes of a body or a prop; a ring or a cup is several.

    Raises:
        DescriptionError: unknown kind or material, a size that is not positive
    """
    return tuple(chain.from_iterable(table.each("shape", _read_shape)))


@dataclass(frozen=True)
class MaterialKeys:
    """Keys of a shape's look.

    Attributes:
        material: of the surface; default: casting
        color: instead of `material`: `"#b8352f"`
    """

    material: str | None = field(default=None, metadata=key(choices=tuple(MATERIALS)))
    color: str | None = field(default=None, metadata=key())


@dataclass(frozen=True, eq=False)
class ShapeKeys:
    """Keys of a shape, in the frame's coordinates.

    Attributes:
        kind: of the shape
        center: its centre, (3,) [m]
        size: full edges, (3,) [m]
        start, end: ends of its axis; the hemispheres of a capsule are beyond them, (3,) [m]
        radius: its radius [m]
        at: place in the frame, (3,) [m]
        rpy: rotation about the fixed axes x, y, z, (3,) [rad]
        round: radius of the drawn edges of a box [m]
        bend: radius of a ring's middle line about z; of a cup, which stands at z = 0, inside [m]
        wire_radius: of the ring's wire [m]
        sides: number of rods that collide; below 8: corners at `radius`
        wall, height, floor: thickness, height, thickness of the bottom [m]
        collide: whether it takes part in contacts; default: yes, a mesh no
        weigh: whether it counts for the mass of its body; default: yes, a mesh never
        visible: whether it is drawn
        hull: `capsule`: one along its longest edge collides in its place
        density: instead of the body's mass, of every shape that weighs [kg/m^3]
        friction: sliding coefficient; a shape with it decides over one without; of two, the larger
            counts; default: 1
        stiffness: of a soft shape, at each contact point; default: rigid [N/m]
    """

    kind: Literal["box", "capsule", "cylinder", "sphere", "mesh", "ring", "cup"] = field(
        metadata=key()
    )
    center: Array | None = field(
        default=None, metadata=key("length", size=3, of=("box", "sphere"), default=...)
    )
    size: Array | None = field(
        default=None, metadata=key("length", size=3, of=("box",), default=...)
    )
    start: Array | None = field(
        default=None, metadata=key("length", name="from", size=3, of=RODS, default=...)
    )
    end: Array | None = field(
        default=None, metadata=key("length", name="to", size=3, of=RODS, default=...)
    )
    radius: float = field(default=0.0, metadata=key("length", of=(*RODS, "sphere"), default=...))
    at: Array = field(
        default_factory=_origin,
        metadata=key("length", name="center", size=3, of=("ring", "cup", "mesh")),
    )
    rpy: Array = field(
        default_factory=_origin,
        metadata=key("angle", size=3, of=("box", "ring", "cup", "mesh")),
    )
    round: float = field(default=0.0, metadata=key("length", of=PRIMITIVES))
    bend: float = field(
        default=0.0,
        metadata=key("length", name="radius", above=0.0, of=("ring", "cup"), default=...),
    )
    wire_radius: float = field(
        default=0.0, metadata=key("length", above=0.0, of=("ring",), default=...)
    )
    sides: int = field(default=SIDES, metadata=key(least=3, most=MOST_SIDES, of=("ring",)))
    wall: float = field(default=0.0, metadata=key("length", above=0.0, of=("cup",), default=...))
    height: float = field(default=0.0, metadata=key("length", above=0.0, of=("cup",), default=...))
    floor: float = field(default=0.0, metadata=key("length", above=0.0, of=("cup",), default=...))
    collide: bool | None = field(default=None, metadata=key())
    weigh: bool | None = field(default=None, metadata=key())
    visible: bool = field(default=True, metadata=key())
    hull: Literal["same", "capsule"] = field(default="same", metadata=key(of=PRIMITIVES))
    density: float | None = field(
        default=None, metadata=key("density", above=0.0, of=(*PRIMITIVES, "ring", "cup"))
    )
    friction: float | None = field(default=None, metadata=key(least=0.0))
    stiffness: float | None = field(default=None, metadata=key("linear stiffness", above=0.0))


def _read_shape(table: Table) -> tuple[Shape, ...]:
    kind = table.text("kind", allowed=KINDS)
    material = _material(table, table.record(MaterialKeys))
    keys = table.record(ShapeKeys, kind)
    like = Shape(
        "capsule",
        transform(matrix_from_rpy(*keys.rpy), keys.at),
        np.zeros(3),
        material,
        collide=keys.collide is not False,
        weigh=keys.weigh is not False,
        hull=keys.hull,
        visible=keys.visible,
        friction=keys.friction,
        density=keys.density,
        stiffness=keys.stiffness,
    )
    if keys.kind == "mesh":
        return (_read_mesh_shape(table, keys, like),)
    if keys.kind == "ring":
        return ring(like, keys.bend, keys.wire_radius, keys.sides)
    if keys.kind == "cup":
        return cup(like, keys.bend, keys.wall, keys.height, keys.floor)
    pose, size = _primitive(table, keys)
    if not (size[: {"box": 3, "sphere": 1}.get(keys.kind, 2)] > 0.0).all():
        raise table.fail("size" if keys.kind == "box" else "radius", "must be positive")
    if not 0.0 <= keys.round <= (size.min() if keys.kind == "box" else 0.0):
        raise table.fail("round_mm", "allowed: 0 to half of a box's smallest edge")
    if keys.density is not None and not like.weigh:
        raise table.fail("density", "contradicts weigh = false; give one of them")
    return (replace(like, kind=keys.kind, pose=pose, size=size, rounding=keys.round),)


def _primitive(table: Table, keys: ShapeKeys) -> tuple[Array, Array]:
    """Return pose and size of a box, sphere, capsule or cylinder."""
    if keys.size is not None and keys.center is not None:
        return transform(matrix_from_rpy(*keys.rpy), keys.center), 0.5 * keys.size
    if keys.start is None or keys.end is None:
        center = np.zeros(3) if keys.center is None else keys.center
        return transform(np.eye(3), center), np.array([keys.radius, 0.0, 0.0])
    way = keys.end - keys.start
    length = float(np.linalg.norm(way))
    if length <= 0.0:
        raise table.fail("to", "got the same point as `from`; allowed: another point")
    pose = transform(_rotation_to(way), 0.5 * (keys.start + keys.end))
    return pose, np.array([keys.radius, 0.5 * length, 0.0])


def needle_shapes(needle: Needle, material: str) -> tuple[Shape, ...]:
    """Return the smooth surface of a needle that is drawn, and the capsules that touch."""
    mesh = needle.mesh()
    reach = np.abs(mesh.vertices).max(axis=0)
    seen = Shape("mesh", np.eye(4), reach, material, collide=False, weigh=False, mesh=mesh)
    angles = np.linspace(0.0, needle.arc, max(1, round(needle.arc / CAPSULE_RAD)) + 1)
    ends, thick = needle.points(angles), needle.half_width(0.5 * (angles[1:] + angles[:-1]))
    touching: list[Shape] = []
    for start, end, radius in zip(ends[:-1], ends[1:], thick, strict=True):
        pose = transform(_rotation_to(end - start), 0.5 * (start + end))
        size = np.array([radius, 0.5 * np.linalg.norm(end - start), 0.0])
        touching.append(Shape("capsule", pose, size, material, visible=False))
    return (seen, *touching)


def link_shape(thread: ChainThread) -> Shape:
    """Return the capsule of a thread's link, which is not drawn: a curve is."""
    x, radius, half = np.array([1.0, 0.0, 0.0]), 0.5 * thread.diameter, 0.5 * thread.link
    size, pose = np.array([radius, half, 0.0]), transform(_rotation_to(x), half * x)
    return Shape("capsule", pose, size, thread.material, visible=False, friction=thread.friction)


def _material(table: Table, keys: MaterialKeys) -> str:
    """Return the name of a material, or of a free colour, as `materials` has it."""
    if keys.color is None:
        return keys.material or "casting"
    if keys.material is not None:
        raise table.fail("color", "contradicts material; give one of them")
    if re.fullmatch("#[0-9a-fA-F]{6}", keys.color) is None:
        raise table.fail("color", f'got {keys.color!r}; allowed: "#" and six digits, as "#b8352f"')
    return f"color_{keys.color[1:].lower()}"


def _read_mesh_shape(table: Table, keys: ShapeKeys, like: Shape) -> Shape:
    """Return triangles from a file: they are drawn; their convex hull collides."""
    if keys.weigh:
        raise table.fail(
            "weigh",
            "got true; allowed: false, for a mesh weighs nothing; give mass, com and inertia, or"
            " a box, capsule, cylinder or sphere beside it",
        )
    mesh = read_mesh(table)
    size = np.abs(mesh.vertices).max(axis=0)
    collide = keys.collide is True
    return replace(like, kind="mesh", size=size, collide=collide, weigh=False, mesh=mesh)


@dataclass(frozen=True, eq=False)
class DrawnKeys:
    """Keys of a drawn solid.

    Attributes:
        solid: a drawn solid, `"psm/pitch_back"`
        touches: how the solid collides: `true`, `"box"` or `"capsule"`; default: no contact
    """

    solid: str = field(default="", metadata=key(see="bodies.md"))
    touches: object = field(default=False, metadata=key(form="any", see="bodies.md#contact"))


@dataclass(frozen=True, eq=False)
class MassKeys:
    """Keys of a mass distribution.

    Attributes:
        mass: above 0; omitted if the shapes have a density [kg]
        com: centre of mass; default: from the solid, else the shapes, (3,) [m]
        inertia: `[ixx, iyy, izz, ixy, ixz, iyz]` about the centre of mass, in the frame's axes;
            default: as for `com` [kg m^2]
    """

    mass: float | None = field(default=None, metadata=key("mass"))
    com: Array | None = field(default=None, metadata=key("length", size=3))
    inertia: Array | None = field(default=None, metadata=key("inertia", size=6))


@dataclass(frozen=True, eq=False)
class BodyKeys(DrawnKeys, MassKeys):
    """Keys of a body.

    Attributes:
        frame: that it moves with
    """

    frame: str = field(kw_only=True, metadata=key())


def read_body(table: Table, part: str) -> Body:
    """Read a body; its shapes give mass properties that the table lacks, at the given mass.

    Raises:
        DescriptionError: an impossible body (mass, positive definiteness, triangle inequality)
    """
    keys = table.record(BodyKeys)
    solid, touches = read_drawn(table, keys)
    drawn = () if solid is None else seen_and_touched(solid, touches)
    shapes = (*drawn, *read_shapes(table))
    mass = read_mass(table, keys, shapes)
    com, inertia, origin = read_inertia(table, keys, solid, shapes, mass)
    source, name = table.text("source", ""), "" if solid is None else solid.name
    return Body(keys.frame, mass, com, inertia, shapes, origin, source, part, name, touches)


def read_mass(table: Table, keys: MassKeys, shapes: tuple[Shape, ...] = ()) -> float:
    """Return the mass that a body must have, or that of its shapes by their densities [kg].

    Raises:
        DescriptionError: no mass, one that is not above 0, one beside densities, or densities of
            some shapes only
    """
    weighed = [shape for shape in shapes if shape.weigh]
    dense = [shape for shape in weighed if shape.density is not None]
    if dense and keys.mass is not None:
        raise table.fail("mass", "contradicts the density of a shape; give one of them")
    if dense and len(dense) < len(weighed):
        raise table.fail(
            "shape",
            f"got a density of {len(dense)} of {len(weighed)} shapes that weigh; allowed: of all,"
            " of none, or weigh = false",
        )
    if dense:
        return float(densities(dense) @ [volume(shape) for shape in dense])
    mass = table.quantity("mass", "mass") if keys.mass is None else keys.mass
    if mass <= 0.0:
        raise table.fail("mass_kg", f"got {mass:g}; allowed: above 0")
    return mass


def read_inertia(
    table: Table, keys: MassKeys, solid: Solid | None, shapes: tuple[Shape, ...], mass: float
) -> tuple[Array, Array, str]:
    """Return centre of mass, inertia about it and the origin of the inertia.

    Raises:
        DescriptionError: an impossible body, or nothing to compute its inertia from
    """
    weighed = [s for s in shapes if s.weigh]
    if solid is not None:
        com, inertia, origin = solid.com, mass * solid.gyration, "solid"
    elif weighed:
        com, inertia, origin = *mass_properties(weighed, mass), "shape"
    elif keys.inertia is not None:
        com, inertia, origin = np.zeros(3), np.eye(3), "source"
    else:
        raise table.fail("inertia_kgm2", "is missing, and there is no shape to compute it from")
    if keys.com is not None:
        com = keys.com
    if keys.inertia is not None:
        xx, yy, zz, xy, xz, yz = keys.inertia
        inertia, origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), "source"
    problem = impossible(inertia)
    if problem:
        raise table.fail("inertia_kgm2", problem)
    return com, inertia, origin


def read_drawn(table: Table, keys: DrawnKeys) -> tuple[Solid | None, Touches]:
    """Return the solid of a body or a prop, None without one, and how it collides.

    Raises:
        DescriptionError: no such solid
    """
    value = keys.touches
    if not keys.solid:
        if value is not False:
            raise table.fail("touches", f"got {value!r}; allowed: false where there is no `solid`")
        return None, "nothing"
    try:
        solid = read_solid(keys.solid)
    except KeyError:
        known = solid_names()
        near = [one for one in known if one.partition("/")[0] == keys.solid.partition("/")[0]]
        allowed = ", ".join(near or known) or "none, for none are drawn"
        raise table.fail("solid", f"got {keys.solid!r}; allowed: {allowed}") from None
    if isinstance(value, bool):
        return solid, "pieces" if value else "nothing"
    if value in ("box", "capsule"):
        return solid, cast(Touches, value)
    raise table.fail("touches", f'got {value!r}; allowed: true, false, "box", "capsule"')


def impossible(inertia: Array) -> str:
    """Return the reason why an inertia about the centre of mass is impossible, "" if it is not."""
    low, middle, high = np.linalg.eigvalsh(inertia)
    if low <= 0.0:
        return f"no possible body: smallest principal inertia {low:.3g}, allowed above 0"
    if high > (low + middle) * (1.0 + INERTIA_SLACK):
        return (
            f"no possible body: principal inertia {high:.3g} exceeds the sum of the others"
            f" {low + middle:.3g}"
        )
    return ""


def mass_properties(shapes: list[Shape], mass: float) -> tuple[Array, Array]:
    """Return (com (3,), inertia about it (3, 3)) of solids that weigh `mass` together.

    Each is uniform, of its own density where shapes have one.
    """
    shares = np.array([volume(s) for s in shapes]) * densities(shapes)
    masses = mass / shares.sum() * shares
    centres = np.stack([s.pose[:3, 3] for s in shapes])
    com = shares @ centres / shares.sum()
    inertia = np.zeros((3, 3))
    for shape, weight, centre in zip(shapes, masses, centres, strict=True):
        turn = shape.pose[:3, :3]
        offset = centre - com
        own = turn @ np.diag(unit_inertia(shape)) @ turn.T
        inertia += weight * (own + offset @ offset * np.eye(3) - np.outer(offset, offset))
    return com, inertia


def densities(shapes: Sequence[Shape]) -> Array:
    """Return the density of each shape, 1 where it has none, (n,) [kg/m^3]."""
    return np.array([1.0 if s.density is None else s.density for s in shapes])


def volume(shape: Shape) -> float:
    """Return the volume of a shape [m^3]."""
    a, b, c = shape.size
    if shape.kind == "box":
        return float(8.0 * a * b * c)
    ball = 4.0 / 3.0 * np.pi * a**3
    if shape.kind == "sphere":
        return float(ball)
    return float(2.0 * np.pi * a * a * b + (ball if shape.kind == "capsule" else 0.0))


def unit_inertia(shape: Shape) -> Array:
    """Return the principal inertia of a solid of 1 kg about its centre, (3,) [m^2]."""
    a, b, c = shape.size
    if shape.kind == "box":
        return np.array([b * b + c * c, a * a + c * c, a * a + b * b]) / 3.0
    if shape.kind == "sphere":
        return np.full(3, 0.4 * a * a)
    side = a * a / 4.0 + b * b / 3.0
    rod = np.array([side, side, a * a / 2.0])
    if shape.kind == "cylinder":
        return rod
    share = (4.0 / 3.0 * np.pi * a**3) / volume(shape)
    cap = 0.4 * a * a
    across = cap + b * b + 0.75 * a * b  # two half balls, shifted by b: 2/5 a^2 + b^2 + 3/4 a b
    return (1.0 - share) * rod + share * np.array([across, across, cap])


def _rotation_to(direction: Array) -> Array:
    """Return a rotation whose z axis points along `direction`, (3, 3)."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
