"""image_geometry of scripts: pixels and rays of the simulator's own camera infos."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.scripts.playing import play
from trocar.cameras import Intrinsics, StereoCalibration, camera_infos
from trocar.cameras.lens import project
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import transform
from trocar.scripts.camera_models import PinholeCameraModel, StereoCameraModel
from trocar.scripts.messages import Edition, message_class

EYE = Intrinsics(
    640, 480, np.array([[610.0, 0.0, 331.0], [0.0, 605.0, 236.0], [0.0, 0.0, 1.0]]),
    np.array([-0.31, 0.12, 0.001, -0.002, 0.01]),
)  # fmt: skip
CALIBRATION = StereoCalibration(
    EYE, EYE, transform(matrix_from_rpy(0.004, -0.02, 0.006), [0.0054, 0.0001, 0.0])
)
POINT = np.array([0.012, -0.02, 0.11])


def info(eye: int, edition: Edition = 1) -> Any:
    one = camera_infos(CALIBRATION)[eye]
    message: Any = message_class("sensor_msgs/CameraInfo", edition)()
    for name in "DKRP":
        spelled = name if edition == 1 else name.lower()
        setattr(message, spelled, getattr(one, name).ravel().tolist())
    message.width, message.height, message.header.frame_id = one.width, one.height, "left"
    return message


@pytest.mark.parametrize("edition", [1, 2])
def test_a_point_is_the_same_by_the_raw_pixel_and_by_its_projection(edition: Edition) -> None:
    camera = PinholeCameraModel()
    camera.fromCameraInfo(info(0, edition))
    turned = camera.rotationMatrix() @ POINT
    there = camera.project3dToPixel(np.asarray(turned).ravel().tolist())
    raw = project(POINT, EYE.K, EYE.distortion)
    np.testing.assert_allclose(camera.rectifyPoint(raw.tolist()), there, atol=1e-6)
    ray = np.array(camera.projectPixelTo3dRay(there))
    np.testing.assert_allclose(ray, np.asarray(turned).ravel() / np.linalg.norm(POINT), atol=1e-12)
    assert camera.project_pixel_to_3d_ray(there) == tuple(ray)  # pyright: ignore
    assert camera.get_tf_frame() == camera.tf_frame == "left"  # pyright: ignore
    assert camera.getDeltaX(camera.getDeltaU(0.01, 0.1), 0.1) == pytest.approx(0.01)


def test_two_pixels_are_the_point_again() -> None:
    eyes = StereoCameraModel()
    eyes.fromCameraInfo(info(0), info(1))
    left, right = eyes.project3dToPixel(POINT.tolist())
    assert left[1] == pytest.approx(right[1], abs=1e-9)
    disparity = left[0] - right[0]
    np.testing.assert_allclose(eyes.projectPixelTo3d(left, disparity), POINT, atol=1e-12)
    assert eyes.getZ(disparity) == pytest.approx(POINT[2])
    assert eyes.getDisparity(float(POINT[2])) == pytest.approx(disparity)
    assert eyes.projectPixelTo3d(left, 0.0) == (0.0, 0.0, 0.0)
    assert eyes.getZ(0.0) == eyes.getDisparity(0.0) == np.inf


def test_a_rectified_image_shows_each_point_at_its_pixel() -> None:
    camera = PinholeCameraModel()
    camera.fromCameraInfo(info(0))
    v, u = np.mgrid[:480, :640].astype(np.float64)
    raw = np.stack([u, v], axis=-1)  # each pixel has its own place for a colour
    found = camera.rectifyImage(raw, np.zeros_like(raw))
    for place in ((320, 240), (100, 400), (500, 90)):
        seen = found[place[1], place[0]]
        np.testing.assert_allclose(camera.rectifyPoint(seen.tolist()), place, atol=1e-6)
    grey = np.full((480, 640), 200, np.uint8)
    assert camera.rectifyImage(grey, np.zeros_like(grey))[240, 320] == 200


def test_a_region_and_binning_move_the_pixels() -> None:
    whole, part = PinholeCameraModel(), PinholeCameraModel()
    message = info(1)
    whole.fromCameraInfo(message)
    message.binning_x = message.binning_y = 2
    message.roi.x_offset, message.roi.y_offset = 40, 20
    part.fromCameraInfo(message)
    u, v = whole.project3dToPixel(POINT.tolist())
    expected = ((u - 40) / 2, (v - 20) / 2)
    np.testing.assert_allclose(part.project3dToPixel(POINT.tolist()), expected, atol=1e-9)
    np.testing.assert_array_equal(part.fullProjectionMatrix(), whole.projectionMatrix())
    assert part.rectifyPoint(((331 - 40) / 2, (236 - 20) / 2)) == pytest.approx(
        (whole.rectifyPoint((331, 236)) - (40, 20)) / 2, abs=1e-6
    )


def test_a_camera_without_an_info_says_so() -> None:
    with pytest.raises(ValueError, match="call fromCameraInfo first"):
        PinholeCameraModel().project3dToPixel((0.0, 0.0, 0.1))


@pytest.mark.parametrize("package", ["rospy", "rclpy"])
def test_scripts_import_image_geometry(tmp_path: Path, package: str) -> None:
    text = f"""
    import {package}
    from image_geometry import PinholeCameraModel, StereoCameraModel
    from sensor_msgs.msg import CameraInfo
    names = "KDRP" if "{package}" == "rospy" else "kdrp"
    message = CameraInfo(width=640, height=480)
    values = [500.0, 0, 320, 0, 500, 240, 0, 0, 1], [0.0] * 5, [1.0, 0, 0, 0, 1, 0, 0, 0, 1]
    for name, value in zip(names, (*values, [500.0, 0, 320, 0, 0, 500, 240, 0, 0, 0, 1, 0])):
        setattr(message, name, [float(v) for v in value])
    camera = PinholeCameraModel()
    camera.fromCameraInfo(message)
    assert camera.project3dToPixel((0.01, 0.0, 0.1)) == (370.0, 240.0)
    """
    assert play(tmp_path, text).status == 0
