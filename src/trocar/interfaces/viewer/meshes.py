"""Triangles for the shapes of a rig: boxes and cylinders with softened edges, capsules, spheres.

All four are one surface: a small sphere whose points are carried outwards, each to its corner.
Sizes are MuJoCo's: box half edges, (radius, half length) of capsules and cylinders, sphere radius.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

EDGE = 0.12
"""Radius of a softened edge over the shape's smallest half size. Source: chosen by eye."""

EDGE_MAX_M = 0.006
"""Largest radius of a softened edge [m]. Source: chosen by eye."""

ROUND = 28
"""Points around a circle. Source: chosen by eye; 24 to 32 look round on a screen."""

RINGS = 5
"""Rings from the equator to a pole. Source: chosen by eye."""


def mesh(kind: str, size: Sequence[float] | Floats, rounding: float = 0.0) -> tuple[Floats, Ints]:
    """Make the surface of a shape in its own frame.

    Args:
        kind: "box", "capsule", "cylinder" or "sphere"
        size: MuJoCo's sizes of that kind; more numbers than needed are ignored [m]
        rounding: radius of a box's edges [m]; 0 leaves it to us

    Returns:
        vertices (n, 3) [m] and triangles (m, 3), outside seen anticlockwise
    """
    if kind == "box":
        return _box(np.asarray(size[:3], dtype=np.float64), rounding)
    if kind == "cylinder":
        return _cylinder(float(size[0]), float(size[1]))
    if kind == "capsule":
        return _round_shell(float(size[0]), float(size[1]))
    if kind == "sphere":
        return _round_shell(float(size[0]), 0.0)
    raise InputError(f"no picture of a shape of kind {kind!r}: box, capsule, cylinder, sphere")


def half_extents(kind: str, size: Sequence[float] | Floats) -> Floats:
    """Say how far a shape reaches along its own axes, (3,) [m]."""
    if kind in ("box", "mesh"):
        return np.array(size[:3], dtype=np.float64)
    radius, length = float(size[0]), 0.0 if kind == "sphere" else float(size[1])
    return np.array([radius, radius, length if kind == "cylinder" else length + radius])


def _box(half: Floats, rounding: float) -> tuple[Floats, Ints]:
    edge = rounding or min(EDGE * float(half.min()), EDGE_MAX_M)
    quarter = np.linspace(0.0, np.pi / 2, 4, dtype=np.float64)
    longitude = np.concatenate([quarter + k * np.pi / 2 for k in range(4)])
    signs = np.repeat([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]], quarter.size, axis=0)
    corners = signs * (half[:2] - edge)
    return _shell(longitude, corners, float(half[2]) - edge, edge, rings=3)


def _cylinder(radius: float, half_length: float) -> tuple[Floats, Ints]:
    edge = min(EDGE * min(radius, half_length), EDGE_MAX_M)
    longitude = _around()
    corners = (radius - edge) * np.stack([np.cos(longitude), np.sin(longitude)], axis=1)
    return _shell(longitude, corners, half_length - edge, edge, rings=2)


def _round_shell(radius: float, half_length: float) -> tuple[Floats, Ints]:
    longitude = _around()
    return _shell(longitude, np.zeros((ROUND, 2)), half_length, radius, rings=RINGS)


def _around() -> Floats:
    return np.linspace(0.0, 2 * np.pi, ROUND, endpoint=False, dtype=np.float64)


def _shell(
    longitude: Floats, corners: Floats, half_height: float, radius: float, *, rings: int
) -> tuple[Floats, Ints]:
    """Carry a sphere's points outwards: (n,) longitudes to their corners (n, 2), and up or down."""
    n = longitude.size
    up = np.linspace(0.0, np.pi / 2, rings + 1, dtype=np.float64)
    latitude = np.concatenate([-up[::-1], up])[:, None]
    lift = np.where(np.arange(latitude.size) <= rings, -half_height, half_height)[:, None]
    x = corners[:, 0] + radius * np.cos(latitude) * np.cos(longitude)
    y = corners[:, 1] + radius * np.cos(latitude) * np.sin(longitude)
    z = lift + radius * np.sin(latitude) * np.ones(n)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return vertices, _faces(latitude.size, n)


def _faces(rows: int, n: int) -> Ints:
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(n), indexing="ij")
    here, right = row * n + column, row * n + (column + 1) % n
    sides = [np.stack([here, right, right + n], -1), np.stack([here, right + n, here + n], -1)]
    fan = np.stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)], axis=1)
    return np.concatenate(
        [*(side.reshape(-1, 3) for side in sides), fan[:, ::-1], fan + (rows - 1) * n]
    )
