"""Props from TOML: what stands in a rig's world, and what lies there to be moved."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.frames import read_pose
from trocar.descriptions.inertial import merged
from trocar.descriptions.records import Body, Movable, Prop, Shape
from trocar.descriptions.shapes import (
    read_body,
    read_drawn,
    read_inertia,
    read_mass,
    read_shape,
    read_touches,
)
from trocar.descriptions.solids import seen_and_touched
from trocar.descriptions.table import Table, read_table

Array = NDArray[np.float64]

#: The version of prop files. Source: that of arms, tools and rigs.
SCHEMA = 1
#: What the rig itself is called where commands are told.
RESERVED = ("world",)
#: What a part of a topic's name may be. Source: ROS 1 and ROS 2, "Names".
OBJECT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
#: Thinner than this share of its length, a mesh has no volume. Source: our own choice; MuJoCo
#: refuses hulls without volume.
FLAT = 1e-6


def read_prop(row: Table) -> Prop:
    """Return a prop: shapes in the rig's own file, or bodies in a file of its own.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    name, at = row.text("name"), read_pose(row)
    moves = row.flag("movable", False)
    if not moves and (row.has("mass", "mass") or "inertia_kgm2" in row):
        raise row.fail("movable", "is missing; a prop that stands still has no mass")
    movable: Movable | None = None
    if "description" in row:
        bodies = _read_bodies(row)
        shapes = tuple(shape for body in bodies for shape in body.shapes)
        if moves:
            movable = _from_bodies(row, bodies)
    else:
        solid = read_drawn(row)
        touches = read_touches(row, solid)
        drawn = () if solid is None else seen_and_touched(solid, touches)
        shapes = (*drawn, *(read_shape(s) for s in row.tables("shape")))
        if moves:
            mass = read_mass(row)
            movable = Movable(mass, *read_inertia(row, solid, shapes, mass))
    if moves:
        _check_touchable(row, shapes)
    row.text("source", "")
    row.done()
    return Prop(name, at, shapes, movable)


def check_object_name(table: Table, name: str, arms: Iterable[str]) -> None:
    """Refuse the name of a movable prop that commands and topics could not tell from others.

    Raises:
        DescriptionError: what was got and what is allowed
    """
    if not OBJECT_NAME.fullmatch(name):
        raise table.fail(
            "prop.name",
            f"got {name!r}; allowed for a movable prop: a letter, then letters, digits and _",
        )
    if name in (*arms, *RESERVED):
        raise table.fail("prop.name", f"got {name!r}, which is an arm or the world itself")


def _read_bodies(row: Table) -> list[Body]:
    """Return the bodies of a prop's own file, whose path is relative to the rig's folder."""
    table = read_table(Path(row.file).parent / row.text("description"))
    if table.raw("schema") != SCHEMA:
        raise table.fail("schema", f"got {table.raw('schema')!r}; allowed: {SCHEMA}")
    for key in ("name", "title", "source"):
        table.text(key, "")
    bodies = [read_body(body, table.file) for body in table.tables("body")]
    if not bodies:
        raise table.fail("body", "is missing; a prop needs at least one body")
    table.done()
    return bodies


def _from_bodies(row: Table, bodies: list[Body]) -> Movable:
    """Return what bodies weigh as one, or what they would at the mass that the rig gives."""
    mass, com, inertia = merged(bodies)
    wanted = read_mass(row) if row.has("mass", "mass") else mass
    return Movable(wanted, com, inertia * wanted / mass, bodies[0].inertia_from)


def _check_touchable(row: Table, shapes: tuple[Shape, ...]) -> None:
    """Refuse an object that would fall through everything, or whose hull has no volume."""
    touching = [shape for shape in shapes if shape.collide]
    if not touching:
        raise row.fail(
            "movable",
            "got true, but no shape of the prop collides and it would fall through everything;"
            " allowed: with a shape that has collide = true, or a solid with touches = true",
        )
    for shape in touching:
        if shape.mesh is not None and _is_flat(shape.mesh.vertices):
            raise row.fail(
                "movable",
                f"got true, but the mesh {shape.mesh.name!r} that collides is flat and has no"
                " volume; allowed: a solid body, or a box, capsule, cylinder or sphere",
            )


def _is_flat(vertices: Array) -> bool:
    """Tell whether points lie in one plane, as far as their length lets one say."""
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    return len(spread) < 3 or bool(spread[2] <= FLAT * spread[0])
