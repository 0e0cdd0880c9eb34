"""Props from TOML: bodies beside the arms, the joints between them, and elastic bands."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.frames import read_pose
from trocar.descriptions.inertial import merged
from trocar.descriptions.keys import key
from trocar.descriptions.needles import Needle, NeedleLook, read_needle
from trocar.descriptions.plugins import registered_file
from trocar.descriptions.records import (
    Band,
    BandPoint,
    Body,
    Movable,
    Prop,
    PropJoint,
    PropJointKind,
    Shape,
)
from trocar.descriptions.shapes import (
    DrawnKeys,
    MassKeys,
    link_shape,
    mass_properties,
    needle_shapes,
    read_body,
    read_drawn,
    read_inertia,
    read_mass,
    read_shapes,
)
from trocar.descriptions.solids import seen_and_touched
from trocar.descriptions.table import Table, read_table
from trocar.descriptions.threads import read_thread
from trocar.descriptions.tissues import read_tissue
from trocar.geometry.se3 import transform
from trocar.inputs import is_file

Array = NDArray[np.float64]

#: Name of the rig itself as a source of commands.
RESERVED = ("world",)
#: Allowed part of a topic's name. Source: ROS 1 and ROS 2, "Names".
OBJECT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
#: Thinner than this share of its length, a mesh has no volume. Source: our own choice; MuJoCo
#: rejects hulls without volume.
FLAT = 1e-6
KINDS: tuple[str, ...] = get_args(PropJointKind)


def read_props(rig: Table, arms: Sequence[str]) -> tuple[Prop, ...]:
    """Return the props of a rig or a scene, carriers before what they carry.

    Args:
        rig: its file
        arms: names that no movable prop may have

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    found: list[Prop] = []

    def read(row: Table) -> Prop:
        prop = _read_prop(row, found)
        if prop.movable is not None:
            _check_object_name(row, prop.name, arms)
        found.append(prop)
        return prop

    return rig.each("prop", read, again="name")


@dataclass(frozen=True)
class PropFileKeys:
    """Keys of a prop's own file beside its bodies.

    Attributes:
        name, title: of the prop
    """

    name: str = field(default="", metadata=key())
    title: str = field(default="", metadata=key())


@dataclass(frozen=True)
class PropKeys:
    """Keys of a prop beside its placement and its shapes.

    Attributes:
        name: of the prop
        kind: of the prop
        movable: whether it is an object, which starts at its placement; default: a thread is
        description: instead of shapes: a file with bodies, or a registered name
        before_step: of a movable prop: a Python file beside this one, whose `before_step` runs
            before each step
    """

    name: str = field(metadata=key())
    kind: Literal["shapes", "needle", "tissue", "thread"] = field(default="shapes", metadata=key())
    movable: bool | None = field(default=None, metadata=key(see="simulation.md#objects"))
    description: str | None = field(default=None, metadata=key(of=("shapes",), see="import.md"))
    before_step: str = field(default="", metadata=key(see="simulation.md#scripts-of-objects"))


def _read_prop(row: Table, before: Sequence[Prop]) -> Prop:
    """Read a prop: needle, tissue, thread, shapes in the rig's file, or bodies in its own."""
    at, keys = read_pose(row), row.record(PropKeys, row.text("kind", "shapes"))
    needle = read_needle(row) if keys.kind == "needle" else None
    tissue = read_tissue(row, _needles(before)) if keys.kind == "tissue" else None
    thread = read_thread(row) if keys.kind == "thread" else None
    moves = thread is not None if keys.movable is None else keys.movable
    if moves and tissue is not None:
        raise row.fail("movable", "got true; allowed: false, for tissue stands where it is put")
    if not moves and thread is not None:
        raise row.fail("movable", "got false; allowed: true, for nothing else moves a thread")
    if not moves:
        for name, given in (
            ("mass", row.has("mass", "mass")),
            ("inertia_kgm2", "inertia_kgm2" in row),
            ("joint", "joint" in row),
            ("before_step", "before_step" in row),
        ):
            if given:
                raise row.fail("movable", f"is missing; a prop that stands still has no {name}")
    movable: Movable | None = None
    if needle is not None:
        shapes = needle_shapes(needle, row.record(NeedleLook).material)
        if moves:
            own = row.record(MassKeys)
            mass = needle.mass if own.mass is None else read_mass(row, own)
            movable = Movable(mass, *read_inertia(row, own, None, shapes, mass))
    elif thread is not None:
        shapes = (link_shape(thread),)
        size = np.array([0.5 * thread.diameter, 0.5 * thread.length, 0.0])
        pose = transform(shapes[0].pose[:3, :3], np.array([0.5 * thread.length, 0.0, 0.0]))
        whole = replace(shapes[0], kind="cylinder", size=size, pose=pose)
        movable = Movable(thread.mass, *mass_properties([whole], thread.mass), "shape")
    elif keys.description is not None:
        bodies = _read_bodies(row, keys.description)
        shapes = tuple(shape for body in bodies for shape in body.shapes)
        if moves:
            movable = _from_bodies(row, bodies)
    else:
        solid, touches = read_drawn(row, row.record(DrawnKeys))
        drawn = () if solid is None else seen_and_touched(solid, touches)
        shapes = (*drawn, *read_shapes(row))
        if moves:
            own = row.record(MassKeys)
            mass = read_mass(row, own, shapes)
            movable = Movable(mass, *read_inertia(row, own, solid, shapes, mass))
        elif any(shape.density is not None for shape in shapes):
            raise row.fail("movable", "is missing; a prop that stands still has no density")
    names = [prop.name for prop in before]
    joint = _read_joint(row.table("joint"), names) if "joint" in row else None
    row.raw("joint")
    if thread is not None and joint is not None:
        at = _tied(row, joint, at, before)
    if moves:
        _check_touchable(row, shapes, free=joint is None)
    script = read_script(row, "before_step")
    return Prop(keys.name, at, shapes, movable, joint, script, needle, tissue, thread)


