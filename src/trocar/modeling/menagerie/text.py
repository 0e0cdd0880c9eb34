"""Numbers and names as the files have them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.modeling.markup import NOISE, number

Array = NDArray[np.float64]

#: The last digit of a float tells how it was computed: 0.013 and not 0.013000000000000001.
DIGITS = 15


def exact(value: float) -> str:
    """Write a number to fifteen digits, one less than a float has; rounding noise is 0."""
    return number(0.0 if abs(value) < NOISE else value, DIGITS)


def row(values: Iterable[float]) -> str:
    """Write numbers with spaces between them, to fifteen digits."""
    return " ".join(exact(value) for value in values)


def placed(pose: Array) -> dict[str, str]:
    """Return the attributes `pos` and `quat` of a pose (4, 4), without those that say nothing."""
    said: dict[str, str] = {}
    if np.abs(pose[:3, 3]).max() >= NOISE:
        said["pos"] = row(pose[:3, 3])
    if np.abs(pose[:3, :3] - np.eye(3)).max() >= NOISE:
        said["quat"] = row(quaternion_from_matrix(pose[:3, :3]))
    return said


def prefix(rig: RigDescription, arm: str) -> str:
    """Return what stands before every name of an arm: nothing where the rig has no other."""
    return "" if len(rig.arms) == 1 else f"{arm}_"
