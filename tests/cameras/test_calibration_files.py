"""Calibration files come from ROS's and OpenCV's tools and go back; faults are named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from trocar.cameras import (
    Intrinsics,
    MonoCalibration,
    StereoCalibration,
    camera_infos,
    write_camera,
)
from trocar.descriptions.cameras import load_camera, load_stereo_camera, presets
from trocar.errors import DescriptionError, InputError
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import transform

K_LEFT = np.array([[588.776, 0.0, 325.305], [0.0, 589.725, 251.666], [0.0, 0.0, 1.0]])
K_RIGHT = np.array([[591.1, 0.0, 318.25], [0.0, 592.3, 247.5], [0.0, 0.0, 1.0]])
RATIONAL = np.array([0.5, -0.3, 0.001, 0.0005, 0.02, 0.7, -0.1, 0.03])


def crooked() -> StereoCalibration:
    """Two eyes that differ in everything, one with each model of distortion."""
    turn = matrix_from_rotation_vector(np.array([0.01, -0.03, 0.02]))
    return StereoCalibration(
        Intrinsics(640, 480, K_LEFT, np.array([-0.33, 0.12, 0.002, -0.001, 0.01])),
        Intrinsics(640, 480, K_RIGHT, RATIONAL),
        transform(turn, [5.2e-3, 0.1e-3, -0.2e-3]),
        "scope",
    )


def assert_same(found: Any, expected: StereoCalibration, atol: float = 0.0) -> None:
    for one, other in zip(found.eyes, expected.eyes, strict=True):
        assert one.size == other.size
        np.testing.assert_allclose(one.K, other.K, rtol=0, atol=atol)
        np.testing.assert_allclose(one.distortion, other.distortion, rtol=0, atol=atol)
    np.testing.assert_allclose(found.T_left_right, expected.T_left_right, rtol=0, atol=1e-14 + atol)


# ------------------------------------------------------------------ there and back


@pytest.mark.parametrize("camera", [crooked(), *map(load_stereo_camera, presets())])
def test_ros_files_come_back_as_they_were(camera: StereoCalibration, tmp_path: Path) -> None:
    files = write_camera(camera, [tmp_path / "left.yaml", tmp_path / "right.yaml"])
    found = load_stereo_camera(files)
    assert_same(found, camera)
    for one, other in zip(camera_infos(found), camera_infos(camera), strict=True):
        np.testing.assert_array_equal(one.P, other.P)
        np.testing.assert_array_equal(one.R, other.R)
    again = write_camera(found, [tmp_path / "again_left.yaml", tmp_path / "again_right.yaml"])
    for first, second in zip(files, again, strict=True):
        assert first.read_text(encoding="utf-8") == second.read_text(encoding="utf-8")


@pytest.mark.parametrize("camera", [crooked(), *map(load_stereo_camera, presets())])
def test_opencv_files_come_back_as_they_were(camera: StereoCalibration, tmp_path: Path) -> None:
    (file,) = write_camera(camera, [tmp_path / "scope.yml"], "opencv")
    assert_same(load_stereo_camera(file), camera)


@pytest.mark.parametrize("kind", ["ros", "opencv"])
def test_one_eye_comes_back_too(kind: Any, tmp_path: Path) -> None:
    eye = crooked().left
    (file,) = write_camera(MonoCalibration(eye, "room"), [tmp_path / "room.yaml"], kind)
    found = load_camera(file)
    assert isinstance(found, MonoCalibration)
    np.testing.assert_array_equal(found.eye.K, eye.K)
    np.testing.assert_array_equal(found.eye.distortion, eye.distortion)


def test_yaml_reads_what_is_written_for_ros(tmp_path: Path) -> None:
    files = write_camera(crooked(), [tmp_path / "left.yaml", tmp_path / "right.yaml"])
    for file, info, side in zip(files, camera_infos(crooked()), ("left", "right"), strict=True):
        text = file.read_text(encoding="utf-8")
        judged = yaml.safe_load(text)
        assert judged["camera_name"] == f"scope/{side}"
        assert judged["distortion_model"] == info.distortion_model
        for key, value in (
            ("camera_matrix", info.K),
            ("distortion_coefficients", info.D),
            ("rectification_matrix", info.R),
            ("projection_matrix", info.P),
        ):
            assert judged[key]["data"] == value.ravel().tolist()
            assert judged[key]["rows"] * judged[key]["cols"] == value.size


def test_opencv_reads_what_is_written_for_it(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is the judge here")
    camera = crooked()
    (file,) = write_camera(camera, [tmp_path / "scope.yml"], "opencv")
    judge = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(judge.getNode("M1").mat(), camera.left.K)
    np.testing.assert_array_equal(judge.getNode("D2").mat()[0], RATIONAL)
    T_right_left = np.linalg.inv(camera.T_left_right)
    np.testing.assert_allclose(judge.getNode("R").mat(), T_right_left[:3, :3], atol=1e-15)
    np.testing.assert_allclose(judge.getNode("T").mat()[:, 0], T_right_left[:3, 3], atol=1e-15)
    np.testing.assert_array_equal(judge.getNode("P2").mat(), camera_infos(camera)[1].P)
    assert judge.getNode("image_width").real() == 640


def opencv_file(path: Path, entries: dict[str, Any]) -> Path:
    """Have OpenCV write a file."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV writes the file here")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in entries.items():
        storage.write(key, value)
    storage.release()
    return path


