"""The shapes of a rig and the bodies that carry them, for renderers.

Elastic bands are drawn as rods that overlap, and slide along each other when a band stretches, so
that all that is drawn is rigid, whatever draws it.
"""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.records import RigDescription, Shape
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.modeling import naming
from trocar.simulation.cavity import SOFTER, cavity_shapes, covered
from trocar.simulation.records import ShapeRecord


def shape_records(rig: RigDescription, model: mujoco.MjModel) -> tuple[ShapeRecord, ...]:
    """Return every visible shape of a rig, props first, with the id of the body that carries it.

    A cavity is in place of the table and the floor below it. Bands come last; their rods have ids
    after those of the model's bodies.
    """
    found: list[ShapeRecord] = []
    hidden = covered(rig) if rig.surroundings == "cavity" else frozenset[str]()
    for prop in rig.props:
        if prop.name in hidden:
            continue
        body = model.body(prop.name).id
        for number, shape in enumerate(s for s in prop.shapes if s.visible):
            record = _record(shape, body, f"{prop.name}/{number}", None, "")
            soft = rig.surroundings == "cavity" and shape.kind == "box"
            found.append(
                SOFTER[shape.material](record) if soft and shape.material in SOFTER else record
            )
    for arm in rig.arms:
        for part in arm.arm.bodies:
            body = model.body(naming.scoped(arm.name, part.frame)).id
            for number, shape in enumerate(s for s in part.shapes if s.visible):
                name = f"{arm.name}/{part.frame}/{part.part}/{number}"
                found.append(_record(shape, body, name, arm.name, part.frame))
    if rig.surroundings == "cavity":
        found += cavity_shapes(rig, {prop.name: model.body(prop.name).id for prop in rig.props})
    return (*found, *band_shapes(rig, model.nbody))


def _record(shape: Shape, body: int, name: str, arm: str | None, frame: str) -> ShapeRecord:
    look = MATERIALS[shape.material]
    return ShapeRecord(
        body,
        name,
        shape.kind,
        shape.size,
        shape.pose,
        look.rgba,
        look.gloss,
        look.metal,
        shape.rounding,
        arm,
        frame,
        shape.collide,
        None if shape.mesh is None else (shape.mesh.vertices, shape.mesh.faces),
        None if shape.mesh is None else shape.mesh.normals,
        shape.material,
    )


Array = NDArray[np.float64]

#: Rods of each span between two points, and up to how many rest lengths they cover it. Source: our
#: own choice.
RODS, STRETCH = 16, 4.0


def band_shapes(rig: RigDescription, first: int) -> tuple[ShapeRecord, ...]:
    """Return the rods of all bands, each on a body of its own.

    Args:
        rig: the description
        first: number of the first of these bodies
    """
    found: list[ShapeRecord] = []
    for band in rig.bands:
        look = MATERIALS[band.material]
        half = 0.5 * band.rest_length * STRETCH / RODS
        for number in range(RODS * (len(band.points) - 1)):
            found.append(
                ShapeRecord(
                    first + len(found),
                    f"{band.name}/{number}",
                    "capsule",
                    np.array([band.radius, half, 0.0]),
                    np.eye(4),
                    look.rgba,
                    look.gloss,
                    look.metal,
                    0.0,
                    None,
                    "",
                    collide=False,
                )
            )
    return tuple(found)


def band_poses(
    rig: RigDescription, model: mujoco.MjModel, data: mujoco.MjData
) -> tuple[Array, Array]:
    """Return the poses of the rods: positions (n, 3) [m] and quaternions wxyz (n, 4).

    Args:
        rig: the description
        model, data: with the bodies' poses worked out
    """
    positions, quaternions = [np.zeros((0, 3))], [np.zeros((0, 4))]
    for band in rig.bands:
        names = [naming.band_site(band.name, k) for k in range(len(band.points))]
        points = data.site_xpos[[model.site(name).id for name in names]]
        rod = band.rest_length * STRETCH / RODS
        for start, end in itertools.pairwise(points):
            length = float(np.linalg.norm(end - start))
            along = (end - start) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
            ahead = min(0.5 * rod, 0.5 * length)
            reach = np.linspace(ahead, length - ahead, RODS)
            positions.append(start + reach[:, None] * along)
            across = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
            across /= np.linalg.norm(across)
            turn = np.column_stack([across, np.cross(along, across), along])
            quaternions.append(np.tile(quaternion_from_matrix(turn), (RODS, 1)))
    return np.concatenate(positions), np.concatenate(quaternions)
