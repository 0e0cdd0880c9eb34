"""The shapes of a rig and the bodies that carry them, for whoever draws."""

from __future__ import annotations

import mujoco

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.records import RigDescription, Shape
from trocar.modeling import naming
from trocar.simulation.bands import band_shapes
from trocar.simulation.records import ShapeRecord


def shape_records(rig: RigDescription, model: mujoco.MjModel) -> tuple[ShapeRecord, ...]:
    """Return every visible shape of a rig, props first, with the id of the body that carries it.

    Bands come last; their rods have ids after those of the model's bodies.
    """
    found: list[ShapeRecord] = []
    for prop in rig.props:
        body = model.body(prop.name).id
        for number, shape in enumerate(s for s in prop.shapes if s.visible):
            found.append(_record(shape, body, f"{prop.name}/{number}", None, ""))
    for arm in rig.arms:
        for part in arm.arm.bodies:
            body = model.body(naming.scoped(arm.name, part.frame)).id
            for number, shape in enumerate(s for s in part.shapes if s.visible):
                name = f"{arm.name}/{part.frame}/{part.part}/{number}"
                found.append(_record(shape, body, name, arm.name, part.frame))
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