def stereo_entries() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what OpenCV's sample stereo_calib writes: intrinsics and extrinsics."""
    camera = crooked()
    T_right_left = np.linalg.inv(camera.T_left_right)
    inside = {
        "M1": camera.left.K.copy(),
        "D1": camera.left.distortion[None].copy(),
        "M2": camera.right.K.copy(),
        "D2": camera.right.distortion[None].copy(),
    }
    return inside, {"R": T_right_left[:3, :3].copy(), "T": T_right_left[:3, 3:].copy()}


def test_what_opencv_writes_is_read(tmp_path: Path) -> None:
    inside, outside = stereo_entries()
    size = {"image_width": 640, "image_height": 480}
    file = opencv_file(tmp_path / "both.yml", {**size, **inside, **outside})
    # OpenCV prints 17 digits.
    assert_same(load_stereo_camera(file), crooked(), atol=1e-12)
    named = {"imageSize": np.array([[640, 480]]), **inside, **outside}
    assert_same(load_stereo_camera(opencv_file(tmp_path / "named.yml", named)), crooked(), 1e-12)


def test_opencvs_two_files_are_read_together(tmp_path: Path) -> None:
    inside, outside = stereo_entries()
    first = opencv_file(tmp_path / "intrinsics.yml", inside)
    second = opencv_file(tmp_path / "extrinsics.yml", outside)
    with pytest.raises(
        DescriptionError, match="image_width: is missing, as OpenCV's sample leaves"
    ):
        load_camera([first, second])
    text = first.read_text(encoding="utf-8") + "image_width: 640\nimage_height: 480\n"
    first.write_text(text, encoding="utf-8")
    assert_same(load_stereo_camera([first, second]), crooked(), atol=1e-12)
    with pytest.raises(DescriptionError, match="R: is missing; the file has M1, D1, M2, D2"):
        load_camera(first)


def test_what_opencvs_other_sample_writes_is_read(tmp_path: Path) -> None:
    eye = crooked().left
    entries = {
        "calibration_time": "Tue 01 Jan 2030 10:00:00",
        "nframes": 12,
        "image_width": 640,
        "image_height": 480,
        "camera_matrix": eye.K.copy(),
        "distortion_coefficients": eye.distortion[:, None].copy(),
        "avg_reprojection_error": 0.21,
    }
    found = load_camera(opencv_file(tmp_path / "camera.yml", entries))
    assert isinstance(found, MonoCalibration)
    np.testing.assert_allclose(found.eye.K, eye.K, atol=1e-12)


# ------------------------------------------------------------------ as people have them

