"""What the surfaces look like: a finish for each material of the descriptions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trocar.interfaces.viewer.glb import Finish

if TYPE_CHECKING:
    from trocar.simulation import ShapeRecord


def finish(shape: ShapeRecord) -> Finish:
    """Choose how a shape answers to light, from its colour: grey without a tint is metal."""
    red, green, blue, alpha = (float(value) for value in shape.rgba)
    tint = max(red, green, blue) - min(red, green, blue)
    metal = tint < 0.06 and 0.35 < green < 0.75
    if metal:
        return Finish((red, green, blue, alpha), metallic=0.75, roughness=0.38)
    return Finish((red, green, blue, alpha), metallic=0.0, roughness=0.55)
