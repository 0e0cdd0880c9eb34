"""Holding surfaces of a jaw: the faces of its fingers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription, Shape
from trocar.errors import InputError
from trocar.kinematics.forward import pose

Array = NDArray[np.float64]


class Pads(NamedTuple):
    """The faces of a jaw's fingers when it is shut.

    Attributes:
        T_tip: pose of their middle in the tip's frame, (4, 4): z to their ends, y the normal of the
            left one, x across; the tip's frame is at the jaw's axis
        length: along z [m]
        width: along x [m]
    """

    T_tip: Array
    length: float
    width: float


def pads(arm: ArmDescription) -> Pads:
    """Return the holding surfaces of an arm's jaw, from the colliding shapes of its left finger.

    Raises:
        InputError: the arm has no jaw
    """
    if not arm.fingers:
        raise InputError(f"{arm.name}: has no jaw; allowed: an arm with a tool that has one")
    finger = arm.fingers[0]
    shut = np.zeros(len(arm.joints))
    to_tip = pose(arm.mechanism, shut, finger, arm.mechanism.tip)
    shapes = [s for body in arm.bodies if body.frame == finger for s in body.shapes if s.collide]
    spans = np.array([_span(shape, to_tip @ shape.pose) for shape in shapes])
    low, high = spans[:, 0].min(axis=0), spans[:, 1].max(axis=0)
    at = np.eye(4)
    at[[0, 2], 3] = 0.5 * (low + high)[[0, 2]]
    return Pads(at, float(high[2] - low[2]), float(high[0] - low[0]))


def _span(shape: Shape, place: Array) -> tuple[Array, Array]:
    """Return the least and the most of a shape along the axes that its pose is in, (3,) each."""
    turn, at = place[:3, :3], place[:3, 3]
    if shape.mesh is not None:
        points = shape.mesh.vertices @ turn.T + at
        return points.min(axis=0), points.max(axis=0)
    if shape.kind == "box":
        half = np.abs(turn) @ shape.size
    else:
        radius, length = shape.size[0], 0.0 if shape.kind == "sphere" else shape.size[1]
        half = np.abs(turn[:, 2]) * length + radius
    return at - half, at + half
