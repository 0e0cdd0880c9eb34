"""The inside of a body about a scene's tissue: shapes that are drawn, and touch nothing.

A bed of tissue, whose folds cover the rims of the scene's own, rises to walls and closes above the
endoscope; bowel, liver and fat lie at its edge. All is generated, the same in every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.records import TISSUE, Prop, RigDescription
from trocar.errors import InputError
from trocar.geometry.se3 import inverse, transform_points
from trocar.simulation.records import ShapeRecord

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

NAME = "cavity"
#: The wall: its radius, the radius at which the bed begins to rise, and the height of its top [m].
#: Source: our own choice: the endoscope's tip, 0.1 m above the bed, is inside.
RADIUS_M, BED_M, TOP_M = 0.17, 0.085, 0.21
#: Width of the bed's cells, points of a ring, rings of the wall. Source: our own choice.
CELL_M, AROUND, RISING = 0.004, 64, 7
#: Waves of the bed: their mean height, height and numbers [m, 1/m]. Source: chosen by eye.
LEVEL_M, WAVE_M, WAVES = 0.0022, 0.0011, ((70.0, 40.0), (-35.0, 95.0), (120.0, -80.0))
#: A fold over a rim of the scene's tissue: how far inside it begins, its slope, its height above
#: and depth below the tissue, and how far outside it has fallen to the bed [m]. Source: our own
#: choice: smaller than what is used of any pad.
INSIDE_M, SLOPE, ABOVE_M, BELOW_M, OUTSIDE_M = 0.003, 0.4, 0.0012, 0.0015, 0.014
#: Distance around other objects within which the bed stays below this height [m].
CLEAR_M, LOW_M = 0.022, 0.0022
#: Colours of bed and wall, and of organs. Source: chosen by eye, after photographs.
BOWEL, LIVER, FAT = (0.84, 0.56, 0.50, 1.0), (0.46, 0.19, 0.16, 1.0), (0.88, 0.72, 0.44, 1.0)
#: Glossiness of all. Source: chosen by eye.
GLOSS = 0.6
#: Lobes: colour, middle, half axes [m] and the ratio of their bumps. Source: chosen by eye.
LOBES = (
    (LIVER, (-0.100, 0.040, 0.002), (0.044, 0.060, 0.034), 0.03),
    (FAT, (0.092, 0.060, 0.004), (0.034, 0.027, 0.022), 0.16),
    (FAT, (-0.090, -0.048, 0.002), (0.026, 0.030, 0.014), 0.18),
)
#: Bowel: points of its middle line and its radius [m], ratio and number of its pouches along it.
#: Source: chosen by eye.
LINE = ((-0.075, 0.086, 0.006), (-0.035, 0.060, 0.004), (0.010, 0.068, 0.005),
        (0.045, 0.058, 0.004), (0.075, 0.090, 0.006))  # fmt: skip
BOWEL_M, POUCHES, POUCH = 0.0125, 17, 0.10
#: Pads that are drawn as folded cloth: points along an edge, width of the fold down to the bed,
#: depth of the waves of their upper side and width of those of their outline [m]. Source: chosen by
#: eye; nothing rises above the pad.
WOVEN, FALL_M, SAG_M, FRAY_M = 31, 0.0022, 0.0006, 0.0011
#: Plates of a membrane: points along x and around it; growth of their width with y [1/m]; waves of
#: their outline along y: ratio and number [1/m]; height [m] and number of those of their faces.
#: Source: chosen by eye.
PLATE, GROWTH = (23, 16), 7.0
OUTLINES, FACE_M, FACE = ((0.05, 420.0, 0.4), (0.03, 1100.0, 1.7)), 0.00035, (330.0, 260.0)


def cavity_shapes(rig: RigDescription, body: dict[str, int]) -> tuple[ShapeRecord, ...]:
    """Return the shapes of a cavity about the tissue of a rig.

    They move with tissue that an episode places.

    Args:
        rig: with a prop of tissue
        body: id of the body of each prop by its name

    Raises:
        InputError: there is no such prop
    """
    tissue = _tissue(rig)
    box = _box(tissue)
    others = [_box(p) for p in rig.props if p is not tissue and p.movable is None and _low(p)]
    surfaces = [
        (MATERIALS[TISSUE].rgba, *bed(box, tuple(others))),
        *((colour, *_lobe(middle, axes, bumps)) for colour, middle, axes, bumps in LOBES),
        (BOWEL, *_bowel()),
    ]
    T_tissue_world = inverse(tissue.pose)
    found: list[ShapeRecord] = []
    for number, (colour, points, faces) in enumerate(surfaces):
        own = transform_points(T_tissue_world, points)
        found.append(
            ShapeRecord(
                body[tissue.name],
                f"{NAME}/{number}",
                "mesh",
                np.abs(own).max(axis=0),
                np.eye(4),
                colour,
                GLOSS,
                0.0,
                0.0,
                None,
                "",
                False,
                (own, faces),
                normals_of(own, faces),
                TISSUE,
            )
        )
    return tuple(found)


def top_of_tissue(rig: RigDescription) -> Array:
    """Return the middle of the upper face of a rig's tissue where it is placed, (3,) [m].

    Raises:
        InputError: there is no prop of tissue
    """
    middle, half = _box(_tissue(rig))
    return np.array([middle[0], middle[1], middle[2] + half[2]])


def as_cloth(record: ShapeRecord) -> ShapeRecord:
    """Return a box of gauze as cloth that lies on the bed: waves, round corners, uneven edges.

    Args:
        record: of the box; z of its frame points upwards
    """
    x, y, z = record.size
    line = np.linspace(-1.0, 1.0, WOVEN)
    u, v = np.meshgrid(line, line, indexing="ij")
    far = np.maximum(np.abs(u), np.abs(v))
    edge = np.clip((far - 1.0) * min(x, y) / FALL_M + 1.0, 0.0, 1.0)
    # A square whose corners are drawn in, and whose edges wave.
    drawn_in = 1.0 - 0.10 * (u * v) ** 4
    wave = np.sin(9.0 * np.arctan2(v, u) + 1.0) + 0.6 * np.sin(17.0 * np.arctan2(v, u))
    points = np.stack(
        [
            u * (x * drawn_in + FRAY_M * wave * far**4),
            v * (y * drawn_in - FRAY_M * wave * far**4),
            z
            - 0.5 * SAG_M * (1.0 - np.sin(4.0 * u + 1.5 * v) * np.cos(3.0 * v - u))
            - 2.0 * z * edge**1.5,
        ],
        axis=-1,
    ).reshape(-1, 3)
    here = (np.arange(WOVEN - 1)[:, None] * WOVEN + np.arange(WOVEN - 1)).ravel()
    right, up = here + WOVEN, here + 1
    faces = np.concatenate(
        [np.stack([here, right, right + 1], -1), np.stack([here, right + 1, up], -1)]
    )
    return replace(
        record,
        kind="mesh",
        rounding=0.0,
        triangles=(points, faces),
        normals=normals_of(points, faces),
    )


def as_membrane(record: ShapeRecord) -> ShapeRecord:
    """Return a box of membrane with rounded ends, an uneven outline and uneven faces.

    Both follow from places in the prop's frame, so plates whose frames lie at one place, hinged
    side by side, have one outline.

    Args:
        record: of a box whose z is thinnest
    """
    half = record.size
    columns, n = PLATE
    u = np.linspace(-1.0, 1.0, columns)[:, None]
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    full = np.maximum(1.0 - np.abs(u) ** 10, 1e-3) ** 0.5
    c, s = np.cos(angle), np.sin(angle)
    y = half[1] * np.sign(c) * np.abs(c) ** 0.4 * (0.6 + 0.4 * full)
    z = half[2] * np.sign(s) * np.abs(s) ** 0.5 * full
    flat = np.stack([half[0] * u + 0.0 * y, y, z], axis=-1).reshape(-1, 3)
    points = transform_points(record.pose, flat)
    side = np.sign(points[:, 0])
    wide = 1.0 + GROWTH * points[:, 1]
    for ratio, number, phase in OUTLINES:
        wide += ratio * np.sin(number * points[:, 1] + phase * side)
    rough = np.sin(FACE[0] * points[:, 0] + 1.0) * np.cos(FACE[1] * points[:, 1] + 0.5)
    points = np.column_stack([points[:, 0] * wide, points[:, 1], points[:, 2] + FACE_M * rough])
    own, faces = transform_points(inverse(record.pose), points), _rings(columns, n)
    return replace(
        record, kind="mesh", rounding=0.0, triangles=(own, faces), normals=normals_of(own, faces)
    )


#: Boxes that are drawn as something softer in a cavity, by their material.
SOFTER = {"gauze": as_cloth, "membrane": as_membrane}


def covered(rig: RigDescription) -> frozenset[str]:
    """Return the names of props that lie below the bed from edge to edge: tables, floors.

    Raises:
        InputError: there is no prop of tissue
    """
    box = _box(_tissue(rig))
    middle, top = box[0, :2], box[0, 2] + box[1, 2]
    found: list[str] = []
    for prop in rig.props:
        if prop.movable is None and prop.shapes:
            own = _box(prop)
            below = own[0, 2] + own[1, 2] < min(top, LEVEL_M)
            if below and _outside(middle, own) < -BED_M:
                found.append(prop.name)
    return frozenset(found)


def height(points: Array, box: Array, others: Sequence[Array]) -> Array:
    """Return the height of the bed at points (..., 2) in x and y [m].

    Args:
        points: where
        box: middle and half edges of the scene's tissue, (2, 3), in the world [m]
        others: the same of what else lies there
    """
    x, y = points[..., 0], points[..., 1]
    waves = [np.sin(a * x + b * y + k) for k, (a, b) in enumerate(WAVES)]
    z: Array = LEVEL_M + WAVE_M * np.sum(waves, axis=0) / len(WAVES) ** 0.5
    for other in others:
        near = _outside(points, other) < CLEAR_M
        z = np.where(near, np.minimum(z, LOW_M), z)
    out = _outside(points, box)
    top = box[0, 2] + box[1, 2]
    fold = top + np.clip(SLOPE * (out + INSIDE_M), -BELOW_M, ABOVE_M)
    away = np.clip(out / OUTSIDE_M, 0.0, 1.0)
    away = away * away * (3.0 - 2.0 * away)
    return fold + away * (z - fold)


def bed(box: Array, others: tuple[Array, ...]) -> tuple[Array, Ints]:
    """Return points (n, 3) [m] and faces (m, 3) of bed and wall, seen from inside.

    Args:
        box, others: as of `height`
    """
    flat = np.arange(1, round(BED_M / CELL_M) + 1) * CELL_M
    t = np.linspace(0.0, 1.0, RISING + 1)[1:]
    # A quarter of an ellipse from bed to wall, and one from wall to top.
    low, high = t[t <= 0.4] / 0.4, (t[t > 0.4] - 0.4) / 0.6
    foot = 0.35 * TOP_M
    r = np.concatenate([
        flat,
        BED_M + (RADIUS_M - BED_M) * np.sin(0.5 * np.pi * low),
        RADIUS_M * np.cos(0.5 * np.pi * high),
    ])  # fmt: skip
    z = np.concatenate([
        0.0 * flat,
        foot * (1.0 - np.cos(0.5 * np.pi * low)),
        foot + (TOP_M - foot) * np.sin(0.5 * np.pi * high),
    ])  # fmt: skip
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    middle = box[0, :2]
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    xy = middle + r[:, None, None] * around
    wave = np.sin(11.0 * angle + 9.0 * z[:, None] / TOP_M)
    ribs = 1.0 + 0.02 * np.sin(7.0 * angle) + 0.015 * wave
    rising = np.clip(z / foot, 0.0, 1.0)[:, None, None]
    xy = middle + (xy - middle) * (1.0 + rising * (ribs[..., None] - 1.0))
    ground = height(xy, box, others) * (1.0 - rising[..., 0])
    points = np.concatenate([xy, (ground + z[:, None])[..., None]], axis=-1)
    centre = height(middle, box, others)
    points = np.concatenate([[[*middle, float(centre)]], points.reshape(-1, 3)])
    here = np.arange(AROUND)
    after = (here + 1) % AROUND
    fan = np.stack([np.zeros(AROUND, dtype=np.int64), here + 1, after + 1], axis=-1)
    return points, np.concatenate([fan, 1 + _rings(len(r), AROUND)[:, ::-1]])


def normals_of(points: Array, faces: Ints) -> Array:
    """Return unit normals at the points of a smooth surface, (n, 3)."""
    corner = points[faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    found = np.zeros_like(points)
    for k in range(3):
        np.add.at(found, faces[:, k], across)
    length = np.linalg.norm(found, axis=1, keepdims=True)
    return found / np.where(length > 0.0, length, 1.0)


# ---------------------------------------------------------------------- inside


@lru_cache(maxsize=len(LOBES))
def _lobe(
    middle: tuple[float, float, float], axes: tuple[float, float, float], bumps: float
) -> tuple[Array, Ints]:
    """Return an ellipsoid with bumps."""
    rows, n = 11, 20
    up = np.linspace(-0.499 * np.pi, 0.499 * np.pi, rows)[:, None]
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    way = np.stack(
        [np.cos(up) * np.cos(angle), np.cos(up) * np.sin(angle), np.sin(up) + 0.0 * angle], axis=-1
    )
    a, b, c = (way[..., k] for k in range(3))
    rough = np.sin(6.0 * a + 2.0 * b) * np.cos(5.0 * b + 3.0 * c) + np.sin(9.0 * b - 7.0 * a + 1.0)
    points = np.array(middle) + way * np.array(axes) * (1.0 + 0.5 * bumps * rough)[..., None]
    return points.reshape(-1, 3), _rings(rows, n)


@lru_cache(maxsize=1)
def _bowel() -> tuple[Array, Ints]:
    """Return a tube with pouches along a bent line."""
    rows, n = 60, 10
    known = np.array(LINE)
    t = np.linspace(0.0, 1.0, len(known))
    s = np.linspace(0.0, 1.0, rows)
    # Interpolating polynomial of few points: smooth, and within millimetres of them.
    powers = np.vander(t, increasing=True)
    line = np.vander(s, len(known), increasing=True) @ np.linalg.solve(powers, known)
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross([0.0, 0.0, 1.0], along)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(along, side)
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)[:, None]
    radius = BOWEL_M * (1.0 - POUCH * np.cos(np.pi * POUCHES * s) ** 8)[:, None, None]
    ring = np.cos(angle) * side[:, None] + np.sin(angle) * up[:, None]
    return (line[:, None] + radius * ring).reshape(-1, 3), _rings(rows, n)


def _rings(rows: int, n: int) -> Ints:
    """Return faces between rows of n points that close around."""
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(n), indexing="ij")
    here, right = row * n + column, row * n + (column + 1) % n
    sides = [np.stack([here, right, right + n], -1), np.stack([here, right + n, here + n], -1)]
    return np.concatenate([side.reshape(-1, 3) for side in sides])


def _outside(points: Array, box: Array) -> Array:
    """Return the distance of points in x and y from a box, negative inside [m]."""
    past = np.abs(points - box[0, :2]) - box[1, :2]
    beyond = np.linalg.norm(np.maximum(past, 0.0), axis=-1)
    return beyond + np.minimum(past.max(axis=-1), 0.0)


def _tissue(rig: RigDescription) -> Prop:
    if rig.tissue is None:
        raise InputError(f"{rig.name}: got no tissue; allowed: with a prop of tissue")
    return rig.tissue


def _box(prop: Prop) -> Array:
    """Return middle and half edges of a prop's box in the world, (2, 3) [m]."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for shape in prop.shapes:
        T = prop.pose @ shape.pose
        reach = np.abs(T[:3, :3]) @ shape.size
        low, high = np.minimum(low, T[:3, 3] - reach), np.maximum(high, T[:3, 3] + reach)
    if prop.tissue is not None:
        soft = prop.tissue
        half = np.array([0.5 * soft.length, soft.width + 0.5 * soft.gap, 0.0])
        low[:2], high = prop.pose[:2, 3] - half[:2], prop.pose[:3, 3] + half
    return np.array([0.5 * (low + high), 0.5 * (high - low)])


def _low(prop: Prop) -> bool:
    """Return whether a prop lies on the bed, and is no table or floor."""
    middle, half = _box(prop)
    return bool(middle[2] + half[2] > 0.0 and half[:2].max() < BED_M)
