"""A wound's edges from images that rays to a plane make, without a renderer."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tasks.vision.drawn import small_eyes
from trocar.cameras import StereoCalibration
from trocar.cameras.lens import plane_from_pixels, undistort
from trocar.errors import InputError
from trocar.geometry import matrix_from_rotation_vector, transform
from trocar.tasks.vision import find_wound

pytest.importorskip("cv2", reason="needs the extra vision")

#: The tissue's plane in the left eye's frame, and the world: the plane's own frame.
PLANE = transform(matrix_from_rotation_vector([0.35, -0.2, 0.0]), [0.001, 0.002, 0.08])
HALF = 0.0015


def middle(x: np.ndarray) -> np.ndarray:
    """Return the wound's line in the plane, y of x [m]."""
    return 0.0005 + 0.06 * x + 10.0 * x * x


def images(calibration: StereoCalibration, gap: float, noise: float = 0.03) -> list[np.ndarray]:
    """Return both eyes' images of red tissue with a dark wound of half this width."""
    found, rng = [], np.random.default_rng(1)
    for eye, T in zip(calibration.eyes, (np.eye(4), calibration.T_left_right), strict=True):
        v, u = np.mgrid[: eye.height, : eye.width]
        flat = undistort(plane_from_pixels(np.stack([u, v], axis=-1), eye.K), eye.distortion)
        rays = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=-1) @ T[:3, :3].T
        n = PLANE[:3, 2]
        depth = (n @ (PLANE[:3, 3] - T[:3, 3])) / (rays @ n)
        x, y, _ = ((T[:3, 3] + depth[..., None] * rays - PLANE[:3, 3]) @ PLANE[:3, :3]).transpose(
            2, 0, 1
        )
        pixel = 0.08 / 470.0  # edges as soft as a pixel is wide
        inside = np.clip((gap - np.abs(y - middle(x))) / pixel + 0.5, 0.0, 1.0)[..., None]
        tissue = (
            np.array([180.0, 95.0, 85.0]) * (1.0 + 0.1 * np.sin(900.0 * x + 300.0 * y))[..., None]
        )
        image = tissue + inside * (np.array([60.0, 15.0, 15.0]) - tissue)
        image += 255.0 * noise * rng.standard_normal(image.shape)
        found.append(np.clip(image, 0, 255).astype(np.uint8))
    return found


def test_both_edges_are_found_to_a_fraction_of_a_pixel_and_as_well_as_the_covariance_says() -> None:
    eyes = small_eyes()
    guess = np.array([[-0.012, 0.001, 0.0], [0.012, 0.001, 0.0]])
    wound = find_wound(eyes, *images(eyes, HALF), guess=guess, T_world_left=np.linalg.inv(PLANE))
    for edge in wound.edges:
        x, y, z = edge.points.T
        across = y - middle(x)
        sigma = np.sqrt(edge.covariance[:, [1, 2], [1, 2]])
        assert len(edge.points) > 15 and sigma.max() < 5e-4
        assert (np.abs(across - np.sign(across[0]) * HALF) < 2.5 * sigma[:, 0]).all()
        assert (np.abs(z) < 2.5 * sigma[:, 1]).all()
    first, second = (edge.points[:, 1].mean() for edge in wound.edges)
    assert abs(first - second) == pytest.approx(2.0 * HALF, abs=5e-5)  # a third of a pixel


def test_what_is_no_wound_is_named() -> None:
    eyes = small_eyes()
    whole = images(eyes, -1.0)
    guess = np.array([[-0.012, 0.001, 0.0], [0.012, 0.001, 0.0]])
    with pytest.raises(InputError, match="of 24 profiles show both edges; allowed: 7 or more"):
        find_wound(eyes, *whole, guess=guess, T_world_left=np.linalg.inv(PLANE))
    with pytest.raises(InputError, match="lies behind the eyes"):
        find_wound(eyes, *whole, guess=guess)
    with pytest.raises(InputError, match=r"guess \[m\]: got .*two points or more"):
        find_wound(eyes, *whole, guess=guess[:1])
