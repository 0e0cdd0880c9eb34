"""A rig's cameras stand where its file says, and each mistake in one is named."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from trocar.cameras import MonoCalibration, write_camera
from trocar.descriptions import RigDescription, load_rig, names
from trocar.descriptions.cameras import load_stereo_camera
from trocar.descriptions.catalogue import DATA
from trocar.errors import DescriptionError

SCOPE = '[[camera]]\nname = "scope"\nkind = "endoscope"\n'
VIEW = '[[camera]]\nname = "wall"\nkind = "view"\nsize_px = [640, 480]\nfov_deg = 60\n'


def rig_file(folder: Path, cameras: str, name: str = "two_psm_ecm") -> Path:
    path = folder / "rig.toml"
    rig = (DATA / "rigs" / f"{name}.toml").read_text(encoding="utf-8")
    path.write_text(f"{rig.partition('[[camera]]')[0]}\n{cameras}", encoding="utf-8")
    return path


def rig(folder: Path, cameras: str) -> RigDescription:
    return load_rig(rig_file(folder, cameras))


@pytest.mark.parametrize("name", names("rigs"))
def test_every_rig_with_an_ecm_has_an_endoscope(name: str) -> None:
    found = load_rig(name)
    scopes = [arm.name for arm in found.arms if arm.arm.type == "ECM"]
    cameras = {camera.name: camera for camera in found.cameras}
    assert ("endoscope" in cameras) == bool(scopes)
    assert ("room" in cameras) == (name.startswith("full_cart") or name.endswith("_si"))
    for camera in cameras.values():
        assert camera.source
    if scopes:
        scope = cameras["endoscope"]
        assert (scope.kind, scope.arm) == ("endoscope", scopes[0])
        assert scope.calibration.baseline > 0.0


def test_what_is_left_out_of_an_endoscope_comes_from_the_rig(tmp_path: Path) -> None:
    (scope,) = rig(tmp_path, SCOPE + 'preset = "dvrk_sd_640x480"').cameras
    assert (scope.arm, scope.angle) == ("ECM", 0.0)
    assert scope.calibration.name == "dvrk_sd_640x480"
    (bent,) = rig(tmp_path, SCOPE + 'preset = "hd_1280x720"\nangle_deg = -30').cameras
    assert bent.angle == -np.pi / 6


def test_a_calibration_lies_beside_the_rig(tmp_path: Path) -> None:
    camera = load_stereo_camera("icra2026_1280x800")
    write_camera(camera, [tmp_path / "left.yaml", tmp_path / "right.yaml"])
    write_camera(camera, [tmp_path / "both.yml"], "opencv")
    for entry in ('["left.yaml", "right.yaml"]', '"both.yml"'):
        (scope,) = rig(tmp_path, SCOPE + f"calibration = {entry}").cameras
        assert scope.calibration.baseline == pytest.approx(0.02)


def test_a_view_looks_at_what_it_is_told(tmp_path: Path) -> None:
    at, target = np.array([1.0, -0.5, 0.8]), np.array([0.1, 0.2, 0.1])
    text = VIEW + f"xyz_m = {at.tolist()}\nlook_at_m = {target.tolist()}"
    (wall,) = rig(tmp_path, text).cameras
    ahead = (target - at) / np.linalg.norm(target - at)
    np.testing.assert_allclose(wall.pose[:3, 3], at)
    np.testing.assert_allclose(wall.pose[:3, 2], ahead)
    assert wall.pose[2, 0] == pytest.approx(0.0) and wall.pose[2, 1] < 0.0  # level, not on its head
    assert np.linalg.det(wall.pose[:3, :3]) == pytest.approx(1.0)
    assert isinstance(wall.calibration, MonoCalibration)
    assert np.degrees(wall.calibration.eye.fov[0]) == pytest.approx(60.0)


def test_a_view_from_above_has_the_worlds_y_up(tmp_path: Path) -> None:
    (top,) = rig(tmp_path, VIEW + "xyz_m = [0, 0, 2]\nlook_at_m = [0, 0, 0]").cameras
    np.testing.assert_allclose(top.pose[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-15)


def test_a_view_may_ride_on_a_link_and_be_turned_by_hand(tmp_path: Path) -> None:
    text = VIEW + 'arm = "PSM1"\nframe = "insertion"\nxyz_mm = [0, 50, 0]\nrpy_deg = [0, 0, 90]'
    (wrist,) = rig(tmp_path, text).cameras
    assert (wrist.arm, wrist.frame) == ("PSM1", "insertion")
    np.testing.assert_allclose(wrist.pose[:3, 1], [-1.0, 0.0, 0.0], atol=1e-15)
    (tip,) = rig(tmp_path, VIEW + 'arm = "PSM2"').cameras
    assert tip.frame == "tip"
    (preset,) = rig(tmp_path, VIEW.partition("size_px")[0] + 'preset = "hd_1280x720"').cameras
    assert preset.calibration.baseline > 0.0


PRESET = 'preset = "hd_1280x720"\n'
FAULTS = [
    (SCOPE, "preset", "is missing; allowed keys: preset, calibration"),
    (SCOPE + 'preset = "hd"', "preset", "unknown camera preset 'hd'; known: dvrk_sd_640x480, hd_"),
    (SCOPE + PRESET + 'calibration = "x.yaml"', "calibration", "contradicts preset"),
    (SCOPE + 'calibration = "x.yaml"', "calibration", "x.yaml: cannot be read"),
    (SCOPE + "calibration = 3", "calibration", "got 3; allowed: a list of texts"),
    (SCOPE + 'calibration = ["a.yaml", "b.yaml", "c.yaml"]', "calibration", "got 3 files"),
    (SCOPE + PRESET + "angle_deg = 45", "angle", "got 45 deg; allowed: -30, 0, 30 deg"),
    (SCOPE + PRESET + 'arm = "PSM1"', "arm", "got 'PSM1'; allowed: an ECM of this rig: ECM"),
    (SCOPE + PRESET + "fov_deg = 60", "fov_deg", "unknown key; this table knows: angle_deg"),
    (SCOPE + PRESET + "xyz_mm = [0, 0, 1]", "xyz_mm", "unknown key"),
    ('[[camera]]\nname = "a"\nkind = "eye"', "kind", "got 'eye'; allowed: endoscope, view"),
    ('[[camera]]\nname = ""\nkind = "view"', "name", "got an empty text; allowed: a name"),
    ('[[camera]]\nkind = "view"', "name", "is missing"),
    (
        VIEW + 'arm = "PSM7"',
        "arm",
        "got 'PSM7'; this rig has no such arm; allowed: PSM1, PSM2, ECM",
    ),
    (
        VIEW + 'arm = "PSM1"\nframe = "hand"',
        "frame",
        "got 'hand'; PSM1 has no such frame; allowed:",
    ),
    (VIEW + 'frame = "hand"', "frame", "needs arm = NAME, whose frame it is"),
    (VIEW + "look_at_m = [0, 0, 0]", "look_at", "is where the camera stands; allowed: another"),
    (VIEW + "look_at_m = [1, 0, 0]\nrpy_deg = [0, 0, 0]", "look_at", "contradicts rpy or rotation"),
    (VIEW + "angle_deg = 30", "angle_deg", "unknown key"),
    (VIEW + PRESET, "size_px", "contradicts preset; give one of them"),
    (VIEW.replace("fov_deg = 60\n", ""), "fov", "is missing; allowed keys: fov_rad, fov_deg"),
    (VIEW.partition("size_px")[0], "preset", "is missing; allowed keys: preset, calibration, size"),
]


@pytest.mark.parametrize(("text", "key", "message"), FAULTS)
def test_a_fault_in_a_camera_is_named(text: str, key: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError) as caught:
        rig(tmp_path, text)
    assert caught.value.file == str(tmp_path / "rig.toml")
    assert caught.value.key == f"camera[0].{key}"
    assert message in str(caught.value)


def test_an_endoscope_has_two_eyes(tmp_path: Path) -> None:
    camera = MonoCalibration(load_stereo_camera("hd_1280x720").left)
    write_camera(camera, [tmp_path / "left.yaml"])
    with pytest.raises(DescriptionError, match="is the calibration of one eye; an endoscope has"):
        rig(tmp_path, SCOPE + 'calibration = "left.yaml"')


def test_a_rig_without_an_ecm_has_no_scope(tmp_path: Path) -> None:
    text = SCOPE + PRESET + 'arm = "ECM"'
    with pytest.raises(DescriptionError, match=r"camera\[0\].arm: got 'ECM'; .* it has none"):
        load_rig(rig_file(tmp_path, text, "psm"))


def test_names_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"camera\[1\].name: got 'wall' a second time"):
        rig(tmp_path, VIEW + VIEW)


def test_the_cameras_that_the_page_shows_can_be_read(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "descriptions.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```toml\n(\[\[camera\]\]\n.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert len(blocks) == 2
    camera = load_stereo_camera("hd_1280x720")
    write_camera(camera, [tmp_path / "left.yaml", tmp_path / "right.yaml"])
    wrist, scope = rig(tmp_path, "".join(blocks)).cameras
    assert (wrist.name, wrist.frame) == ("wrist", "insertion")
    assert scope.calibration.baseline == camera.baseline