BY_HAND = """
image_width: 640       # of the frame grabber
image_height: 480

camera_name: 'endoscope: left'
camera_matrix:
  rows: 3
  cols: 3
  data: [ 588.776,   0.     ,  325.305,
            0.     , 589.725,  251.666,   # fy
            0.     ,    0.     ,    1.     ]
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.33, 1.2e-1, .002, -0.001, 0]}
rectification_matrix:
  rows: 3
  cols: 3
  data:
  - 1
  - 0
  - 0
  - 0
  - 1
  - 0
  - 0
  - 0
  - 1
projection_matrix:
  rows: 3
  cols: 4
  data: [663.774, 0, 320, 0, 0, 663.774, 240, 0, 0, 0, 1, 0]
"""

MESSAGE = """
header:
  seq: 12
  stamp:
    secs: 1700000000
    nsecs: 5
  frame_id: "left_camera_optical_frame"
height: 480
width: 640
distortion_model: "plumb_bob"
D: [-0.33, 0.12, 0.002, -0.001, 0.01]
K: [588.776, 0.0, 325.305, 0.0, 589.725, 251.666, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [663.774, 0.0, 320.0, 0.0, 0.0, 663.774, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
roi:
  x_offset: 0
  do_rectify: False
---
"""

ROS2_MESSAGE = """
header:
  stamp:
    sec: 1
    nanosec: 0
  frame_id: left
height: 480
width: 640
distortion_model: rational_polynomial
d:
- 0.5
- -0.3
- 0.001
- 0.0005
- 0.02
- 0.7
- -0.1
- 0.03
k: [588.776, 0.0, 325.305, 0.0, 589.725, 251.666, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [663.774, 0.0, 320.0, 0.0, 0.0, 663.774, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
---
"""


@pytest.mark.parametrize("text", [BY_HAND, MESSAGE, ROS2_MESSAGE], ids=["hand", "ros1", "ros2"])
def test_files_that_people_have_are_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / "left.yaml"
    path.write_text(text, encoding="utf-8")
    found = load_camera(path)
    assert isinstance(found, MonoCalibration)
    np.testing.assert_array_equal(found.eye.K, K_LEFT)
    assert found.eye.size == (640, 480) and found.eye.distortion.any()


def test_small_numbers_are_read_as_python_writes_them(tmp_path: Path) -> None:
    path = tmp_path / "left.yaml"
    path.write_text(BY_HAND.replace("-0.001", "-1e-05"), encoding="utf-8")
    found = load_camera(path)
    assert isinstance(found, MonoCalibration)
    assert found.eye.distortion[3] == -1e-5


def test_the_first_of_several_messages_counts(tmp_path: Path) -> None:
    path = tmp_path / "echo.yaml"
    path.write_text(MESSAGE + ROS2_MESSAGE, encoding="utf-8")
    found = load_camera(path)
    assert isinstance(found, MonoCalibration)
    assert found.eye.model == "plumb_bob"


def pair(folder: Path, left: str = BY_HAND, right: str | None = None) -> list[Path]:
    """Write two files; the right eye is 5 mm to the right."""
    if right is None:
        right = BY_HAND.replace("320, 0, 0", f"320, {-663.774 * 5e-3}, 0")
    files = [folder / "left.yaml", folder / "right.yaml"]
    for file, text in zip(files, (left, right), strict=True):
        file.write_text(text, encoding="utf-8")
    return files


def test_the_baseline_of_a_pair_is_in_the_right_eyes_p(tmp_path: Path) -> None:
    camera = load_stereo_camera(pair(tmp_path))
    assert camera.baseline == pytest.approx(5e-3)
    assert camera_infos(camera)[1].P[0, 3] == pytest.approx(-663.774 * 5e-3)
    assert camera_infos(camera)[1].P[0, 0] == 663.774


def test_six_digits_of_a_rotation_are_enough(tmp_path: Path) -> None:
    camera = crooked()
    files = write_camera(camera, [tmp_path / "left.yaml", tmp_path / "right.yaml"])
    for file in files:
        data = yaml.safe_load(file.read_text(encoding="utf-8"))
        lines = []
        for key, value in data.items():
            if isinstance(value, dict):
                value["data"] = [round(v, 6) for v in value["data"]]
            lines.append(f"{key}: {value}")
        file.write_text("\n".join(lines), encoding="utf-8")
    found = load_stereo_camera(files)
    np.testing.assert_allclose(found.T_left_right, camera.T_left_right, atol=2e-6)


