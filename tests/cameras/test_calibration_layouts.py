"""Calibrations of other programs' settings are those of OpenCV by other names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from trocar.cameras import MonoCalibration
from trocar.descriptions.cameras import load_camera, load_stereo_camera
from trocar.errors import DescriptionError

K = np.array([[601.0, 0.0, 322.0], [0.0, 602.0, 238.0], [0.0, 0.0, 1.0]])
BENT = [-0.21, 0.06, 0.001, -0.002, 0.0]

ORB = """%YAML:1.0
Camera.fx: 601.0
Camera.fy:602.0
Camera.cx: 322.0
Camera.cy: 238.0
Camera.k1: -0.21
Camera.k2: 0.06
Camera.p1: 0.001
Camera.p2: -0.002
Camera.width: 640
Camera.height: 480
ORBextractor.nFeatures: 900
"""
#: The numbers of one eye, for another prefix.
NUMBERS = ORB[ORB.index("Camera.fx") : ORB.index("ORBextractor")]
CAMODOCAL = """%YAML:1.0
---
model_type: PINHOLE
camera_name: scope
image_width: 640
image_height: 480
distortion_parameters: {k1: -0.21, k2: 0.06, p1: 0.001, p2: -0.002}
projection_parameters: {fx: 601.0, fy: 602.0, cx: 322.0, cy: 238.0}
"""
SVO = """
cam_model: Pinhole
cam_width: 640
cam_height: 480
cam_fx: 601
cam_fy: 602
cam_cx: 322
cam_cy: 238
cam_d0: -0.21
cam_d1: 0.06
cam_d2: 0.001
cam_d3: -0.002
"""
CAM0 = """
cam0:
  camera_model: pinhole
  distortion_model: radtan
  distortion_coeffs: [-0.21, 0.06, 0.001, -0.002]
  intrinsics: [601.0, 602.0, 322.0, 238.0]
  resolution: [640, 480]
"""
CAM1 = CAM0.replace("cam0", "cam1")
#: p_cam1 = T p_cam0: the second eye is 5 mm to the right.
POSE = "  T_cn_cnm1: [[1, 0, 0, -0.005], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
SIDE = """
{side}.width: 640
{side}.height: 480
{side}.K: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data:[601, 0, 322, 0, 602, 238, 0, 0, 1]
{side}.D: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data:[-0.21, 0.06, 0.001, -0.002, 0]
{side}.R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
{side}.P: !!opencv-matrix
   rows: 3
   cols: 4
   dt: d
   data: [600, 0, 320, {x}, 0, 600, 240, 0, 0, 0, 1, 0]
