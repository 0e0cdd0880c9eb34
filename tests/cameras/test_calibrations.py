"""Calibrations are checked as they are made, and each that no camera has is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trocar.cameras import Intrinsics, MonoCalibration, StereoCalibration, camera_infos, rectified
from trocar.cameras.lens import distort, pixels_from_plane, project
from trocar.descriptions.cameras import load_camera, load_stereo_camera, presets
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import transform, transform_points, translation

BARREL = (-0.33, 0.12, 0.002, -0.001, 0.01)


def matrix(fx: float = 600.0, fy: float = 600.0, cx: float = 319.5, cy: float = 239.5):
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


EYE = Intrinsics(640, 480, matrix(), np.array(BARREL))


def crooked() -> StereoCalibration:
    """Two eyes that differ in everything, as a real scope's do."""
    turn = matrix_from_rotation_vector(np.array([0.01, -0.03, 0.02]))
    right = Intrinsics(640, 480, matrix(610.0, 605.0, 330.0, 250.0), np.array([-0.3, 0.1, 0, 0]))
    return StereoCalibration(EYE, right, transform(turn, [5.2e-3, 0.1e-3, -0.2e-3]))


# ------------------------------------------------------------------ presets


def test_the_presets_are_those_that_people_ask_for() -> None:
    assert set(presets()) == {
        "dvrk_sd_640x480",
        "hd_1280x720",
        "hd_1920x1080",
        "icra2026_1280x800",
    }


@pytest.mark.parametrize("name", presets())
def test_a_preset_has_its_size_in_its_name_and_says_where_it_is_from(name: str) -> None:
    camera = load_stereo_camera(name)
    size = "x".join(str(n) for n in camera.left.size)
    assert name.endswith(size) and camera.name == name
    assert camera.source and camera.title
    assert camera.right.size == camera.left.size


# Source: the table of endoscopes: dvrk_simulator_base, dvrk_env's ecm.sdf, WPI's camera_info.
PUBLISHED = {
    "hd_1280x720": (60.0, 6.0),
    "hd_1920x1080": (60.0, 6.0),
    "icra2026_1280x800": (80.0, 20.0),
}


@pytest.mark.parametrize(("name", "numbers"), PUBLISHED.items(), ids=PUBLISHED)
def test_a_preset_has_the_published_numbers(name: str, numbers: tuple[float, float]) -> None:
    camera = load_stereo_camera(name)
    across, down = np.degrees(camera.left.fov)
    assert (across, 1e3 * camera.baseline) == pytest.approx(numbers)
    if name.startswith("icra"):
        assert down == pytest.approx(55.0, abs=0.5)


def test_the_classic_scope_is_the_one_that_was_calibrated() -> None:
    camera = load_stereo_camera("dvrk_sd_640x480")
    np.testing.assert_allclose(camera.left.K, matrix(588.776, 589.725, 325.305, 251.666))
    assert camera.baseline == pytest.approx(5.06e-3)


def test_an_unknown_preset_lists_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="unknown camera preset 'hd_720'") as caught:
        load_camera("hd_720")
    assert caught.value.known == presets()


# ------------------------------------------------------------------ what a calibration gives


def test_the_angle_of_view_is_that_of_the_whole_picture() -> None:
    f = 320.0 / np.tan(np.radians(30.0))
    eye = Intrinsics(640, 480, matrix(f, f))
    assert np.degrees(eye.fov[0]) == pytest.approx(60.0)


def test_arrays_are_copies_and_cannot_be_written() -> None:
    K = matrix()
    eye = Intrinsics(640, 480, K)
    K[0, 0] = 1.0
    assert eye.K[0, 0] == 600.0
    for array in (eye.K, eye.distortion, crooked().T_left_right):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_a_lens_has_the_model_that_it_needs() -> None:
    assert EYE.model == "plumb_bob" and EYE.distortion.shape == (5,)
    eye = replace(EYE, distortion=np.array([0.5, -0.3, 0.0, 0.0, 0.02, 0.7, -0.1, 0.03]))
    assert eye.model == "rational_polynomial" and eye.distortion.shape == (8,)
    assert not EYE.undistorted().distortion.any()
    assert not MonoCalibration(EYE).undistorted().eye.distortion.any()
    assert not any(eye.distortion.any() for eye in crooked().undistorted().eyes)
    plain = load_camera("hd_1280x720")
    assert plain.undistorted() is plain


def test_the_camera_lies_midway_between_its_eyes() -> None:
    camera = crooked()
    left, right = camera.mounts
    np.testing.assert_allclose(left[:3, 3], -right[:3, 3], atol=1e-15)
    np.testing.assert_allclose(left[:3, :3], right[:3, :3].T, atol=1e-15)
    np.testing.assert_allclose(np.linalg.inv(left) @ right, camera.T_left_right, atol=1e-15)