# ------------------------------------------------------------------ faults

EYE_FAULTS = [
    ("image_width: 640", "", "image_width: is missing .or width.; the file has image_height, "),
    ("image_width: 640", "image_width: 640.5", "image_width: got 640.5; allowed: a whole number"),
    ("image_width: 640", "image_width: 1280", "cx = 325.305 does not match a width of 1280"),
    ("image_width: 640", "image_width: .nan", "image_width: got nan; allowed: a whole number"),
    ("  rows: 3\n", "  rows: three\n", "camera_matrix: got 'three' x 3; allowed: whole numbers"),
    ("588.776", "-588.776", "K: focal length fx = -588.776; allowed: above 0"),
    ("588.776", "wide", "camera_matrix: got 'wide'; allowed: finite numbers"),
    ("588.776", ".nan", "camera_matrix: got nan; allowed: finite numbers"),
    ("-0.33, 1.2e-1", "-3.3, 1.2e-1", "folds the image inside the view"),
    ("-0.33, 1.2e-1, ", "-0.33, ", "distortion_coefficients: has 4 numbers, but says 1 x 5"),
    ("distortion_model: plumb_bob", "distortion_model: equidistant",
     "distortion_model: got 'equidistant'; allowed: plumb_bob, rational_polynomial"),
    ("distortion_model: plumb_bob", "distortion_model: rational_polynomial",
     "got 5 of them; allowed for rational_polynomial: 8"),
    ("camera_matrix:", "camera_matrices:", "camera_matrix: is missing .or K, k.; the file has"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), EYE_FAULTS)
def test_a_fault_of_an_eye_is_named(old: str, new: str, message: str, tmp_path: Path) -> None:
    assert old in BY_HAND
    path = tmp_path / "left.yaml"
    path.write_text(BY_HAND.replace(old, new), encoding="utf-8")
    with pytest.raises(DescriptionError, match=message) as caught:
        load_camera(path)
    assert caught.value.file == str(path)


P_ZERO = "data: [663.774, 0, 320, 0, 0, 663.774"
PAIR_FAULTS = [
    (P_ZERO, "got P.0, 3. = 0, which is a baseline of 0; allowed: -fx . baseline of the right"),
    (P_ZERO.replace("320, 0,", "320, 3.3,"), "mm left of the left one; .* Are the eyes exchanged"),
    (P_ZERO.replace("320, 0,", "320, -3300,"), "baseline: got 49.* Is the calibration in another"),
    (P_ZERO.replace("663.774", "700", 1).replace("320, 0,", "320, -3,"), "the left eye's is 663"),
    (P_ZERO.replace("663.774, 0", "0, 0", 1), "focal length 0; allowed: above 0"),
]


@pytest.mark.parametrize(("p", "message"), PAIR_FAULTS)
def test_a_fault_of_a_pair_is_named(p: str, message: str, tmp_path: Path) -> None:
    files = pair(tmp_path, right=BY_HAND.replace(P_ZERO, p))
    with pytest.raises(DescriptionError, match=message) as caught:
        load_camera(files)
    assert str(files[1]) in caught.value.file


def test_exchanged_eyes_are_found(tmp_path: Path) -> None:
    left, right = pair(tmp_path)
    with pytest.raises(
        DescriptionError, match=r"left of the left one; .* name the other one first"
    ):
        load_camera([right, left])


def test_eyes_calibrated_under_exchanged_names_are_read_in_the_other_order(tmp_path: Path) -> None:
    left, right = pair(tmp_path, right=BY_HAND.replace("320, 0, 0", f"320, {663.774 * 5e-3}, 0"))
    with pytest.raises(DescriptionError, match="name the other one first"):
        load_camera([left, right])
    camera = load_stereo_camera([right, left])
    np.testing.assert_allclose(camera.T_left_right[:3, 3], [5e-3, 0.0, 0.0], atol=1e-15)
    first, second = camera_infos(camera)
    assert first.P[0, 3] == 0.0
    assert second.P[0, 3] == pytest.approx(-663.774 * 5e-3)


