"""The draw list of a picture: objects in view, their levels of detail, shadows and light.

snapshot -> `placed` (poses and boxes before the camera) -> `draw_list` (commands for the GPU)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.rendering.buffers import Scenery
from trocar.rendering.frustum import Frustum
from trocar.rendering.lighting import Light, room_light
from trocar.rendering.optics import Optics
from trocar.simulation.records import Snapshot

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Commands = NDArray[np.uint32]

#: Background colour in a patient, and in a room. Source: chosen by eye.
DARK, WALL = (0.0, 0.0, 0.0), (0.80, 0.83, 0.86)
#: Smallest radius of floors, which throw no shadow [m]. Source: our own choice.
FLOOR = 2.5
#: Largest radius of fixed objects that throw shadows in a scope's light [m]. Source: our own
#: choice; larger ones hide from the eyes beside the light nearly all that they hide from it.
LARGE = 0.25
#: Error of a simplified surface [px]. Source: our own choice; silhouettes then differ in edge
#: pixels only.
TOLERANCE_PX = 0.5
#: Error of a simplified surface that throws a shadow [px]. Source: our own choice: shadows are soft
#: by a pixel.
SHADOW_TOLERANCE_PX = 1.5
#: Triangles of a view above which surfaces are simplified further. Source: the project's own goal.
MOST_TRIANGLES = 20_000
#: Error up to which they are simplified further [px]. Source: our own choice.
MOST_TOLERANCE_PX = 4.0


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes about objects, in the reference frame: middles (m, 3), half edges (m, 3, 3) [m]."""

    middles: Array
    edges: Array


@dataclass(frozen=True, eq=False)
class PlacedObjects:
    """The objects of a scenery before a camera.

    Attributes:
        things: the objects
        T_reference_world: pose of the world in the camera's frame, (4, 4)
        rows: T_reference_object of every object, (m, 3, 4)
        boxes: around them
    """

    things: Scenery
    T_reference_world: Array
    rows: Array
    boxes: Boxes


@dataclass(frozen=True, eq=False)
class DrawList:
    """Everything that one picture is drawn from.

    Attributes:
        rows: T_reference_object of every object, (m, 3, 4)
        seen: commands of what the eyes see, (k, 5), kind by kind, nearest first
        kinds: [(kind, its first command, how many)]: which of `buffers.KINDS`; one, 0, where all
            surfaces are drawn alike
        shading: commands of what throws shadows, (j, 5); empty without shadows
        light: in the reference frame
        backdrop: background colour, 0 to 1
        T_reference_world: pose of the world in the reference frame, (4, 4)
    """

    rows: Array
    seen: Commands
    kinds: list[tuple[int, int, int]]
    shading: Commands
    light: Light
    backdrop: tuple[float, float, float]
    T_reference_world: Array


def placed(things: Scenery, snapshot: Snapshot, T_reference_world: Array) -> PlacedObjects:
    """Place objects where a snapshot has their bodies, in a camera's frame.

    Args:
        things: the objects
        snapshot: of the world
        T_reference_world: pose of the world in the camera's frame, (4, 4)
    """
    R = T_reference_world[:3, :3]
    rows = np.empty((len(things.bodies), 3, 4))
    rows[:, :, :3] = R @ matrix_from_quaternion(snapshot.quaternions[things.bodies])
    rows[:, :, 3] = snapshot.positions[things.bodies] @ R.T + T_reference_world[:3, 3]
    middles = (rows[:, :, :3] @ things.centres[:, :, None])[:, :, 0] + rows[:, :, 3]
    edges = np.swapaxes(rows[:, :, :3], 1, 2) * things.halves[:, :, None]
    return PlacedObjects(things, T_reference_world, rows, Boxes(middles, edges))