def _needles(props: Iterable[Prop]) -> dict[str, Needle]:
    """Return the needles that may pass tissue, {prop: needle}."""
    return {p.name: p.needle for p in props if p.needle and p.movable and not p.joint}


def _tied(row: Table, joint: PropJoint, at: Array, before: Sequence[Prop]) -> Array:
    """Return the pose of the beginning of a thread that is tied to a free prop.

    It is the end of a needle where the row gives no position.
    """
    free = {prop.name: prop for prop in before if prop.movable and not prop.joint}
    if joint.kind != "ball" or joint.on not in free:
        raise row.fail(
            "joint",
            f"got a {joint.kind} on {joint.on or 'the world'}; allowed for a thread: a ball on a"
            f" free prop ({', '.join(free) or 'none'})",
        )
    carrier = free[joint.on]
    if carrier.needle is None or row.has("xyz", "length"):
        return at
    swage = carrier.pose @ carrier.needle.swage
    swage[:3, :3] = swage[:3, :3] @ [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    return swage


def _read_joint(row: Table, before: Sequence[str]) -> PropJoint:
    """Return the joint of a prop on the world or on a prop before it."""
    kind = cast(PropJointKind, row.text("kind", allowed=KINDS))
    on = row.text("on", "world")
    row.known("on", on, ("world", *before), "no prop before this one")
    joint = row.record(
        PropJoint, kind, turns=kind != "slide", kind=kind, on="" if on == "world" else on
    )
    if np.isfinite([joint.lower, joint.upper]).any():
        measure = "length" if kind == "slide" else "angle"
        lower, upper = row.quantity("lower", measure), row.quantity("upper", measure)
        if not lower <= 0.0 <= upper or lower == upper:
            raise row.fail(
                "lower", f"got {lower:g} to {upper:g}; allowed: a range around 0, its placement"
            )
    row.done()
    return joint


def read_bands(rig: Table, props: Sequence[Prop]) -> tuple[Band, ...]:
    """Return a rig's elastic bands.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    still = {prop.name for prop in props if prop.movable is None}

    def read(row: Table) -> Band:
        points = row.each("point", lambda end: _read_end(end, props))
        if len(points) < 2:
            raise row.fail("point", f"got {len(points)}; allowed: two points of props, or more")
        if {prop for prop, _ in points} <= still:
            raise row.fail("point", "got points of props that stand still; allowed: a movable one")
        return row.record(Band, points=points)

    return rig.each("band", read, again="name")


def _read_end(row: Table, props: Sequence[Prop]) -> tuple[str, Array]:
    end = row.record(BandPoint)
    row.known("prop", end.prop, [prop.name for prop in props])
    return end.prop, end.xyz


def read_script(row: Table, key: str) -> str:
    """Return the path of the Python file that a table names beside its own, "" for none.

    Raises:
        DescriptionError: there is no such file
    """
    name = row.text(key, "")
    if not name:
        return ""
    path = (Path(row.file).parent / name).resolve()
    if not is_file(path):
        raise row.fail(key, f"got {name!r}; allowed: a Python file, and there is no {path}")
    return str(path)


def _check_object_name(row: Table, name: str, arms: Iterable[str]) -> None:
    """Reject the name of a movable prop that commands and topics could not distinguish."""
    if not OBJECT_NAME.fullmatch(name):
        raise row.fail(
            "name",
            f"got {name!r}; allowed for a movable prop: a letter, then letters, digits and _",
        )
    if name in (*arms, *RESERVED):
        raise row.fail("name", f"got {name!r}, which is an arm or the world itself")


def _read_bodies(row: Table, name: str) -> tuple[Body, ...]:
    """Return the bodies of a prop's own file: a path beside the rig, or a registered name."""
    if name.endswith(".toml"):
        table = read_table(Path(row.file).parent / name)
    else:
        table = read_table(registered_file("props", name, row.fail("description", "")))
    table.check_schema()
    table.record(PropFileKeys)
    bodies = table.each("body", lambda body: read_body(body, table.file))
    if not bodies:
        raise table.fail("body", "is missing; a prop needs at least one body")
    table.done()
    return bodies


def _from_bodies(row: Table, bodies: Sequence[Body]) -> Movable:
    """Return the mass properties of bodies as one, scaled to the mass that the rig may give."""
    mass, com, inertia = merged(bodies)
    total = read_mass(row, MassKeys()) if row.has("mass", "mass") else mass
    return Movable(total, com, inertia * total / mass, bodies[0].inertia_from)


def _check_touchable(row: Table, shapes: tuple[Shape, ...], *, free: bool) -> None:
    """Reject an object that would fall through everything, or whose hull has no volume."""
    touching = [shape for shape in shapes if shape.collide]
    if free and not touching:
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
    """Return whether points lie in one plane, relative to their extent."""
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    return len(spread) < 3 or bool(spread[2] <= FLAT * spread[0])
