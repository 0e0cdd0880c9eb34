"""Volume, centre and inertia of solids, from their surfaces as drawn and not from triangles."""

# pyright: reportAttributeAccessIssue=false
# OCP's type stubs name none of its classes.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from build123d.topology import Shape
from numpy.typing import NDArray
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Weight:
    """Of uniform solids together.

    Attributes:
        volume: [mm^3]
        com: centre, (3,) [mm]
        gyration: inertia about the centre of 1 kg, (3, 3) [mm^2]
    """

    volume: float
    com: Array
    gyration: Array


def weigh(solids: Sequence[Shape]) -> Weight:
    """Return the mass properties of solids of one density; where two overlap, both count."""
    each = [_one(solid) for solid in solids]
    volumes = np.array([one.volume for one in each])
    com = volumes @ np.stack([one.com for one in each]) / volumes.sum()
    total = np.zeros((3, 3))
    for one in each:
        away = one.com - com
        total += one.volume * (one.gyration + away @ away * np.eye(3) - np.outer(away, away))
    return Weight(float(volumes.sum()), com, total / volumes.sum())


def _one(solid: Shape) -> Weight:
    found = GProp_GProps()
    BRepGProp.VolumeProperties_s(solid.wrapped, found)
    inertia = found.MatrixOfInertia()
    about = [[inertia.Value(i, j) for j in (1, 2, 3)] for i in (1, 2, 3)]
    volume = found.Mass()
    return Weight(volume, np.array(found.CentreOfMass().Coord()), np.array(about) / volume)
