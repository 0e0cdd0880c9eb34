"""What a camera can see of the scenery, and in how much detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.rendering.buffers import Scenery
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

    @cached_property
    def planes(self) -> tuple[Array, Array]:
        """Its sides and its end at the eye: directions inwards (3, 5), least products (5,)."""
        sides = np.array(
            [
                [1.0, 0.0, -self.left],
                [-1.0, 0.0, self.right],
                [0.0, 1.0, -self.top],
                [0.0, -1.0, self.bottom],
                [0.0, 0.0, 1.0],
            ]
        )
        T = self.T_eye_reference
        least = -sides @ T[:3, 3] + [0.0, 0.0, 0.0, 0.0, self.near]
        return (sides @ T[:3, :3]).T, least


def placed(scenery: Scenery, snapshot: Snapshot, T_reference_world: Array) -> Array:
    """Return T_reference_object of every object as (m, 3, 4)."""
    turns = matrix_from_quaternion(snapshot.quaternions[scenery.bodies])
    found = np.empty((len(scenery.bodies), 3, 4))
    found[:, :, :3] = T_reference_world[:3, :3] @ turns
    shift = T_reference_world[:3, 3]
    found[:, :, 3] = snapshot.positions[scenery.bodies] @ T_reference_world[:3, :3].T + shift
    return found


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes about objects, in the reference frame: middles (m, 3), half edges (m, 3, 3) [m]."""

    middles: Array
    edges: Array

    def depths(self, T_eye_reference: Array) -> tuple[Array, Array]:
        """Return the least and the greatest depth of each ahead of an eye, (m,), (m,) [m]."""
        z = T_eye_reference[2, :3]
        reach = np.abs(self.edges @ z).sum(axis=1)
        middle = self.middles @ z + T_eye_reference[2, 3]
        return middle - reach, middle + reach


def boxes(scenery: Scenery, poses: Array) -> Boxes:
    """Return the boxes where the objects' poses (m, 3, 4) have them."""
    turns = poses[:, :, :3]
    middles = (turns @ scenery.centres[:, :, None])[:, :, 0] + poses[:, :, 3]
    return Boxes(middles, np.swapaxes(turns, 1, 2) * scenery.halves[:, :, None])


def inside(frusta: Sequence[Frustum], around: Boxes) -> NDArray[np.bool_]:
    """Return which boxes reach into pyramids, (k, m); a few that do not are taken as well."""
    inwards = np.concatenate([frustum.planes[0] for frustum in frusta], axis=1)
    least = np.concatenate([frustum.planes[1] for frustum in frusta])
    reach = np.abs(around.edges @ inwards).sum(axis=1)
    beyond = around.middles @ inwards + reach > least
    return beyond.reshape(len(beyond), len(frusta), 5).all(axis=2).T


def chosen_levels(
    scenery: Scenery,
    frustum: Frustum,
    seen: Ints,
    nearest: Array,
    tolerance: float = TOLERANCE_PX,
) -> Ints:
    """Return how coarse each seen object may be, (k,): its level, 0 the whole surface.

    Args:
        scenery, frustum, seen: what is looked at, from where, which objects (k,)
        nearest: least depth of each of these, (k,) [m]
        tolerance: by how much a surface may be off [px]
    """
    off = scenery.errors[seen] * (frustum.pixels / np.maximum(nearest, frustum.near))[:, None]
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
