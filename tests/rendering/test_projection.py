"""Things are seen where they are: against OpenCV and against geometry, through lenses as well."""

from __future__ import annotations

import numpy as np
import pytest

from tests.rendering.scenes import disc, mesh, plate, seen, snapshot, stereo
from trocar.cameras.lens import plane_from_pixels, undistort
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform, transform_points
from trocar.rendering import Look
from trocar.rendering.optics import sources, wide_pinhole

pytestmark = pytest.mark.usefixtures("opengl")

#: k1 k2 p1 p2 k3 of a barrel, of a cushion with the eyes' glass askew, and a rational one.
LENSES = {
    "none": (),
    "barrel": (-0.28, 0.09, 0.0, 0.0, -0.01),
    "askew": (0.12, -0.05, 0.004, -0.003, 0.0),
    "rational": (-0.3, 0.1, 0.001, 0.0005, 0.0, -0.05, 0.02, 0.0),
}


def covered(rim: np.ndarray) -> np.ndarray:
    """Return the pixels whose middles lie within an outline, (480, 640). Source: even-odd rule."""
    low, high = np.floor(rim.min(axis=0)).astype(int), np.ceil(rim.max(axis=0)).astype(int)
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    inside = np.zeros(x.shape, dtype=bool)
    for (ax, ay), (bx, by) in zip(rim, np.roll(rim, -1, axis=0), strict=True):
        spans = (ay > y) != (by > y)
        if spans.any():
            inside ^= spans & (x < ax + (y - ay) * (bx - ax) / np.where(spans, by - ay, 1.0))
    found = np.zeros((480, 640), dtype=bool)
    found[low[1] : high[1] + 1, low[0] : high[0] + 1] = inside
    return found


@pytest.mark.parametrize("lens", LENSES)
def test_discs_are_where_opencv_projects_them(lens: str) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is the judge here")
    rig = stereo(LENSES[lens])
    across, down = np.linspace(-0.036, 0.036, 4), np.linspace(-0.024, 0.024, 3)
    places = [np.array([x, y, 0.11 + 0.3 * abs(x)]) for x in across for y in down]
    drawn = [disc(place, 0.005) for place in places]
    shapes = [mesh(f"disc{k}", flat, body=k) for k, (flat, _) in enumerate(drawn)]
    where = snapshot([np.eye(4)] * (len(shapes) - 1))
    frame = seen(shapes, rig, Look(distortion=True), where)
    assert frame.ids is not None
    number = {name: k for k, name in frame.names.items()}
    off = []
    for eye, T in enumerate((np.eye(4), inverse(rig.T_left_right))):
        for k, (_, rim) in enumerate(drawn):
            own = rig.eyes[eye]
            projected, _ = cv2.projectPoints(
                transform_points(T, rim), np.zeros(3), np.zeros(3), own.K, own.distortion
            )
            expected, got = covered(projected[:, 0]), frame.ids[eye] == number[f"disc{k}"]
            middles = [np.argwhere(mask).mean(axis=0) for mask in (expected, got)]
            off.append(middles[1] - middles[0])
            edge = 3.0 if lens == "none" else 0.5 * len(rim)  # ids are their nearest pixel's
            assert (expected != got).sum() <= edge
    assert np.abs(off).max() < (0.04 if lens == "none" else 0.25)
    assert np.abs(np.mean(off, axis=0)).max() < 0.05


@pytest.mark.parametrize("lens", list(LENSES)[1:])
def test_the_light_of_a_pixel_comes_from_where_opencv_says(lens: str) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is the judge here")
    eye = stereo(LENSES[lens]).left
    wide = wide_pinhole(eye, 0.002, 12.0, 8192)
    places = sources(eye, wide).astype(np.float64).reshape(-1, 2)
    rays = (places - [wide.cx, wide.cy]) / [wide.fx, wide.fy]
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    projected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), eye.K, eye.distortion)
    v, u = np.meshgrid(np.arange(480), np.arange(640), indexing="ij")
    assert np.abs(projected[:, 0] - np.stack([u, v], axis=-1).reshape(-1, 2)).max() < 1e-3
    low, high = places.min(axis=0), places.max(axis=0)
    assert (low >= 0.0).all() and (high <= [wide.width - 1, wide.height - 1]).all()


@pytest.mark.parametrize("lens", LENSES)
def test_the_depth_of_a_slanted_plane_is_right_in_every_pixel(lens: str) -> None:
    rig = stereo(LENSES[lens])
    tilt = transform(matrix_from_rotation_vector(np.array([0.3, -0.4, 0.1])), [0.0, 0.0, 0.1])
    frame = seen([mesh("plate", plate(tilt, 2.0, 2.0))], rig, Look(distortion=True))
    assert frame.depth is not None
    v, u = np.meshgrid(np.arange(480), np.arange(640), indexing="ij")
    for eye, T in enumerate((np.eye(4), inverse(rig.T_left_right))):
        own = T @ tilt
        rays = undistort(
            plane_from_pixels(np.stack([u, v], axis=-1).reshape(-1, 2), rig.eyes[eye].K),
            rig.eyes[eye].distortion,
        )
        rays = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
        true = (own[:3, 2] @ own[:3, 3]) / (rays @ own[:3, 2])
        off = np.abs(frame.depth[eye].reshape(-1) - true)
        assert off.max() < 2e-6, off.max()  # 2 um, 1/30 of a pixel; asked are 100 um


def test_a_plane_at_100_mm_is_at_100_mm_and_looks_back() -> None:
    flat = transform(np.eye(3), [0.0, 0.0, 0.1])
    frame = seen([mesh("plate", plate(flat, 1.0, 1.0))], stereo())
    assert frame.depth is not None and frame.normals is not None and frame.ids is not None
    assert np.abs(frame.depth - 0.1).max() < 1e-6
    assert np.abs(frame.normals - [0.0, 0.0, -1.0]).max() < 1e-6
    assert (frame.ids == 1).all() and frame.names == {1: "plate"}


def test_without_distortion_the_frame_says_so() -> None:
    flat = transform(np.eye(3), [0.0, 0.0, 0.1])
    shapes = [mesh("plate", plate(flat, 1.0, 1.0))]
    rig = stereo(LENSES["barrel"])
    assert not np.any(seen(shapes, rig).distortion[0])
    assert (seen(shapes, rig, Look(distortion=True)).distortion[0] == rig.left.distortion).all()