@pytest.mark.parametrize("size", [(320, 240), (1280, 960), (640, 240)])
def test_another_number_of_pixels_shows_the_same(size: tuple[int, int]) -> None:
    eye = Intrinsics(640, 480, matrix(cx=300.0, cy=250.0))
    other = eye.resized(*size)
    assert other.fov == pytest.approx(eye.fov)
    assert crooked().resized(*size).left.size == size
    assert MonoCalibration(eye).resized(*size).eye.size == size


# ------------------------------------------------------------------ rectification


def test_parallel_eyes_stay_as_they_are_and_the_right_p_carries_the_baseline() -> None:
    left, right = camera_infos(load_camera("hd_1280x720"))
    for info in (left, right):
        np.testing.assert_array_equal(info.R, np.eye(3))
        np.testing.assert_array_equal(info.P[:, :3], info.K)
    assert left.P[0, 3] == 0.0
    assert right.P[0, 3] == pytest.approx(-right.K[0, 0] * 6e-3)
    assert not right.P[1:, 3].any()


def test_rectified_eyes_see_a_point_in_one_row() -> None:
    camera, rng = crooked(), np.random.default_rng(3)
    points = rng.uniform([-0.03, -0.02, 0.08], [0.03, 0.02, 0.15], (50, 3))
    left, right = rectified(camera)
    seen = []
    for turn, p in (
        (left, points),
        (right, transform_points(np.linalg.inv(camera.T_left_right), points)),
    ):
        rays = p @ turn.R.T
        seen.append(project(rays, turn.P[:, :3]))
    np.testing.assert_allclose(seen[0][:, 1], seen[1][:, 1], atol=1e-9)
    # And P's fourth column is the step from one eye to the other.
    rays = np.concatenate([points @ left.R.T, np.ones((50, 1))], axis=1) @ right.P.T
    np.testing.assert_allclose(rays[:, :2] / rays[:, 2:], seen[1], atol=1e-9)


def test_the_turns_are_opencvs() -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is the judge here")
    camera = crooked()
    T_right_left = np.linalg.inv(camera.T_left_right)
    judged = cv2.stereoRectify(
        camera.left.K,
        camera.left.distortion,
        camera.right.K,
        camera.right.distortion,
        camera.left.size,
        T_right_left[:3, :3],
        T_right_left[:3, 3:],
    )
    left, right = rectified(camera)
    np.testing.assert_allclose(left.R, judged[0], atol=1e-9)
    np.testing.assert_allclose(right.R, judged[1], atol=1e-9)
    assert judged[3][0, 3] / judged[3][0, 0] == pytest.approx(-camera.baseline)
    # The focal length is a free choice; the middle of what is seen is not, to a few pixels.
    np.testing.assert_allclose(left.P[:2, 2], judged[2][:2, 2], atol=5.0)


def test_one_eye_is_rectified_already() -> None:
    (info,) = camera_infos(MonoCalibration(EYE))
    np.testing.assert_array_equal(info.P, np.concatenate([EYE.K, np.zeros((3, 1))], axis=1))
    assert info.distortion_model == "plumb_bob"


def test_a_point_lands_where_a_camera_info_says() -> None:
    """What a program does that has only the message: K and D, then R and P."""
    camera = crooked()
    point = np.array([0.01, -0.005, 0.1])
    info = camera_infos(camera)[0]
    pixel = pixels_from_plane(distort(point[:2] / point[2], info.D), info.K)
    np.testing.assert_allclose(pixel, project(point, camera.left.K, camera.left.distortion))


# ------------------------------------------------------------------ calibrations that nobody has

IMPOSSIBLE = [
    ({"K": matrix(fx=0.0)}, r"K: focal length fx = 0; allowed: above 0"),
    ({"K": matrix(fy=-600.0)}, r"K: focal length fy = -600; allowed: above 0"),
    ({"K": matrix(fy=150.0)}, r"fx = 600 and fy = 150 differ by 4; allowed: up to 2.5"),
    ({"K": np.eye(2)}, r"K: got .*; allowed: 3 x 3 finite numbers"),
    ({"K": np.full((3, 3), np.nan)}, r"K: got .*; allowed: 3 x 3 finite numbers"),
    ({"K": "none"}, r"K: got 'none'; allowed: 3 x 3 finite numbers"),
    ({"K": [[600, 1, 319.5], [0, 600, 239.5], [0, 0, 1]]}, r"allowed: \[\[fx, 0, cx\].*no skew"),
    ({"width": 1280, "height": 960}, r"cx = 319.5 does not match a width of 1280; allowed: 383.5 "),
    ({"height": 1080}, r"K: cy = 239.5 does not match a height of 1080; .* another size\?"),
    ({"width": 320, "height": 240}, r"K: cx = 319.5 does not match a width of 320"),
    ({"width": 0}, r"width: got 0; allowed: a whole number of pixels above 0"),
    ({"height": 480.0}, r"height: got 480.0; allowed: a whole number of pixels above 0"),
    ({"distortion": np.array([-2.0, 0, 0, 0])}, r"-2, 0, 0, 0, 0 folds the image inside the view"),
    ({"distortion": np.zeros(3)}, r"distortion: got 3 coefficients; allowed: none, 4, 5 or 8"),
    ({"distortion": np.full(5, np.inf)}, r"distortion: got .*; allowed: finite numbers"),
]


