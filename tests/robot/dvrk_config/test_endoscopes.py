"""An ECM's endoscope has the tip, the weight and the picture that the dVRK gives it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.robot.dvrk_config import configurations as lab
from trocar.errors import DescriptionError
from trocar.kinematics.forward import pose
from trocar.kinematics.inverse import inverse_kinematics
from trocar.robot.dvrk_config import ImportedRig, RigImportOptions, import_dvrk
from trocar.robot.dvrk_config.agreement import agreement
from trocar.robot.dvrk_config.system import read_system
from trocar.simulation import World

#: {endoscope: (tip past the last row [m], turn about x [deg], mass [kg])}. Source: SAW@9e535e6
#: mtsIntuitiveResearchKitECM.cpp, set_endoscope_type; mtsIntuitiveResearchKit.h.
SCOPES = {
    "NONE": (0.0, 0, 0.1),
    "Classic_SD_STRAIGHT": (0.0, 0, 1.5),
    "Classic_HD_UP": (0.0, -30, 2.5),
    "Si_HD_DOWN": (0.0, 30, 1.8),
    "Custom_STRAIGHT": (0.18, 0, 0.8),
    "Custom_UP": (0.18, -30, 0.8),
}


def tip_of(scope: str) -> np.ndarray:
    """Return the tip in the last row, (4, 4): ToolOffsetTransformation."""
    reach, degrees, _ = SCOPES[scope]
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    at = np.array(lab.SCOPE_TIP)
    at[2, 3] = reach
    return at @ np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def one(folder: Path, **ecm: str) -> Path:
    """Write a system of one ECM."""
    arm = {"kinematic": "kinematic/ECM.json", "generation": "Classic", **ecm}
    rows = {"DH": {"convention": "modified", "links": lab.ECM}}
    system = {"arms": [{"name": "ECM", "type": "ECM", "arm_file": "ecm.json"}]}
    files = {"system-lab.json": system, "ecm.json": arm, "kinematic/ECM.json": rows}
    return lab.write(folder, files)


def imported(folder: Path, scope: str) -> ImportedRig:
    return import_dvrk(one(folder / "in", endoscope=scope), folder / "rig.toml")


@pytest.mark.parametrize("scope", SCOPES)
def test_the_tip_is_where_the_dvrk_has_it_and_is_reached_again(tmp_path: Path, scope: str) -> None:
    arm = imported(tmp_path, scope).rig.arm("ECM").arm
    mechanism = arm.mechanism
    middle, half = (
        0.5 * (mechanism.lower + mechanism.upper),
        0.5 * np.ptp([mechanism.lower, mechanism.upper], axis=0),
    )
    for q in np.random.default_rng(2).uniform(middle - 0.9 * half, middle + 0.9 * half, (5, 4)):
        tip = lab.chain(lab.ECM, q) @ tip_of(scope)
        np.testing.assert_allclose(pose(mechanism, q), tip, atol=1e-9)
        found = inverse_kinematics(mechanism, arm.inverse_kinematics, tip, q)
        np.testing.assert_allclose(found[0], q, atol=1e-6)
    (roll,) = (body for body in arm.bodies if body.frame == "roll")
    assert roll.mass == SCOPES[scope][2]


def test_a_published_ecm_stays_trocar_s_own(tmp_path: Path) -> None:
    assert len(imported(tmp_path, "Classic_SD_STRAIGHT").files) == 1


@pytest.mark.parametrize("scope", ["Custom_STRAIGHT", "Classic_HD_UP", "Si_HD_DOWN"])
def test_the_camera_looks_out_of_the_tip(tmp_path: Path, scope: str) -> None:
    world = World(imported(tmp_path, scope).rig)
    camera = world.camera("endoscope").T_world_camera
    tip = world.reference_pose("ECM") @ world.arm("ECM").local.measured_cp().matrix
    np.testing.assert_allclose(camera[:3, 3], tip[:3, 3], atol=1e-9)
    np.testing.assert_allclose(camera[:3, :2], -tip[:3, :2], atol=1e-9)  # right and down: -x, -y
    np.testing.assert_allclose(camera[:3, 2], tip[:3, 2], atol=1e-9)


def test_arms_beside_a_bent_scope_are_seen_from_its_tip(tmp_path: Path) -> None:
    scope = {"kinematic": "kinematic/ECM.json", "endoscope": "Custom_UP"}
    path = lab.lab(tmp_path / "in", files={"arm/ECM_KIN_SIMULATED_STRAIGHT.json": scope})
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert max(max(gap.metres, gap.radians) for gap in found.agreement.values()) < 1e-5
    world = World(found.rig)
    q = {name: arm.joints.readings()[0] for name, arm in world.arms.items()}
    setups = {setup["name"]: setup for setup in lab.CLASSIC}
    row = lab.base(setups["ECM"], q["SUJ_ECM"]) @ lab.chain(lab.ECM, q["ECM"])
    tip = lab.chain([*lab.PSM, *lab.TOOL["Classic"]], q["PSM1"][:6]) @ lab.TOOLTIP
    expected = (
        np.linalg.inv(row @ tip_of("Custom_UP")) @ lab.base(setups["PSM1"], q["SUJ_PSM1"]) @ tip
    )
    np.testing.assert_allclose(world.arm("PSM1").measured_cp().matrix, expected, atol=1e-6)


def test_the_comparison_sees_a_tip_that_is_not_the_endoscope_s(tmp_path: Path) -> None:
    """As trocar once imported them: the arm straight and short, the camera bent."""
    path = one(tmp_path / "in", endoscope="Custom_UP")
    right = import_dvrk(path, tmp_path / "a.toml").rig
    straight = imported(tmp_path / "other", "NONE").rig
    wrong = replace(right, arms=straight.arms)
    gap = agreement(read_system(path), wrong)
    assert gap["tips"].metres == pytest.approx(0.18)
    assert gap["tips"].radians == pytest.approx(np.radians(30.0))
    assert max(gap["cameras"].metres, gap["cameras"].radians) < 1e-9
    assert gap["chains"].metres < 1e-9
    blind = agreement(read_system(path), replace(right, cameras=straight.cameras))
    assert blind["cameras"].radians == pytest.approx(np.radians(30.0))
    assert blind["tips"].radians < 1e-9


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({}, r"ecm.json: endoscope: is missing; allowed: NONE, Classic_SD_STRAIGHT, Classic_SD_UP"),
        ({"endoscope": "WIDE"}, r"ecm.json: endoscope: got 'WIDE'; allowed: NONE, .*Custom_DOWN"),
    ],
)
def test_an_ecm_without_an_endoscope_is_refused_as_by_the_dvrk(
    tmp_path: Path, given: dict[str, str], problem: str
) -> None:
    with pytest.raises(DescriptionError, match=problem):
        import_dvrk(one(tmp_path, **given), tmp_path / "rig.toml")
    assert not (tmp_path / "rig.toml").exists()


@pytest.mark.parametrize(
    ("older", "now"), [("HD_DOWN", "Classic_HD_DOWN"), ("UP", "Classic_SD_UP")]
)
def test_older_names_are_read_and_said(tmp_path: Path, older: str, now: str) -> None:
    found = imported(tmp_path, older)
    assert f"ECM: endoscope {older!r} is taken as {now}" in found.notes
    newer = import_dvrk(
        one(tmp_path, endoscope=now), tmp_path / "rig.toml", RigImportOptions(overwrite=True)
    )
    assert newer.agreement["tips"] == found.agreement["tips"]
    assert newer.rig.cameras[0].angle == found.rig.cameras[0].angle