"""
IDENTITY = "[[1, 0, 0, {x}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"


def written(folder: Path, text: str, name: str = "camera.yaml") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


@pytest.mark.parametrize(
    "text", [ORB, CAMODOCAL, SVO, CAM0], ids=["orb", "camodocal", "svo", "kalibr"]
)
def test_one_eye_is_read_from_the_settings_of_slam(text: str, tmp_path: Path) -> None:
    found = load_camera(written(tmp_path, text))
    assert isinstance(found, MonoCalibration)
    assert found.eye.size == (640, 480)
    np.testing.assert_array_equal(found.eye.K, K)
    np.testing.assert_array_equal(found.eye.distortion, BENT)


STEREO = {
    "kalibr": CAM0 + CAM1 + POSE,
    "kalibr-imu": CAM0 + f"  T_cam_imu: {IDENTITY.format(x=0.001)}\n"
    + CAM1 + f"  T_cam_imu: {IDENTITY.format(x=-0.004)}\n",
    "kalibr-imu-inverse": CAM0 + f"  T_imu_cam: {IDENTITY.format(x=-0.001)}\n"
    + CAM1 + f"  T_imu_cam: {IDENTITY.format(x=0.004)}\n",
    "orb2": "%YAML:1.0\n" + SIDE.format(side="LEFT", x=0) + SIDE.format(side="RIGHT", x=-3.0),
    "orb2-rectified": ORB + "Camera.bf: 3.005\n",
    "orb3": ORB.replace("Camera.f", "Camera1.f").replace("Camera.c", "Camera1.c")
    .replace("Camera.k", "Camera1.k").replace("Camera.p", "Camera1.p")
    + NUMBERS.replace("Camera.", "Camera2.")
    + f"Stereo.T_c1_c2: {IDENTITY.format(x=0.005)}\n",
}  # fmt: skip


@pytest.mark.parametrize("text", STEREO.values(), ids=STEREO)
def test_two_eyes_are_read_from_the_settings_of_slam(text: str, tmp_path: Path) -> None:
    found = load_stereo_camera(written(tmp_path, text))
    for eye in found.eyes:
        assert eye.size == (640, 480)
        np.testing.assert_array_equal(eye.K, K)
        np.testing.assert_array_equal(eye.distortion, BENT)
    np.testing.assert_allclose(found.T_left_right[:3, 3], [5e-3, 0.0, 0.0], atol=1e-15)
    np.testing.assert_array_equal(found.T_left_right[:3, :3], np.eye(3))


def test_the_baseline_of_a_depth_camera_is_no_second_eye(tmp_path: Path) -> None:
    found = load_camera(written(tmp_path, ORB + "Camera.bf: 40.0\nDepthMapFactor: 5000\n"))
    assert isinstance(found, MonoCalibration)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CAMODOCAL.replace("PINHOLE", "MEI"), "model_type: got 'MEI'; allowed: a pinhole"),
        (SVO.replace("Pinhole", "ATAN"), "cam_model: got 'ATAN'"),
        (CAM0.replace("radtan", "equidistant"), "cam0.distortion_model: got 'equidistant'"),
        (CAM0 + CAM1, "cam1.T_cn_cnm1: is missing"),
        (CAM0 + CAM1 + "  T_cn_cnm1: [1, 2]\n", "cam1.T_cn_cnm1: got .*; allowed: a pose of 4 x 4"),
        (CAM0.replace("[640, 480]", "[640]"), "cam0.resolution: got .*; allowed: 2 numbers"),
        (CAM0 + CAM1.replace("640", "320") + POSE, "cam1.resolution: got .* that of the other"),
        (CAM0 + CAM1 + POSE + CAM0.replace("cam0", "cam2"), "has 3 cameras; allowed: one or two"),
        (ORB.replace("Camera.fx", "Camera.f"), "camera_matrix: is missing"),
        (ORB + NUMBERS.replace("Camera.", "Camera2."), "Stereo.T_c1_c2: is missing"),
    ],
)  # fmt: skip
def test_a_fault_of_the_settings_of_slam_is_named(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=message):
        load_camera(written(tmp_path, text))


def test_json_holds_what_yaml_holds(tmp_path: Path) -> None:
    """OpenCV writes matrices as tables, Python as lists."""
    matrix = {
        "type_id": "opencv-matrix",
        "rows": 3,
        "cols": 3,
        "dt": "d",
        "data": K.ravel().tolist(),
    }
    size = {"image_width": 640, "image_height": 480}
    for kept in (matrix, K.tolist()):
        keys = {**size, "camera_matrix": kept, "distortion_coefficients": [BENT]}
        found = load_camera(written(tmp_path, json.dumps(keys), "camera.json"))
        assert isinstance(found, MonoCalibration)
        np.testing.assert_array_equal(found.eye.K, K)
        np.testing.assert_array_equal(found.eye.distortion, BENT)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1,\n', "line 2: is not JSON"),
        ("[1, 2]", "got .*; allowed: keys with values"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_what_is_no_json_is_rejected(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=message):
        load_camera(written(tmp_path, text, "camera.json"))


def test_a_file_of_something_else_is_named_without_a_warning_for_each_key(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(
        DescriptionError, match=r"camera_matrix: is missing .* the file has tracker"
    ):
        load_camera(written(tmp_path, '{"tracker": 1, "recording": 2}', "settings.json"))
    assert not caplog.records
