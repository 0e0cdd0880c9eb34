"""The shapes of a rig as arrays for the graphics card: triangles, finishes, ids, levels."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from trocar.errors import UnknownNameError
from trocar.rendering.primitives import (
    CELLS,
    TriangleSurface,
    drawn_surface,
    joined,
    levels,
    surface,
)
from trocar.simulation.records import Drawing, DrawnSurface, ShapeRecord

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Error of a level that an object does not have: too coarse to be chosen.
NEVER = np.inf
#: Kinds of surfaces with a program of their own in the surgical style, and the metallic ratio from
#: which a surface is metal; the others are named by their materials. Source: our own choice.
KINDS, METAL = ("", "tissue", "metal", "gauze"), 0.5
TEXTURED = {"tissue": "tissue", "membrane": "tissue", "gauze": "gauze"}
#: Columns of a `Scenery`, one row for each object.
EACH = ("bodies", "centres", "halves", "first", "count", "errors",
        "colours", "gloss", "kinds", "ids", "of_arms")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scenery:
    """All surfaces of a world. An object is the part of one body that has one material.

    Attributes:
        points: (n, 3) float32 [m], in the frame of each object's body
        normals: (n, 3) float32
        places: points before they bent, (n, 3) float32 [m]
        indices: (k,) uint32
        bodies: index of each object's body (m,)
        centres, halves: a box about each object in its body's frame: its middle and half of its
            edges, (m, 3), (m, 3) [m]
        first, count: each level's part of the indices, the whole surface first, (m, levels)
        errors: largest error of each level, (m, levels) [m]
        colours: linear red, green, blue and metallic ratio, (m, 4) float32
        gloss: (m,), 0 to 1
        kinds: which of KINDS each surface is, (m,)
        ids: of each object, (m,), from 1; objects of one body have one id
        of_arms: which objects are an arm's, and no prop's, (m,)
        names: {id: name}: "PSM1/wrist_yaw", "table"
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    places: NDArray[np.float32]
    indices: NDArray[np.uint32]
    bodies: Ints
    centres: Array
    halves: Array
    first: Ints
    count: Ints
    errors: Array
    colours: NDArray[np.float32]
    gloss: Array
    kinds: Ints
    ids: Ints
    of_arms: NDArray[np.bool_]
    names: Mapping[int, str]

    @cached_property
    def radii(self) -> Array:
        """From each box's middle to its corners, (m,) [m]."""
        return np.linalg.norm(self.halves, axis=1)

    def numbers(self, names: Collection[str]) -> list[int]:
        """Return the ids of names.

        Raises:
            UnknownNameError: no such object; the known ones are listed
        """
        if not names:
            return []
        known = {name: number for number, name in self.names.items()}
        for name in names:
            if name not in known:
                raise UnknownNameError("object", name, known)
        return [known[name] for name in names]

    def with_(self, other: Scenery) -> Scenery:
        """Return the objects of both; triangles of the other one are elsewhere."""
        both = {key: np.concatenate([getattr(self, key), getattr(other, key)]) for key in EACH}
        return replace(self, **both, names={**self.names, **other.names})


def _look(shape: ShapeRecord) -> tuple[object, ...]:
    return shape.body, shape.rgba, shape.gloss, shape.metal, shape.material


def scenery(shapes: Sequence[ShapeRecord]) -> Scenery:
    """Build the scenery of shapes.

    Raises:
        InputError: an unknown kind of shape
    """
    ordered = sorted(shapes, key=_look)
    groups = [list(group) for _, group in groupby(ordered, key=_look)]
    surfaces = [levels(joined([surface(shape) for shape in group])) for group in groups]
    number = {body: k + 1 for k, body in enumerate(sorted({s.body for s in shapes}))}
    first = [group[0] for group in groups]
    return _packed(
        surfaces,
        first,
        np.array([shape.body for shape in first], dtype=np.int64),
        np.array([number[shape.body] for shape in first], dtype=np.int64),
        {number[shape.body]: owner(shape) for shape in shapes},
    )


