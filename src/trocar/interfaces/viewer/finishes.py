"""What the surfaces look like."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trocar.interfaces.viewer.glb import Finish

if TYPE_CHECKING:
    from trocar.simulation.records import ShapeRecord


def finish(shape: ShapeRecord) -> Finish:
    """Say how a shape answers to light; what the descriptions call gloss is smoothness."""
    return Finish(rgba=shape.rgba, metallic=shape.metal, roughness=1.0 - shape.gloss)
