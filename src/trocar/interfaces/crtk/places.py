"""Points, orientations, poses and wrenches out of messages, checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import transform
from trocar.interfaces.crtk.fields import RefusedError, number

Array = NDArray[np.float64]

#: A quaternion whose length is farther from 1 is none. Source: our own choice, as for masters.
UNIT_TOLERANCE = 1e-3


def point(message: object, path: str) -> Array:
    """Return x, y, z, (3,).

    Raises:
        RefusedError: one of them is no number
    """
    return np.array([number(message, f"{path}.{axis}") for axis in "xyz"])


def rotation(message: object, path: str) -> Array:
    """Return the matrix of a quaternion, (3, 3).

    Args:
        message: has x, y, z, w under `path`; "" for the message itself

    Raises:
        RefusedError: its length is not 1
    """
    before = f"{path}." if path else ""
    x, y, z, w = (number(message, before + axis) for axis in "xyzw")
    length = float(np.sqrt(x * x + y * y + z * z + w * w))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise RefusedError(
            "quaternion",
            f"got {path or 'a quaternion'} of length {length:.4g}; allowed: 1",
        )
    return matrix_from_quaternion(np.array([w, x, y, z]) / length)


def pose(message: object, path: str) -> Array:
    """Return a pose, (4, 4) [m].

    Raises:
        RefusedError: it is none
    """
    return transform(rotation(message, f"{path}.orientation"), point(message, f"{path}.position"))


def wrench(message: object, path: str) -> Array:
    """Return (force; torque), (6,) [N, N m].

    Raises:
        RefusedError: one of them is no number
    """
    return np.concatenate([point(message, f"{path}.force"), point(message, f"{path}.torque")])
