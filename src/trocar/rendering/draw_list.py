"""What of the scenery is drawn, from where, in which light: everything but the drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.rendering.buffers import Scenery
from trocar.rendering.culling import (
    SHADOW_TOLERANCE_PX,
    Boxes,
    boxes,
    chosen_levels,
    commands,
    inside,
    placed,
)
from trocar.rendering.lighting import Light, room_light
from trocar.rendering.optics import Optics
from trocar.simulation.records import Snapshot

Array = NDArray[np.float64]
Commands = NDArray[np.uint32]

#: Behind everything: in a patient, and in a room. Source: chosen by eye.
DARK, WALL = (0.0, 0.0, 0.0), (0.80, 0.83, 0.86)
#: Objects that are larger than this are floors, which throw no shadow [m]. Source: our own choice.
FLOOR = 2.5
#: A scope's light: of what stands still, objects larger than this throw none. What they hide from
#: the light they hide from the eyes beside it, too, but for a rim. Source: our own choice. [m]
LARGE = 0.25


@dataclass(frozen=True, eq=False)
class Stage:
    """What is drawn at one go.

    Attributes:
        rows: T_reference_object of every object, (m, 3, 4)
        seen: commands of what the eyes see, kind by kind, nearest first
        kinds: [(kind, its first command, how many)]: which of `scenery.KINDS`; one, 0, where all
            surfaces are drawn alike
        shading: commands of what throws shadows; empty without shadows
        light: in the reference frame
        backdrop: colour behind everything, 0 to 1
    """

    rows: Array
    seen: Commands
    kinds: list[tuple[int, int, int]]
    shading: Commands
    light: Light
    backdrop: tuple[float, float, float]


def stage(
    things: Scenery,
    snapshot: Snapshot,
    T_reference_world: Array,
    lenses: Optics,
    shadows: bool,
    only: NDArray[np.bool_] | None = None,
    alike: bool = True,
) -> Stage:
    """Return what a camera sees of a snapshot.

    Args:
        things: everything there is
        snapshot: where it is
        T_reference_world: where the camera is, (4, 4)
        lenses: the camera's
        shadows: whether light throws them
        only: which objects are there, (m,); all when omitted
        alike: whether one program draws all surfaces
    """
    rows = placed(things, snapshot, T_reference_world)
    around = boxes(things, rows)
    frusta = [eye.frustum for eye in lenses.eyes]
    nearest, farthest = around.depths(frusta[0].T_eye_reference)
    light = lenses.light or _room_light(things, around, T_reference_world)
    *seeing, lit = inside([*frusta, light.frustum], around)
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
    level = chosen_levels(things, frusta[0], seen, nearest[seen])
    throws = np.zeros_like(in_sight)
    if shadows:
        throws = lit & (things.radii < FLOOR)
        if light.scope:
            throws &= things.of_arms | (things.radii < LARGE)
        if only is not None:
            throws &= only
    who = np.flatnonzero(throws)
    simple = chosen_levels(things, frusta[0], who, nearest[who], SHADOW_TOLERANCE_PX)
    return Stage(
        rows=rows,
        seen=commands(things, seen, level),
        kinds=kinds,
        shading=commands(things, who, simple),
        light=light,
        backdrop=DARK if light.scope else WALL,
    )


def _room_light(things: Scenery, around: Boxes, T_reference_world: Array) -> Light:
    """Return a lamp over everything that is no floor."""
    small = things.radii < FLOOR
    if not small.any():
        return room_light(T_reference_world, np.zeros(3), 1.0)
    world = (around.middles[small] - T_reference_world[:3, 3]) @ T_reference_world[:3, :3]
    reach = things.radii[small][:, None]
    low, high = (world - reach).min(axis=0), (world + reach).max(axis=0)
    return room_light(
        T_reference_world, 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    )
