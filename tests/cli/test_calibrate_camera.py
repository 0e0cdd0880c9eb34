"""`trocar views` and `trocar calibrate camera`: from views to a rig that stands as measured."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from trocar.cameras import StereoCalibration, read_calibration
from trocar.cli import main
from trocar.descriptions import load_rig
from trocar.descriptions.overlay import overlay_text, parse_overlay, read_overlay
from trocar.descriptions.rig_frames import Places
from trocar.geometry import inverse
from trocar.kinematics import pose


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with views, truth, and the overlay of a calibration."""
    folder = tmp_path_factory.mktemp("eye") / "views"
    assert main(["views", "-o", str(folder), "--count", "12", "--seed", "7"]) == 0
    words = ["calibrate", "camera", str(folder / "views.toml"), "-o", str(folder / "eye.toml")]
    ros = [str(folder / "left.yaml"), str(folder / "right.yaml")]
    assert main([*words, "--ros", *ros]) == 0
    return folder


def test_the_overlay_puts_camera_and_base_where_the_robot_has_them(calibrated: Path) -> None:
    truth = json.loads((calibrated / "truth.json").read_text())
    rig = load_rig("two_psm_ecm", str(calibrated / "eye.toml"))
    start = rig.poses["start"]
    places = Places(rig, lambda name: start[name])
    base = inverse(places.reference_pose("ECM")) @ places.reference_pose("PSM1")
    np.testing.assert_allclose(base, truth["T_ECM_PSM1"], atol=2e-3)
    (camera,) = (c for c in rig.cameras if c.kind == "endoscope")
    assert isinstance(camera.calibration, StereoCalibration)
    mechanism = rig.arm("ECM").arm.mechanism
    q = np.zeros(len(mechanism.joints))
    at_frame = pose(mechanism, q, camera.frame)
    left = inverse(pose(mechanism, q)) @ at_frame @ camera.pose @ camera.calibration.mounts[0]
    np.testing.assert_allclose(left, truth["T_ECM_left"], atol=5e-3)
    np.testing.assert_allclose(left[:3, 3], np.array(truth["T_ECM_left"])[:3, 3], atol=5e-4)
    np.testing.assert_allclose(camera.calibration.left.K, truth["eyes"]["left"]["K"], atol=8.0)


def test_other_arms_stand_where_they_stood(calibrated: Path) -> None:
    nominal = load_rig("two_psm_ecm")
    rig = load_rig("two_psm_ecm", str(calibrated / "eye.toml"))
    for name in ("ECM", "PSM2"):
        np.testing.assert_array_equal(rig.arm(name).pose, nominal.arm(name).pose)
    assert not np.allclose(rig.arm("PSM1").pose, nominal.arm("PSM1").pose, atol=1e-4)


def test_an_arm_on_setup_joints_is_placed_by_its_mount(calibrated: Path) -> None:
    rig = load_rig("full_cart", ["ECM=" + str(calibrated / "eye.toml")])
    start = rig.poses["start"]
    places = Places(rig, lambda name: start[name])
    base = inverse(places.reference_pose("ECM")) @ places.reference_pose("PSM1")
    expected = read_overlay(calibrated / "eye.toml").bases["PSM1"].xyz
    np.testing.assert_allclose(base[:3, 3], expected, atol=1e-9)


def test_the_overlay_comes_back_as_it_was_written(calibrated: Path) -> None:
    overlay = read_overlay(calibrated / "eye.toml")
    assert overlay_text(parse_overlay(overlay_text(overlay), "again")) == overlay_text(overlay)


def test_an_overlay_with_a_camera_joins_one_with_geometry(calibrated: Path, tmp_path: Path) -> None:
    geometry = tmp_path / "geometry.toml"
    geometry.write_text(
        'schema = 1\narm = "ecm"\n[frames.yaw]\nxyz_m = [0, 0, 0]\nrpy_rad = [0, 0, 0]\n'
    )
    eye = str(calibrated / "eye.toml")
    from trocar.descriptions.calibrated import combined

    both = combined(read_overlay(geometry), read_overlay(eye))
    assert both.frames and both.camera is not None and both.bases
    assert main(["sim", "--rig", "two_psm_ecm", "--headless", "--duration", "0.01",
                 "--calibration", eye, "--calibration", eye]) == 2  # fmt: skip


def test_a_camera_belongs_to_an_ecm(
    calibrated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "psm_eye.toml"
    wrong.write_text((calibrated / "eye.toml").read_text().replace('arm = "ecm"', 'arm = "psm"'))
    assert main(["show", "psm", "--calibration", str(wrong)]) == 2
    assert "allowed: an ECM" in capsys.readouterr().err


def test_camera_info_of_ros_has_the_calibration(calibrated: Path) -> None:
    read = read_calibration([calibrated / "left.yaml", calibrated / "right.yaml"])
    camera = read_overlay(calibrated / "eye.toml").camera
    assert camera is not None and isinstance(read, StereoCalibration)
    np.testing.assert_allclose(read.left.K, camera.calibration.left.K)
    np.testing.assert_allclose(read.T_left_right, camera.calibration.T_left_right, atol=1e-9)


def test_json_is_one_document_with_standard_deviations(
    calibrated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["calibrate-camera", str(calibrated / "views.toml"), "--offsets", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found["T_ECM_camera"]["xyz_sigma_m"]) == 3
    assert np.shape(found["bases"]["T_ECM_PSM1"]["covariance"]) == (6, 6)
    assert set(found["offsets"]["PSM1"]["pitch"]) == {"value", "sigma"}
    assert found["residuals"]["corner_rms_px"] == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["views", "-o", "{}", "--count", "0"], "1 to 1000 views"),
        (["views", "-o", "{}", "--psm", "PSM9"], "PSM9"),
        (["views", "-o", "{}", "--psm", "ECM"], "allowed: a PSM"),
        (["views", "-o", "{}", "--rig", "psm"], "endoscope"),
        (["views", "-o", "{}", "--corner-noise-px", "-1"], "0 to 10 px"),
        (["views", "-o", "{}", "--seed", "-1"], "0 or more"),
        (["views", "-o", "{}", "--pictures", "--corner-noise-px", "0.1"], "without --pictures"),
        (["calibrate", "camera", "{}/none.toml"], "cannot be read"),
        (["calibrate", "camera", "{}/none.toml", "--joint-noise-deg", "x"], "allowed: a number"),
    ],
)
def test_bad_input_ends_with_two(
    words: list[str], problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([word.format(tmp_path / "out") for word in words]) == 2
    assert problem in capsys.readouterr().err
