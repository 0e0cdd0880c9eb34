"""Marker clusters somewhere on the links, and cameras somewhere in the room."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]

#: Clusters lie within this of the origin of their link's frame, the camera's frame within this of
#: the arm's root, along each axis. Source: our own choice. [m]
ON_LINK_M, IN_ROOM_M = 0.15, 2.0


def random_rotations(rng: np.random.Generator, count: int) -> Array:
    """Return rotations of which none is more likely than another, (count, 3, 3)."""
    return matrix_from_quaternion(rng.normal(size=(count, 4)))


def random_pose(rng: np.random.Generator, reach: float) -> Array:
    """Return a pose in any orientation within a cube of half this edge, (4, 4)."""
    return transform(random_rotations(rng, 1)[0], rng.uniform(-reach, reach, 3))


def place_clusters(rng: np.random.Generator, bodies: Iterable[str]) -> dict[str, Array]:
    """Return {body: T_link_cluster (4, 4)}."""
    return {body: random_pose(rng, ON_LINK_M) for body in bodies}


def place_camera(rng: np.random.Generator) -> Array:
    """Return the arm's root in the frame of the cameras, T_camera_root (4, 4)."""
    return random_pose(rng, IN_ROOM_M)
