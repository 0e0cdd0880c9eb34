"""Shapes from TOML, and the mass properties of bodies made of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import chain
from typing import Literal, TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import read_mesh
from trocar.descriptions.needles import Needle
from trocar.descriptions.records import Body, Shape, ShapeKind, Touches
from trocar.descriptions.revolved import cup, ring
from trocar.descriptions.solids import Solid, read_solid, seen_and_touched, solid_names
from trocar.descriptions.table import Table
from trocar.descriptions.threads import ChainThread
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]

KINDS = ("box", "capsule", "cylinder", "sphere", "mesh", "ring", "cup")
#: Rods of a ring, and up to how many. Source: our own choice.
SIDES, MOST_SIDES = 16, 64
#: Slack of the triangle inequality for rounded inertias, relative. Our own choice.
INERTIA_SLACK = 1e-3
#: Arc of a needle for each capsule that touches. Source: our own choice; their axes then lie within
#: 0.09 mm of an arc of 10 mm radius. [rad]
CAPSULE_RAD = np.pi / 12.0


def read_shapes(table: Table) -> tuple[Shape, ...]:
    """Return the shapes of a body or a prop; a ring or a cup is several.

    Raises:
        DescriptionError: unknown kind or material, a size that is not positive
    """
    return tuple(chain.from_iterable(table.each("shape", _read_shape)))


def _read_shape(table: Table) -> tuple[Shape, ...]:
    kind = table.text("kind", allowed=KINDS)
    material = _read_material(table)
    if kind == "mesh":
        return (_read_mesh_shape(table, material),)
    if kind in ("ring", "cup"):
        return _read_round(table, kind, material)
    if kind == "box":
        size = 0.5 * table.vector("size", 3, "length")
        rpy = table.vector("rpy", 3, "angle", default=np.zeros(3))
        pose = transform(matrix_from_rpy(*rpy), table.vector("center", 3, "length"))
    elif kind == "sphere":
        size = np.array([table.quantity("radius", "length"), 0.0, 0.0])
        pose = transform(np.eye(3), table.vector("center", 3, "length"))
    else:
        start, end = table.vector("from", 3, "length"), table.vector("to", 3, "length")
        length = float(np.linalg.norm(end - start))
        if length <= 0.0:
            raise table.fail("to", "got the same point as `from`; allowed: another point")
        size = np.array([table.quantity("radius", "length"), 0.5 * length, 0.0])
        pose = transform(_rotation_to(end - start), 0.5 * (start + end))
    if not (size[: {"box": 3, "sphere": 1}.get(kind, 2)] > 0.0).all():
        raise table.fail("size" if kind == "box" else "radius", "must be positive")
    rounding = table.quantity("round", "length", default=0.0)
    if not 0.0 <= rounding <= (size.min() if kind == "box" else 0.0):
        raise table.fail("round_mm", "allowed: 0 to half of a box's smallest edge")
    shape = Shape(
        kind=cast(ShapeKind, kind),
        pose=pose,
        size=size,
        material=material,
        rounding=rounding,
        collide=table.flag("collide", True),
        weigh=table.flag("weigh", True),
        hull=cast(Literal["same", "capsule"], table.text("hull", "same", ("same", "capsule"))),
        visible=table.flag("visible", True),
        density=_positive(table, "density", "density"),
        **_read_surface(table),
    )
    if shape.density is not None and not shape.weigh:
        raise table.fail("density", "contradicts weigh = false; give one of them")
    return (shape,)


def _read_round(table: Table, kind: str, material: str) -> tuple[Shape, ...]:
    """Return the shapes of a ring or a cup."""
    turn = matrix_from_rpy(*table.vector("rpy", 3, "angle", default=np.zeros(3)))
    at = table.vector("center", 3, "length", default=np.zeros(3))
    like = Shape(
        "capsule",
        transform(turn, at),
        np.zeros(3),
        material,
        collide=table.flag("collide", True),
        weigh=table.flag("weigh", True),
        visible=table.flag("visible", True),
        density=_positive(table, "density", "density"),
        **_read_surface(table),
    )
    keys = ("radius", "wire_radius") if kind == "ring" else ("radius", "wall", "height", "floor")
    sizes = [table.positive(key, "length") for key in keys]
    sides = 0
    if kind == "ring":
        sides = int(table.number("sides", SIDES))
        table.raw("sides")
        if not 3 <= sides <= MOST_SIDES:
            raise table.fail("sides", f"got {sides}; allowed: 3 to {MOST_SIDES}")
    if kind == "ring":
        return ring(like, sizes[0], sizes[1], sides)
    return cup(like, sizes[0], sizes[1], sizes[2], sizes[3])


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


def _read_material(table: Table) -> str:
    """Return the name of a material, or of a free colour, as `materials` has it."""
    if "color" not in table:
        return table.text("material", "casting", allowed=tuple(MATERIALS))
    if "material" in table:
        raise table.fail("color", "contradicts material; give one of them")
    colour = table.text("color")
    if re.fullmatch("#[0-9a-fA-F]{6}", colour) is None:
        raise table.fail("color", f'got {colour!r}; allowed: "#" and six digits, as "#b8352f"')
    return f"color_{colour[1:].lower()}"


class _RevolvedSurface(TypedDict):
    friction: float | None
    stiffness: float | None


def _read_surface(table: Table) -> _RevolvedSurface:
    """Return what a shape gives of its contacts."""
    friction = table.number("friction") if "friction" in table else None
    table.raw("friction")
    if friction is not None and friction < 0.0:
        raise table.fail("friction", f"got {friction:g}; allowed: 0 or more")
    return {
        "friction": friction,
        "stiffness": _positive(table, "stiffness", "linear stiffness"),
    }


def _positive(table: Table, name: str, dimension: str) -> float | None:
    return table.positive(name, dimension) if table.has(name, dimension) else None


def _read_mesh_shape(table: Table, material: str) -> Shape:
    """Return triangles from a file: looked at, and where they collide, their convex hull."""
    if table.flag("weigh", False):
        raise table.fail(
            "weigh",
            "got true; allowed: false, for a mesh weighs nothing; give mass, com and inertia, or"
            " a box, capsule, cylinder or sphere beside it",
        )
    mesh = read_mesh(table)
    turn = matrix_from_rpy(*table.vector("rpy", 3, "angle", default=np.zeros(3)))
    at = table.vector("center", 3, "length", default=np.zeros(3))
    collide, visible = table.flag("collide", False), table.flag("visible", True)
    surface = _read_surface(table)
    return Shape(
        "mesh",
        transform(turn, at),
        np.abs(mesh.vertices).max(axis=0),
        material,
        collide=collide,
        weigh=False,
        mesh=mesh,
        visible=visible,
        **surface,
    )


def read_body(table: Table, part: str) -> Body:
    """Return a body; what the table does not give comes from its shapes at the given mass.

    Raises:
        DescriptionError: an impossible body (mass, positive definiteness, triangle inequality)
    """
    frame = table.text("frame")
    solid = read_drawn(table)
    touches = read_touches(table, solid)
    drawn = () if solid is None else seen_and_touched(solid, touches)
    shapes = (*drawn, *read_shapes(table))
    mass = read_mass(table, shapes)
    com, inertia, origin = read_inertia(table, solid, shapes, mass)
    source, name = table.text("source", ""), "" if solid is None else solid.name
    return Body(frame, mass, com, inertia, shapes, origin, source, part, name, touches)


def read_mass(table: Table, shapes: tuple[Shape, ...] = ()) -> float:
    """Return the mass that a body must have, or that of its shapes by their densities [kg].

    Raises:
        DescriptionError: no mass, one that is not above 0, one beside densities, or densities of
            some shapes only
    """
    weighed = [shape for shape in shapes if shape.weigh]
    dense = [shape for shape in weighed if shape.density is not None]
    if dense and table.has("mass", "mass"):
        raise table.fail("mass", "contradicts the density of a shape; give one of them")
    if dense and len(dense) < len(weighed):
        raise table.fail(
            "shape",
            f"got a density of {len(dense)} of {len(weighed)} shapes that weigh; allowed: of all,"
            " of none, or weigh = false",
        )
    if dense:
        return float(densities(dense) @ [volume(shape) for shape in dense])
    mass = table.quantity("mass", "mass")
    if mass <= 0.0:
        raise table.fail("mass_kg", f"got {mass:g}; allowed: above 0")
    return mass


def read_inertia(
    table: Table, solid: Solid | None, shapes: tuple[Shape, ...], mass: float
) -> tuple[Array, Array, str]:
    """Return centre of mass, inertia about it and what that is from.

    Raises:
        DescriptionError: an impossible body, or nothing to compute its inertia from
    """
    com, inertia, origin = _uniform(table, solid, shapes, mass)
    com = table.vector("com", 3, "length", default=com)
    if origin == "source":
        xx, yy, zz, xy, xz, yz = table.vector("inertia", 6, "inertia")
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    problem = impossible(inertia)
    if problem:
        raise table.fail("inertia_kgm2", problem)
    return com, inertia, origin


def read_drawn(table: Table) -> Solid | None:
    """Return the solid that a body or a prop names, None where it names none.

    Raises:
        DescriptionError: no such solid
    """
    name = table.text("solid", "")
    if not name:
        return None
    try:
        return read_solid(name)
    except KeyError:
        known = solid_names()
        near = [one for one in known if one.partition("/")[0] == name.partition("/")[0]]
        allowed = ", ".join(near or known) or "none, for none are drawn"
        raise table.fail("solid", f"got {name!r}; allowed: {allowed}") from None


def read_touches(table: Table, solid: Solid | None) -> Touches:
    """Return what of a solid collides, as the table says."""
    value = table.raw("touches", False)
    if solid is None and value is not False:
        raise table.fail("touches", f"got {value!r}; allowed: false where there is no `solid`")
    if value is False:
        return "nothing"
    if value is True:
        return "pieces"
    if value in ("box", "capsule"):
        return cast(Touches, value)
    raise table.fail("touches", f'got {value!r}; allowed: true, false, "box", "capsule"')


def _uniform(
    table: Table, solid: Solid | None, shapes: tuple[Shape, ...], mass: float
) -> tuple[Array, Array, str]:
    """Return centre, inertia and what they are from: a drawn solid, or primitive shapes."""
    weighed = [s for s in shapes if s.weigh]
    origin = "source" if "inertia_kgm2" in table else "solid" if solid else "shape"
    if solid is not None:
        return solid.com, mass * solid.gyration, origin
    if weighed:
        return *mass_properties(weighed, mass), origin
    if origin == "shape":
        raise table.fail("inertia_kgm2", "is missing, and there is no shape to compute it from")
    return np.zeros(3), np.eye(3), origin


def impossible(inertia: Array) -> str:
    """Say why an inertia about the centre of mass belongs to no body, or return ""."""
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