def drawn_scenery(drawings: Sequence[Drawing], after: Scenery) -> Scenery:
    """Build drawings as objects of the world's body, whose triangles follow those of a scenery.

    Raises:
        InputError: a drawing whose arrays have a wrong shape
    """
    surfaces = [[(0.0, drawn_surface(drawing))] for drawing in drawings]
    ids = np.arange(len(drawings)) + len(after.names) + 1
    names = {int(k): drawing.name for k, drawing in zip(ids, drawings, strict=True)}
    body = np.zeros(len(drawings), dtype=np.int64)
    found = _packed(surfaces, drawings, body, ids, names)
    rest = [drawing.rest if isinstance(drawing, DrawnSurface) else None for drawing in drawings]
    rests = [s[0][1].points if r is None else r for s, r in zip(surfaces, rest, strict=True)]
    return replace(
        found,
        places=np.concatenate(rests).astype(np.float32),
        indices=found.indices + np.uint32(len(after.points)),
        first=found.first + len(after.indices),
    )


def owner(shape: ShapeRecord) -> str:
    """Return the name of a shape's owner: "PSM1/wrist_yaw" of an arm, else the prop's name."""
    return f"{shape.arm}/{shape.frame}" if shape.arm else shape.name.rpartition("/")[0]


def linear(rgb: Sequence[float]) -> Array:
    """Return a screen's colour as linear light. Source: IEC 61966-2-1 (sRGB)."""
    c = np.asarray(rgb, dtype=np.float64)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def _packed(
    surfaces: list[list[tuple[float, TriangleSurface]]],
    looks: Sequence[ShapeRecord | Drawing],
    bodies: Ints,
    ids: Ints,
    names: Mapping[int, str],
) -> Scenery:
    """Pack objects, all levels of all of them behind each other."""
    ends = [(found[0][1].points.min(axis=0), found[0][1].points.max(axis=0)) for found in surfaces]
    low, high = np.array(ends, dtype=np.float64).reshape(-1, 2, 3).swapaxes(0, 1)
    most = len(CELLS) + 1
    first = np.zeros((len(surfaces), most), dtype=np.int64)
    count = np.zeros((len(surfaces), most), dtype=np.int64)
    errors = np.full((len(surfaces), most), NEVER)
    points: list[Array] = [np.zeros((0, 3))]
    normals: list[Array] = [np.zeros((0, 3))]
    indices: list[Ints] = [np.zeros(0, dtype=np.int64)]
    vertex = place = 0
    for row, found in enumerate(surfaces):
        for level, (error, part) in enumerate(found):
            points.append(part.points)
            normals.append(part.normals)
            indices.append(part.faces.reshape(-1) + vertex)
            first[row, level], count[row, level] = place, part.faces.size
            errors[row, level] = error
            vertex, place = vertex + len(part.points), place + part.faces.size
    colours = [[*linear(look.rgba[:3]), look.metal] for look in looks]
    material = [getattr(look, "material", "") for look in looks]
    kinds = [KINDS.index(TEXTURED[name]) if name in TEXTURED else
             KINDS.index("metal") if look.metal >= METAL else 0
             for name, look in zip(material, looks, strict=True)]  # fmt: skip
    packed = np.concatenate(points).astype(np.float32)
    return Scenery(
        points=packed,
        normals=np.concatenate(normals).astype(np.float32),
        places=packed,
        indices=np.concatenate(indices).astype(np.uint32),
        bodies=bodies,
        centres=0.5 * (low + high),
        halves=0.5 * (high - low),
        first=first,
        count=count,
        errors=errors,
        colours=np.array(colours, dtype=np.float32).reshape(-1, 4),
        gloss=np.array([look.gloss for look in looks], dtype=np.float64),
        kinds=np.array(kinds, dtype=np.int64),
        ids=ids,
        of_arms=np.array(
            [getattr(look, "arm", None) is not None for look in looks], dtype=np.bool_
        ),
        names=names,
    )