def test_two_files_of_one_eye_each_are_no_pair(tmp_path: Path) -> None:
    """Opposite of a right eye that is left out in silence."""
    eye = {"image_width": 640, "image_height": 480, "camera_matrix": K_LEFT.copy()}
    files = [opencv_file(tmp_path / f"{side}.yml", eye) for side in ("left", "right")]
    with pytest.raises(DescriptionError, match="nothing of the pose between the eyes"):
        load_camera(files)


def test_eyes_above_each_other_are_rejected(tmp_path: Path) -> None:
    text = BY_HAND.replace("0, 663.774, 240, 0,", "0, 663.774, 240, -3.3,").replace(
        "320, 0,", "320, -0.001,"
    )
    with pytest.raises(DescriptionError, match="the eyes lie above each other"):
        load_camera(pair(tmp_path, right=text))


def test_a_matrix_that_is_no_rotation_is_rejected(tmp_path: Path) -> None:
    text = BY_HAND.replace("  data:\n  - 1\n", "  data:\n  - 1.5\n")
    with pytest.raises(DescriptionError, match=r"rectification_matrix: got .* a rotation matrix"):
        load_camera(pair(tmp_path, left=text))
    inside, outside = stereo_entries()
    outside["R"] = np.diag([1.0, 1.0, -1.0])
    sized = {"image_width": 640, "image_height": 480, **inside, **outside}
    with pytest.raises(DescriptionError, match=r"R: got .* a rotation matrix"):
        load_camera(opencv_file(tmp_path / "mirror.yml", sized))


def test_one_file_of_each_is_no_pair(tmp_path: Path) -> None:
    left, _ = pair(tmp_path)
    (other,) = write_camera(crooked(), [tmp_path / "scope.yml"], "opencv")
    with pytest.raises(DescriptionError, match="one is ROS's and one is OpenCV's"):
        load_camera([left, other])


NO_YAML = [
    ("", "is empty"),
    ("just words", "got 'just words'; allowed: keys with values"),
    ("a: [1, 2", "line 1: is not YAML: expected ',' or ']'"),
    ("a: 'b", "line 1: is not YAML: found unexpected end of stream"),
    ("a: 1\na: 2", "line 2: is not YAML: has 'a' a second time"),
    ("a: {b: 1, b: 2}", "line 1: is not YAML: has 'b' a second time"),
    ("a: 1\n  b: 2", "line 2: is not YAML: mapping values are not allowed here"),
    ("  a: 1\nb: 2", "line 2: is not YAML: expected '<document start>'"),
    ("a:\n\t- 1", "line 2: is not YAML: found character '.t' that cannot start any token"),
    ("a: [1 2] 3", "line 1: is not YAML: expected <block end>"),
    ("a: \0", "is not YAML: unacceptable character"),
    ("a: 2030-13-01", "is not YAML: month must be in 1..12"),
    ("%YAML:1.0\n---\na: !!python/name:os.system 1", "line 3: is not YAML: could not determine"),
]


@pytest.mark.parametrize(("text", "message"), NO_YAML)
def test_what_is_no_yaml_is_rejected_with_its_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "left.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError, match=message):
        load_camera(path)


def test_files_that_are_not_there_or_something_else_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"none.yaml: cannot be read"):
        load_camera(tmp_path / "none.yaml")
    with pytest.raises(DescriptionError, match=r"scope.npz: is no calibration; allowed: .toml, "):
        load_camera(tmp_path / "scope.npz")
    with pytest.raises(InputError, match="got 3 files; allowed: one, or left and right"):
        load_camera(["a.yaml", "b.yaml", "c.yaml"])


def test_what_cannot_be_written_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="got 1 files; ros needs 2 here"):
        write_camera(crooked(), [tmp_path / "one.yaml"])
    with pytest.raises(InputError, match=r"left.yaml: cannot be written"):
        write_camera(crooked(), [tmp_path / "no" / "left.yaml", tmp_path / "right.yaml"])
