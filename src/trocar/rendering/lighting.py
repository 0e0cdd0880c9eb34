"""Lights: a scope's, beside its lenses, and a room's, under the ceiling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.se3 import inverse, transform, transform_points
from trocar.rendering.frustum import Frustum

Array = NDArray[np.float64]

#: Position of the light guide's end from midway between the eyes: above them, at their depth [m].
#: Source: our own choice; guides lie around the lenses of a scope that is 10 to 12 mm thick.
GUIDE = np.array([0.0, -0.0045, 0.0])
#: Distance at which white is about as bright as a screen shows [m]. Source: our own choice, after
#: working distances of 50 to 150 mm.
WORKING = 0.22
#: Ratio of the light that tissue scatters from all around. Source: chosen by eye.
SCATTERED = 0.06
#: Least depth of the eyes' frusta that the shadow map covers [m]. Source: our own choice.
COVERED_FROM = 0.03
#: Rim of that map beyond the frusta, in the plane z = 1, so that its edge is not seen. Source: our
#: own choice.
RIM = 0.01
#: Room: vector from the middle of all objects to the lamp [m], light from all around, strength.
#: Source: chosen by eye.
LAMP, ROOM_LIGHT, ROOM_POWER = np.array([0.9, 1.6, 3.2]), 0.42, 1.15


@dataclass(frozen=True, eq=False)
class Light:
    """A light, with the view of the world from it.

    Attributes:
        at: position in the reference frame (3,) [m]
        power: brightness times distance squared [m^2]
        around: strength of the light from all around
        up: direction of that light, in the reference frame (3,)
        frustum: covers everything that may throw shadows
        clip: from the reference frame to the light's clip space, (4, 4)
        scope: whether it shines from beside the lenses
    """

    at: Array
    power: float
    around: float
    up: Array
    frustum: Frustum
    clip: Array
    scope: bool


def scope_light(frusta: list[Frustum], far: float) -> Light:
    """Return the light at the tip of a scope.

    Args:
        frusta: of the eyes; the reference frame is midway between them
        far: its range [m]
    """
    T_light_reference = transform(np.eye(3), -GUIDE)
    corners: list[Array] = []
    for frustum in frusta:
        edges = [(x, y) for x in (frustum.left, frustum.right)
                 for y in (frustum.top, frustum.bottom)]  # fmt: skip
        T = T_light_reference @ inverse(frustum.T_eye_reference)
        for depth in (COVERED_FROM, far):
            points = transform_points(T, depth * np.array([[x, y, 1.0] for x, y in edges]))
            corners.append(points[:, :2] / points[:, 2:])
    seen = np.concatenate(corners)
    (left, top), (right, bottom) = seen.min(axis=0) - RIM, seen.max(axis=0) + RIM
    frustum = Frustum(T_light_reference, left, right, top, bottom, frusta[0].near, 1.0)
    return Light(
        GUIDE,
        WORKING**2,
        SCATTERED,
        np.array([0.0, -1.0, 0.0]),
        frustum,
        _clip(frustum, far),
        True,
    )


def room_light(T_reference_world: Array, middle: Array, radius: float) -> Light:
    """Return a lamp above the middle of everything.

    Args:
        T_reference_world: (4, 4)
        middle, radius: a sphere about all that may throw shadows, in the world (3,), [m]
    """
    lamp = middle + LAMP * max(1.0, radius / 1.5)
    ahead = (middle - lamp) / np.linalg.norm(middle - lamp)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    T_world_light = transform(np.stack([right, np.cross(ahead, right), ahead], axis=1), lamp)
    distance = float(np.linalg.norm(middle - lamp))
    slope = radius / np.sqrt(max(distance**2 - radius**2, (0.3 * distance) ** 2))
    T_light_reference = inverse(T_reference_world @ T_world_light)
    near = max(0.05 * distance, distance - radius)
    frustum = Frustum(T_light_reference, -slope, slope, -slope, slope, near, 1.0)
    return Light(
        transform_points(T_reference_world, lamp),
        ROOM_POWER * distance**2,
        ROOM_LIGHT,
        T_reference_world[:3, 2],
        frustum,
        _clip(frustum, distance + 2.0 * radius),
        False,
    )


def _clip(frustum: Frustum, far: float) -> Array:
    """Return the matrix from the reference frame to clip space."""
    wide, tall = frustum.right - frustum.left, frustum.bottom - frustum.top
    span = far - frustum.near
    P = np.array(
        [
            [2.0 / wide, 0.0, -(frustum.right + frustum.left) / wide, 0.0],
            [0.0, 2.0 / tall, -(frustum.bottom + frustum.top) / tall, 0.0],
            [0.0, 0.0, (far + frustum.near) / span, -2.0 * far * frustum.near / span],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    return P @ frustum.T_eye_reference
