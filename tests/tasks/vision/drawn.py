"""Needles drawn without a renderer: the distance of every pixel to the projected centre line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from trocar.cameras import Intrinsics, StereoCalibration
from trocar.cameras.lens import project
from trocar.descriptions.needles import Needle
from trocar.geometry import inverse, matrix_from_rotation_vector
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
TISSUE, STEEL = np.array([170.0, 90.0, 80.0]), np.array([185.0, 188.0, 192.0])
#: Disparity of the ground, 90 mm away.
GROUND_PX = 470.0 * 0.005 / 0.09
NEEDLE = Needle(0.01, 0.75 * np.pi, 0.0008, 0.003)


def small_eyes() -> StereoCalibration:
    """Return distorted eyes of 400x300, 5 mm apart."""
    K = np.array([[470.0, 0.0, 196.0], [0.0, 470.0, 152.0], [0.0, 0.0, 1.0]])
    eye = Intrinsics(400, 300, K, np.array([-0.2, 0.06, 0.001, -0.001]))
    return StereoCalibration(eye, eye, transform(np.eye(3), [0.005, 0.0, 0.0]))


def before_the_eyes(depth: float = 0.07) -> Array:
    """Return a pose of a needle that is tilted and fully seen."""
    turn = matrix_from_rotation_vector([0.4, -0.3, 0.0]) @ matrix_from_rotation_vector([0, 0, 1.1])
    return transform(turn, [0.003, -0.002, depth])


def _waves(u: Array, v: Array) -> Array:
    """Return smooth values that do not repeat."""
    waves = ((0.061, 0.023), (-0.037, 0.071), (0.013, -0.047), (0.097, 0.089))
    return sum((np.sin(a * u + b * v + 9.0 * a) for a, b in waves), np.zeros(u.shape)) / 2.0


def drawn(
    calibration: StereoCalibration,
    T_left_needle: Array | None,
    rng: np.random.Generator,
    hidden: Sequence[float] = (2.0, 2.0),
    noise: float = 0.03,
) -> tuple[Picture, Picture]:
    """Return both eyes' images; the part of the arc between two shares of it is hidden."""
    found = []
    for eye, T_left_eye in zip(
        calibration.eyes, (np.eye(4), calibration.T_left_right), strict=True
    ):
        v, u = np.mgrid[: eye.height, : eye.width]
        ground = 1.0 + 0.1 * _waves(u + GROUND_PX * (T_left_eye[0, 3] > 0.0), v)
        image = ground[..., None] * TISSUE
        if T_left_needle is not None:
            angles = np.linspace(0.0, NEEDLE.arc, 240)
            T = inverse(T_left_eye) @ T_left_needle
            points = NEEDLE.points(angles) @ T[:3, :3].T + T[:3, 3]
            pixels = project(points, eye.K, eye.distortion)
            half = NEEDLE.half_width(angles) * eye.K[0, 0] / points[:, 2]
            share = np.linspace(0.0, 1.0, len(angles))
            shown = (share < hidden[0]) | (share > hidden[1])
            low = np.floor(pixels.min(axis=0)).astype(int) - 12
            high = np.ceil(pixels.max(axis=0)).astype(int) + 12
            part = np.s_[max(low[1], 0) : high[1], max(low[0], 0) : high[0]]
            at = np.stack([u[part], v[part]], axis=-1)
            off, nearest = KDTree(pixels[shown]).query(at)
            cover = np.clip(0.5 + half[shown][nearest] - off, 0.0, 1.0)[..., None]
            image[part] += cover * (STEEL - image[part])
        image += 255.0 * noise * rng.standard_normal(image.shape)
        found.append(np.clip(np.round(image), 0, 255).astype(np.uint8))
    return found[0], found[1]
