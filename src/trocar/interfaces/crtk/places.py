"""Points, orientations, poses and wrenches out of messages, checked."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from trocar.interfaces.crtk.fields import RefusedError, field, number

Array = NDArray[np.float64]

#: A quaternion whose length is farther from 1 is none. Source: our own choice, as for masters.
UNIT_TOLERANCE = 1e-3


def point(message: object, path: str) -> Array:
    """Return x, y, z, (3,).

    Raises:
        RefusedError: one of them is no number
    """
    inner = field(message, path)
    return np.array([number(inner, axis, path) for axis in "xyz"])


def rotation(message: object, path: str) -> Array:
    """Return the matrix of a quaternion, (3, 3).

    Args:
        message: has x, y, z, w under `path`; "" for the message itself

    Raises:
        RefusedError: its length is not 1
    """
    turn = field(message, path) if path else message
    return np.array(_rows(turn, path))


def pose(message: object, path: str) -> Array:
    """Return a pose, (4, 4) [m].

    Raises:
        RefusedError: it is none
    """
    turned, moved = f"{path}.orientation", f"{path}.position"
    turn, move = field(message, turned), field(message, moved)
    rows = _rows(turn, turned)
    T = [[*row, number(move, axis, moved)] for row, axis in zip(rows, "xyz", strict=True)]
    return np.array([*T, [0.0, 0.0, 0.0, 1.0]])


def wrench(message: object, path: str) -> Array:
    """Return (force; torque), (6,) [N, N m].

    Raises:
        RefusedError: one of them is no number
    """
    return np.concatenate([point(message, f"{path}.force"), point(message, f"{path}.torque")])


def _rows(turn: object, path: str) -> list[list[float]]:
    """Return the rows of a quaternion's matrix.

    In plain numbers: this is done for every message of a stream, and arrays of four are slow.
    """
    x, y, z, w = (number(turn, axis, path) for axis in "xyzw")
    length = sqrt(x * x + y * y + z * z + w * w)
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise RefusedError(
            "quaternion", f"got {path or 'a quaternion'} of length {length:.4g}; allowed: 1"
        )
    x, y, z, w = x / length, y / length, z / length, w / length
    return [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
