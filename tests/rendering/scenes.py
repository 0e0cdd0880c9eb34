"""Scenes made by hand: plates, discs and boards before a camera that stands in the origin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Calibration, Intrinsics, StereoCalibration
from trocar.geometry.se3 import inverse
from trocar.rendering import Channels, Look, Renderer, StereoFrame
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import ShapeRecord, Snapshot

Array = NDArray[np.float64]

WHITE, BLACK = (0.9, 0.9, 0.9, 1.0), (0.05, 0.05, 0.05, 1.0)


def camera(calibration: Calibration, kind: str = "endoscope") -> CameraRecord:
    """Return a camera whose left eye is at the world's origin and looks along its z."""
    T_left = inverse(calibration.mounts[0])
    return CameraRecord(
        "eye", kind, calibration, "", "", 0, T_left, 0.0, np.eye(4), 0.0, 1  # type: ignore[arg-type]
    )  # fmt: skip


def stereo(
    distortion: Sequence[float] = (), size: tuple[int, int] = (640, 480), focal: float = 580.0
) -> StereoCalibration:
    """Return a scope of two equal eyes, 5 mm apart, off their pictures' middles."""
    K = np.array([[focal, 0, 0.5 * size[0] + 7.3], [0, 1.01 * focal, 0.5 * size[1] - 11.8],
                  [0, 0, 1]])  # fmt: skip
    eye = Intrinsics(*size, K, np.array(distortion, dtype=np.float64))
    apart = np.eye(4)
    apart[0, 3] = 0.005
    return StereoCalibration(eye, eye, apart)


def snapshot(poses: Sequence[Array] = (), time: float = 0.0) -> Snapshot:
    """Return the world's body 0, and more that stand at these poses (turned by none)."""
    at = np.array([np.eye(4), *poses])
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(at), 1))
    return Snapshot(time, at[:, :3, 3], upright, {}, 1)


def mesh(
    name: str, corners: Array, colour: tuple[float, float, float, float] = WHITE, body: int = 0
) -> ShapeRecord:
    """Return triangles (n, 3, 3), which are seen from where they run anticlockwise."""
    points = corners.reshape(-1, 3)
    faces = np.arange(len(points)).reshape(-1, 3)
    return ShapeRecord(
        body, f"{name}/0", "mesh", np.abs(points).max(axis=0), np.eye(4), colour,
        0.0, 0.0, 0.0, None, "", False, (points, faces),
    )  # fmt: skip


def plate(T: Array, width: float, height: float) -> Array:
    """Return a rectangle in the x-y plane of a frame, seen from its -z side, (2, 3, 3)."""
    x, y = 0.5 * width, 0.5 * height
    flat = np.array([[-x, -y, 0], [-x, y, 0], [x, y, 0], [x, -y, 0]]) @ T[:3, :3].T + T[:3, 3]
    return flat[[[0, 1, 2], [0, 2, 3]]]


def disc(centre: Array, radius: float, points: int = 180) -> tuple[Array, Array]:
    """Return a disc across the camera's axis: triangles (n, 3, 3) and its rim (n, 3)."""
    angle = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    rim = centre + radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    after = np.roll(rim, -1, axis=0)
    return np.stack([np.tile(centre, (points, 1)), after, rim], axis=1), rim


def seen(
    shapes: Sequence[ShapeRecord],
    calibration: Calibration,
    look: Look | None = None,
    where: Snapshot | None = None,
    kind: str = "endoscope",
) -> StereoFrame:
    """Render a camera, with everything beside the colours."""
    renderer = Renderer(lambda: (1, shapes), Channels(depth=True, ids=True, normals=True), look)
    frame = renderer.render(where or snapshot(), {"eye": camera(calibration, kind)}, "eye")
    renderer.close()
    return frame
