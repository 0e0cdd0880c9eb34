"""Calibrations in OpenCV's XML and ROS's INI hold the same as YAML; doubtful keys are named."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.cameras.test_calibration_files import BY_HAND, MESSAGE, assert_same, crooked
from trocar.cameras import (
    CameraInfo,
    Intrinsics,
    MonoCalibration,
    StereoCalibration,
    camera_infos,
    write_camera,
)
from trocar.descriptions.cameras import load_camera, load_stereo_camera
from trocar.errors import DescriptionError


def xml(entries: Mapping[str, object]) -> str:
    """Return a text like those of OpenCV's FileStorage."""
    lines = ['<?xml version="1.0"?>', "<opencv_storage>", "<!-- flags: 0 -->"]
    for key, value in entries.items():
        if isinstance(value, np.ndarray):
            rows, cols = value.shape
            data = " ".join(repr(float(v)) for v in value.ravel())
            lines.append(
                f'<{key} type_id="opencv-matrix">\n  <rows>{rows}</rows>\n  <cols>{cols}</cols>\n'
                f"  <dt>d</dt>\n  <data>\n    {data}</data></{key}>"
            )
        else:
            lines.append(f"<{key}>{value}</{key}>")
    return "\n".join([*lines, "</opencv_storage>"])


def ini(info: CameraInfo, name: str) -> str:
    """Return a text like those of ROS's camera_calibration, with all digits."""
    parts = {"camera matrix": info.K, "distortion": info.D[None], "rectification": info.R}
    text = f"# oST version 5.0 parameters\n\n[image]\n\nwidth\n{info.width}\n\nheight\n"
    text += f"{info.height}\n\n[{name}]\n"
    for key, matrix in {**parts, "projection": info.P}.items():
        rows = "\n".join(" ".join(repr(float(v)) for v in row) for row in matrix)
        text += f"\n{key}\n{rows}\n"
    return text


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_xml_of_opencv_holds_what_its_yaml_holds(tmp_path: Path) -> None:
    camera = crooked()
    T = np.linalg.inv(camera.T_left_right)
    both = {
        "image_width": 640,
        "image_height": 480,
        "M1": camera.left.K,
        "D1": camera.left.distortion[None],
        "M2": camera.right.K,
        "D2": camera.right.distortion[None],
        "R": T[:3, :3],
        "T": T[:3, 3:],
    }
    assert_same(load_stereo_camera(written(tmp_path / "scope.xml", xml(both))), camera, 1e-12)


def test_xml_of_opencvs_tutorial_is_read_with_its_capitals(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    eye = crooked().left
    entries = {
        "calibration_Time": '"Tue Jan  1 10:00:00 2030"',
        "nrOfFrames": 10,
        "image_Width": 640,
        "image_Height": 480,
        "flagValue": 8,
        "Camera_Matrix": eye.K,
        "Distortion_Coefficients": eye.distortion[:, None],
        "Avg_Reprojection_Error": 0.28,
    }
    found = load_camera(written(tmp_path / "camera.xml", xml(entries)))
    assert isinstance(found, MonoCalibration)
    np.testing.assert_array_equal(found.eye.K, eye.K)
    np.testing.assert_array_equal(found.eye.distortion, eye.distortion)
    assert not caplog.records


def test_ini_of_ros_is_read_of_one_eye_and_of_two(tmp_path: Path) -> None:
    turned = StereoCalibration(
        crooked().left, Intrinsics(640, 480, crooked().right.K, crooked().left.distortion),
        crooked().T_left_right,
    )  # fmt: skip
    infos = camera_infos(turned)
    files = write_camera(turned, [tmp_path / "left.yaml", tmp_path / "right.yaml"])
    sides = zip(infos, ("left", "right"), strict=True)
    texts = [ini(info, f"narrow_stereo/{side}") for info, side in sides]
    found = load_stereo_camera(written(tmp_path / "ost.txt", "\n".join(texts)))
    assert_same(found, load_stereo_camera(files))
    one = load_camera(written(tmp_path / "ost.ini", texts[0]))
    assert isinstance(one, MonoCalibration)
    np.testing.assert_array_equal(one.eye.K, turned.left.K)


@pytest.mark.parametrize("text", [BY_HAND, MESSAGE])
def test_a_missing_list_of_coefficients_beside_a_model_is_an_error(
    text: str, tmp_path: Path
) -> None:
    kept = [t for t in text.splitlines() if not t.startswith(("distortion_coef", "D:"))]
    path = written(tmp_path / "left.yaml", "\n".join(kept))
    said = r"distortion_coefficients: is missing, which distortion_model 'plumb_bob' needs .or D, d"
    with pytest.raises(DescriptionError, match=said):
        load_camera(path)


def test_a_misspelled_list_of_coefficients_is_named(tmp_path: Path) -> None:
    text = BY_HAND.replace("distortion_coefficients", "distortion_coefficents")
    with pytest.raises(DescriptionError, match="is 'distortion_coefficents' misspelled"):
        load_camera(written(tmp_path / "left.yaml", text))
    kept = "\n".join(t for t in text.splitlines() if not t.startswith("distortion_model"))
    with pytest.raises(DescriptionError, match="is 'distortion_coefficents' misspelled"):
        load_camera(written(tmp_path / "left.yaml", kept))


def test_no_distortion_at_all_and_unknown_keys_warn(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    entries = {"image_width": 640, "image_height": 480, "camera_matrix": crooked().left.K}
    with caplog.at_level(logging.WARNING, "trocar"):
        load_camera(written(tmp_path / "camera.xml", xml({**entries, "laser_plane": 3})))
    said = [record.getMessage().partition("camera.xml: ")[2] for record in caplog.records]
    assert said == [
        "unknown key, ignored: laser_plane",
        "has no distortion_coefficients: taken as a lens without distortion",
    ]
    caplog.clear()
    path = written(tmp_path / "left.yaml", BY_HAND + "distortion_modle: plumb_bob\n")
    load_camera(path)
    assert "distortion_modle (did you mean distortion_model?)" in caplog.text


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.xml", "<opencv_storage><K>", "line 1: is not XML: no element found"),
        ("a.xml", "<robot/>", "has the root <robot>; allowed: <opencv_storage>"),
        ("a.xml", "<opencv_storage/>", "is empty; allowed"),
        ("a.xml", "<!DOCTYPE a [<!ENTITY b 'c'>]><opencv_storage/>", "has a <!DOCTYPE>"),
        ("a.xml", xml({"image_width": 640, "image_height": 480}), "camera_matrix: is missing"),
        ("a.ini", "", "is empty"),
        ("a.ini", "[image]\nwidth\n640 px", "line 3: got '640 px'; allowed: .section., a key"),
        ("a.ini", "[image]\nwidth\n640\nheight\n480\n[eye]\n", "camera_matrix: is missing"),
        ("a.txt", "hello world", "line 1: got 'hello world'"),
    ],
)
def test_what_is_no_calibration_is_rejected(
    name: str, text: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(DescriptionError, match=said):
        load_camera(written(tmp_path / name, text))


def test_three_cameras_are_too_many(tmp_path: Path) -> None:
    text = "\n".join(ini(camera_infos(crooked())[0], f"eye{k}") for k in range(3))
    with pytest.raises(DescriptionError, match="have 3 cameras; allowed: one or two"):
        load_camera(written(tmp_path / "ost.txt", text))