@pytest.mark.parametrize(("change", "message"), IMPOSSIBLE)
def test_an_eye_that_cannot_be_is_rejected(change: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(EYE, **change)


def test_where_the_image_folds_is_told() -> None:
    with pytest.raises(InputError, match=r"at pixel \(\d+, \d+\) of 640x480; allowed: one point"):
        replace(EYE, distortion=np.array([-0.9, 0.0, 0.0, 0.0]))


APART = [
    ([0.0, 0.0, 0.0], r"baseline: got 0: both eyes are in one place; allowed: 0.1 to 200 mm"),
    ([5.2, 0.0, 0.0], r"baseline: got 5200 mm; .* Is the calibration in another unit\?"),
    ([5e-6, 0.0, 0.0], r"baseline: got 0.005 mm; allowed: 0.1 to 200 mm"),
    ([-5e-3, 0.0, 0.0], r"the right eye is 5 mm left of the left one; .* exchanged\?"),
    ([1e-3, 5e-3, 0.0], r"the right eye is at \[1.0, 5.0, 0.0\] mm; allowed: mostly to the right"),
]


@pytest.mark.parametrize(("shift", "message"), APART)
def test_eyes_that_no_scope_has_are_rejected(shift: list[float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        StereoCalibration(EYE, EYE, translation(shift))


def test_eyes_with_pictures_of_two_sizes_are_rejected() -> None:
    with pytest.raises(InputError, match="is 640x480, the right one's 320x240; allowed: the same"):
        StereoCalibration(EYE, EYE.resized(320, 240), translation([5e-3, 0.0, 0.0]))


def test_eyes_that_look_apart_are_rejected() -> None:
    turn = matrix_from_rotation_vector(np.array([0.0, 1.0, 0.0]))
    with pytest.raises(InputError, match="the eyes look 57 deg apart; allowed: up to 45 deg"):
        StereoCalibration(EYE, EYE, transform(turn, [5e-3, 0.0, 0.0]))


# ------------------------------------------------------------------ one's own TOML

OWN = """
schema = 1
name = "mine"
title = "My scope"
source = "measured on a Tuesday"
size_px = [640, 480]
focal_px = [600.0, 600.0]
principal_px = [310.0, 250.0]
distortion = [-0.3, 0.1, 0.0, 0.0]
baseline_mm = 5.4
"""


def own(folder: Path, old: str = "", new: str = "") -> Path:
    path = folder / "mine.toml"
    path.write_text(OWN.replace(old, new) if old else OWN, encoding="utf-8")
    return path


def test_a_camera_of_ones_own_loads_by_its_path(tmp_path: Path) -> None:
    camera = load_stereo_camera(own(tmp_path))
    assert camera.name == "mine" and camera.baseline == pytest.approx(5.4e-3)
    np.testing.assert_array_equal(camera.right.K, matrix(cx=310.0, cy=250.0))
    np.testing.assert_array_equal(camera.right.distortion, [-0.3, 0.1, 0.0, 0.0, 0.0])
    alone = load_camera(str(own(tmp_path, "baseline_mm = 5.4", "")))
    assert isinstance(alone, MonoCalibration)


FAULTS = [
    ("schema = 1", "schema = 2", "schema: got 2; allowed: 1"),
    ('source = "measured on a Tuesday"', "", "source: is missing"),
    ("size_px = [640, 480]", "size_px = [640]", "size_px: got .*; allowed: a list of 2 numbers"),
    ("[640, 480]", "[640.5, 480]", "size_px: got .*; allowed: two whole numbers above 0"),
    ("focal_px = [600.0, 600.0]", "", "fov: is missing; allowed keys: fov_rad, fov_deg"),
    ("focal_px = [600.0, 600.0]", "fov_deg = 180", "fov: got 180 deg; allowed: above 0 to below"),
    ("[600.0, 600.0]", "[600.0, 600.0]\nfov_deg = 60", "focal_px: contradicts fov"),
    ("[600.0, 600.0]", "[-600.0, 600.0]", "K: focal length fx = -600; allowed: above 0"),
    ("baseline_mm = 5.4", "baseline_mm = 0", "baseline: got 0: both eyes are in one place"),
    ("baseline_mm = 5.4", "baseline = 5.4", "baseline: unknown key"),
    ("-0.3, 0.1", "-3.0, 0.1", "folds the image inside the view"),
]


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_a_fault_in_a_camera_is_named(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = own(tmp_path, old, new)
    with pytest.raises(DescriptionError, match=message) as caught:
        load_camera(path)
    assert caught.value.file == str(path)


def test_an_endoscope_needs_two_eyes(tmp_path: Path) -> None:
    path = own(tmp_path, "baseline_mm = 5.4", "")
    with pytest.raises(DescriptionError, match="is the calibration of one eye; an endoscope has"):
        load_stereo_camera(path)
