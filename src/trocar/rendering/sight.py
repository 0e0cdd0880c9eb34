"""What a camera can see of the scenery, and in how much detail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.rendering.scenery import Scenery
from trocar.simulation.records import Snapshot

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: A simpler surface may be off by this much of a pixel. Source: our own choice; silhouettes then
#: differ in edge pixels only.
TOLERANCE_PX = 0.5
#: ... and what throws a shadow by this much. Source: our own choice: shadows are soft by a pixel.
SHADOW_TOLERANCE_PX = 1.5
#: Simpler surfaces yet are taken while a view has more triangles than this. Source: the project's
#: own goal.
MOST_TRIANGLES = 20_000
#: ... until they are off by this many pixels. Source: our own choice.
MOST_TOLERANCE_PX = 4.0


@dataclass(frozen=True, eq=False)
class Frustum:
    """A pyramid ahead of an eye or a light.

    Attributes:
        T_eye_reference: from the reference frame, in which objects are placed (4, 4)
        left, right, top, bottom: its edges in the plane z = 1
        near: nothing is seen before this [m]
        pixels: pixels that a length of 1 covers at distance 1
    """

    T_eye_reference: Array
    left: float
    right: float
    top: float
    bottom: float
    near: float
    pixels: float


def placed(scenery: Scenery, snapshot: Snapshot, T_reference_world: Array) -> Array:
    """Return T_reference_object of every object as (m, 3, 4)."""
    turns = matrix_from_quaternion(snapshot.quaternions[scenery.bodies])
    found = np.empty((len(scenery.bodies), 3, 4))
    found[:, :, :3] = T_reference_world[:3, :3] @ turns
    shift = T_reference_world[:3, 3]
    found[:, :, 3] = snapshot.positions[scenery.bodies] @ T_reference_world[:3, :3].T + shift
    return found


def middles(scenery: Scenery, poses: Array) -> Array:
    """Return the middles of the objects' spheres where their poses (m, 3, 4) have them, (m, 3)."""
    return (poses[:, :, :3] @ scenery.centres[:, :, None])[:, :, 0] + poses[:, :, 3]


def inside(frustum: Frustum, centres: Array, radii: Array) -> NDArray[np.bool_]:
    """Return which spheres reach into a pyramid, (m,); a few that do not are taken as well."""
    T = frustum.T_eye_reference
    x, y, z = (centres @ T[:3, :3].T + T[:3, 3]).T
    sides = (
        (x - frustum.left * z, frustum.left),
        (frustum.right * z - x, frustum.right),
        (y - frustum.top * z, frustum.top),
        (frustum.bottom * z - y, frustum.bottom),
    )
    seen = z + radii > frustum.near
    for depth, slope in sides:
        seen &= depth > -radii * np.hypot(1.0, slope)
    return seen


def chosen_levels(
    scenery: Scenery,
    frustum: Frustum,
    seen: Ints,
    centres: Array,
    tolerance: float = TOLERANCE_PX,
) -> Ints:
    """Return how coarse each seen object may be, (k,): its level, 0 the whole surface.

    Args:
        scenery, frustum, seen: what is looked at, from where, which objects (k,)
        centres: middles of all objects in the reference frame, (m, 3)
        tolerance: by how much a surface may be off [px]
    """
    T = frustum.T_eye_reference
    z = (centres[seen] @ T[:3, :3].T + T[:3, 3])[:, 2]
    nearest = np.maximum(z - scenery.radii[seen], frustum.near)
    off = scenery.errors[seen] * (frustum.pixels / nearest)[:, None]
    while True:
        level = (off <= tolerance).sum(axis=1) - 1
        triangles = scenery.count[seen, level].sum() // 3
        if triangles <= MOST_TRIANGLES or tolerance >= MOST_TOLERANCE_PX:
            return level
        tolerance *= 2.0


def commands(scenery: Scenery, seen: Ints, level: Ints) -> NDArray[np.uint32]:
    """Return one drawing command an object, (k, 5). Source: OpenGL 4.3, 10.5, indirect drawing."""
    found = np.zeros((len(seen), 5), dtype=np.uint32)
    found[:, 0] = scenery.count[seen, level]
    found[:, 1] = 1
    found[:, 2] = scenery.first[seen, level]
    found[:, 4] = seen
    return found