def draw_list(
    objects: PlacedObjects,
    lenses: Optics,
    shadows: bool,
    only: NDArray[np.bool_] | None = None,
    alike: bool = True,
) -> DrawList:
    """Select the objects that a camera sees, and their levels of detail.

    Args:
        objects: before the camera
        lenses: the camera's
        shadows: whether light throws them
        only: which objects are there, (m,); all when omitted
        alike: whether one program draws all surfaces
    """
    things, boxes = objects.things, objects.boxes
    frusta = [eye.frustum for eye in lenses.eyes]
    z, ahead = frusta[0].T_eye_reference[2, :3], frusta[0].T_eye_reference[2, 3]
    reach, middle = np.abs(boxes.edges @ z).sum(axis=1), boxes.middles @ z + ahead
    nearest, farthest = middle - reach, middle + reach
    light = lenses.light or _room_light(objects)
    *seeing, lit = inside([*frusta, light.frustum], boxes)
    in_sight = np.logical_or.reduce(seeing)
    if only is not None:
        in_sight &= only
    seen = np.flatnonzero(in_sight)
    seen = seen[np.argsort(farthest[seen], kind="stable")]
    kinds = [(0, 0, len(seen))]
    if lenses.light is not None and not alike:
        seen = seen[np.argsort(things.kinds[seen], kind="stable")]
        present, first, count = np.unique(things.kinds[seen], return_index=True, return_counts=True)
        kinds = list(zip(present.tolist(), first.tolist(), count.tolist(), strict=True))
    throws = np.zeros_like(in_sight)
    if shadows:
        throws = lit & (things.radii < FLOOR)
        if light.scope:
            throws &= things.of_arms | (things.radii < LARGE)
        if only is not None:
            throws &= only
    who = np.flatnonzero(throws)
    level = chosen_levels(things, frusta[0], seen, nearest[seen])
    simple = chosen_levels(things, frusta[0], who, nearest[who], SHADOW_TOLERANCE_PX)
    return DrawList(
        rows=objects.rows,
        seen=commands(things, seen, level),
        kinds=kinds,
        shading=commands(things, who, simple),
        light=light,
        backdrop=DARK if light.scope else WALL,
        T_reference_world=objects.T_reference_world,
    )


def inside(frusta: Sequence[Frustum], around: Boxes) -> NDArray[np.bool_]:
    """Test which boxes reach into pyramids, (k, m); a few that do not count as well."""
    planes = [frustum.planes for frustum in frusta]
    inwards = np.concatenate([directions for directions, _ in planes], axis=1)
    least = np.concatenate([products for _, products in planes])
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
    """Choose the coarsest level of detail of each seen object, (k,), 0 the whole surface.

    Args:
        scenery, frustum, seen: what is looked at, from where, which objects (k,)
        nearest: least depth of each of these, (k,) [m]
        tolerance: error of a surface [px]
    """
    off = scenery.errors[seen] * (frustum.pixels / np.maximum(nearest, frustum.near))[:, None]
    while True:
        level = (off <= tolerance).sum(axis=1) - 1
        triangles = scenery.count[seen, level].sum() // 3
        if triangles <= MOST_TRIANGLES or tolerance >= MOST_TOLERANCE_PX:
            return level
        tolerance *= 2.0


def commands(scenery: Scenery, seen: Ints, level: Ints) -> Commands:
    """Return one drawing command an object, (k, 5). Source: OpenGL 4.3, 10.5, indirect drawing."""
    found = np.zeros((len(seen), 5), dtype=np.uint32)
    found[:, 0] = scenery.count[seen, level]
    found[:, 1] = 1
    found[:, 2] = scenery.first[seen, level]
    found[:, 4] = seen
    return found


def _room_light(objects: PlacedObjects) -> Light:
    """Return a lamp over everything that is no floor."""
    T, things = objects.T_reference_world, objects.things
    small = things.radii < FLOOR
    if not small.any():
        return room_light(T, np.zeros(3), 1.0)
    world = (objects.boxes.middles[small] - T[:3, 3]) @ T[:3, :3]
    reach = things.radii[small][:, None]
    low, high = (world - reach).min(axis=0), (world + reach).max(axis=0)
    return room_light(T, 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))
