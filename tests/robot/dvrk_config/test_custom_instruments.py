"""Instruments of a lab's own, as the dVRK's manual describes them.

Source of the forms: dvrk.readthedocs.io, configuration, custom instruments: another control point,
no jaw, virtual joints at the end of the chain, an index of the lab's own.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.dvrk_config import configurations as lab
from tests.robot.dvrk_config.test_other_chains import instrument, with_tool
from trocar.errors import DescriptionError, UnknownNameError
from trocar.kinematics import inverse_kinematics
from trocar.kinematics.forward import pose
from trocar.robot.dvrk_config import ImportedRig, RigImportOptions, import_dvrk
from trocar.simulation import World

PROBE = "MY_PROBE:420901"
NO_JAW = {"qmin": 0.0, "qmax": 0.0, "ftmax": 0.0}


def probe(**more: Any) -> dict[str, Any]:
    """Return an instrument without a jaw: its last disc moves nothing."""
    file = {**instrument(0.4520, 0.0), "jaw": NO_JAW}
    file["coupling"] = {"ActuatorToJointPosition": np.diag([-1.56, 1.0, 1.0, 1.0]).tolist()}
    return {**file, **more}


def index(*more: dict[str, Any]) -> dict[str, Any]:
    mine = {
        "model": "420901",
        "names": ["MY_PROBE"],
        "description": "A probe",
        "generation": "S",
        "file": "ours/probe.json",
    }
    return {"instruments": [mine, *more]}


def with_index(
    folder: Path, arm: dict[str, Any], files: dict[str, Any] | None = None, **tool: Any
) -> Path:
    psm = {"kinematic": "kinematic/PSM.json", "custom_tool_index": "mine.json", **arm}
    system = {"arms": [{"name": "PSM1", "type": "PSM", "arm_file": "arm.json"}]}
    given = {"system-lab.json": system, "arm.json": psm, "mine.json": index()}
    return lab.write(folder, given | {"ours/probe.json": probe(**tool)} | (files or {}))


def joints_of(found: ImportedRig) -> np.ndarray:
    mechanism = found.rig.arm("PSM1").arm.mechanism
    return np.random.default_rng(7).uniform(mechanism.lower, mechanism.upper, (10, 7))


def test_the_tooltip_offset_moves_the_tip_forward_inverse_and_measured(tmp_path: Path) -> None:
    offset = np.array(lab.TOOLTIP)
    offset[:3, 3] = 0.001, 0.0102, -0.002
    file = {**instrument(0.4162, 0.0091), "tooltip-offset": offset.tolist()}
    path = with_tool(tmp_path, "LARGE_NEEDLE_DRIVER:400006", file)
    found = import_dvrk(path, tmp_path / "rig.toml")
    arm = found.rig.arm("PSM1").arm
    assert found.agreement["tips"].metres < 1e-9
    for q in joints_of(found):
        expected = lab.chain([*lab.PSM, *file["DH"]["joints"]], q[:6]) @ offset
        np.testing.assert_allclose(pose(arm.mechanism, q), expected, atol=1e-9)
        if q[2] > 0.06:  # nearer the remote centre the wrist cannot reach
            back = inverse_kinematics(arm.mechanism, arm.inverse_kinematics, expected, q[:6])[0]
            np.testing.assert_allclose(back, q[:6], atol=1e-7)
    world = World(found.rig)
    q = world.arm("PSM1").measured_js().position
    expected = lab.chain([*lab.PSM, *file["DH"]["joints"]], q[:6]) @ offset
    np.testing.assert_allclose(world.arm("PSM1").local.measured_cp().matrix, expected, atol=1e-4)


def test_an_instrument_without_a_jaw_keeps_its_fingers_shut(tmp_path: Path) -> None:
    path = with_index(tmp_path, {"tool_detection": "FIXED", "tool": PROBE})
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert any("MY_PROBE:420901 has no jaw" in note for note in found.notes)
    arm = found.rig.arm("PSM1").arm
    assert arm.tool == PROBE and arm.joint("jaw").upper < 1e-4
    world = World(found.rig)
    psm = world.arm("PSM1")
    assert psm.jaw is not None
    psm.jaw.servo_jp([0.5])
    world.step(500)
    assert abs(psm.jaw.measured_js().position[0]) < 1e-3
    psm.servo_jp([0.1, 0.1, 0.1, 0.2, 0.2, -0.2])
    world.step(1000)
    np.testing.assert_allclose(psm.measured_js().position[3:6], [0.2, 0.2, -0.2], atol=0.02)


def test_a_jaw_without_torque_is_none(tmp_path: Path) -> None:
    hook = {"qmin": 0.0, "qmax": 0.5, "ftmax": 0.0}  # as of SAW's cautery hook
    path = with_index(tmp_path, {"tool_detection": "FIXED", "tool": PROBE}, jaw=hook)
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert any("its jaw has no torque" in note for note in found.notes)
    assert found.rig.arm("PSM1").arm.joint("jaw").upper < 1e-4


def test_virtual_joints_without_a_range_are_held(tmp_path: Path) -> None:
    rows = json.loads(json.dumps(probe()["DH"]["joints"]))
    for row in rows[1:]:
        row |= {"qmin": 0.0, "qmax": 0.0, "ftmax": 0.0}
    path = with_index(
        tmp_path,
        {"tool_detection": "FIXED", "tool": PROBE},
        DH={"convention": "modified", "joints": rows},
    )
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert any("wrist_pitch, wrist_yaw without a range" in note for note in found.notes)
    assert found.agreement["tips"].metres < 1e-9
    world = World(found.rig)
    world.arm("PSM1").servo_jp([0.0, 0.1, 0.1, 0.3, 0.0, 0.0])
    world.step(1000)
    q = world.arm("PSM1").measured_js().position
    np.testing.assert_allclose(q[3:6], [0.3, 0.0, 0.0], atol=0.02)
    assert np.abs(q[4:6]).max() < 1e-3


@pytest.mark.parametrize("tool", [PROBE, "my_probe:420901", ":420901", "MY_PROBE:420901[3]"])
def test_the_lab_s_index_names_the_file(tmp_path: Path, tool: str) -> None:
    path = with_index(tmp_path, {"tool_detection": "FIXED", "tool": tool})
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert found.rig.arm("PSM1").arm.tool == PROBE
    assert found.unknown == ()
    assert not any("custom_tool_index" in text for text in found.idle)


def test_an_index_in_a_folder_of_another_name_is_taken_from_beside_the_system_s_file(
    tmp_path: Path,
) -> None:
    """Labs copy and rename their folder; the paths in it keep the old name."""
    own = {"custom_tool_index": "old-lab/mine.json", "tool_detection": "FIXED", "tool": PROBE}
    entry = {**index()["instruments"][0], "file": "old-lab/tools/probe.json"}
    files = {"mine.json": {"instruments": [entry]}, "probe.json": probe()}
    found = import_dvrk(with_index(tmp_path, own, files), tmp_path / "rig.toml")
    assert found.rig.arm("PSM1").arm.tool == PROBE
    used = [text for text in found.warnings if "which lies beside the system's file" in text]
    assert [text.partition(":")[0] for text in used] == [
        "old-lab/mine.json",
        "old-lab/tools/probe.json",
    ]


def test_versions_select_between_files(tmp_path: Path) -> None:
    longer = probe()
    longer["DH"]["joints"][0]["D"] = 0.5
    second = {**index()["instruments"][0], "version_min": 5, "file": "ours/longer.json"}
    first = {**index()["instruments"][0], "version_max": 4}
    files = {"mine.json": {"instruments": [first, second]}, "ours/longer.json": longer}
    for version, length in ((4, 0.452), (5, 0.5)):
        arm = {"tool_detection": "FIXED", "tool": f"{PROBE}[{version}]"}
        path = with_index(tmp_path / str(version), arm, files)
        found = import_dvrk(path, path.parent / "rig.toml")
        mechanism = found.rig.arm("PSM1").arm.mechanism
        q = np.zeros(7)
        at = np.linalg.norm(pose(mechanism, q, "roll", "insertion")[:3, 3])
        assert at == pytest.approx(length)


def test_a_tool_option_takes_an_instrument_of_the_lab_s_index(tmp_path: Path) -> None:
    path = with_index(tmp_path, {"tool_detection": "MANUAL"})
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert any("mine.json has MY_PROBE:420901" in note for note in found.notes)
    chosen = RigImportOptions(tools=(("PSM1", PROBE),), overwrite=True)
    found = import_dvrk(path, tmp_path / "rig.toml", chosen)
    assert found.rig.arm("PSM1").arm.tool == PROBE
    wrong = RigImportOptions(tools=(("PSM1", "MY_PROB:420901"),), overwrite=True)
    with pytest.raises(UnknownNameError, match="did you mean 'MY_PROBE:420901'"):
        import_dvrk(path, tmp_path / "rig.toml", wrong)


def test_an_alias_of_a_built_in_instrument_is_that_instrument(tmp_path: Path) -> None:
    names = {"model": "400172", "names": ["BIPOLAR_MARYLAND", "MARYLAND_BIPOLAR_FORCEPS"]}
    entry = {**index()["instruments"][0], **names, "file": "not-here.json"}
    path = with_index(
        tmp_path,
        {"tool_detection": "FIXED", "tool": "BIPOLAR_MARYLAND:400172", "custom_tool_index": ""},
        {"tool/index.json": {"instruments": [entry]}},
    )
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert found.rig.arm("PSM1").arm.tool == "MARYLAND_BIPOLAR_FORCEPS:400172"


@pytest.mark.parametrize(
    ("arm", "files", "said"),
    [
        ({"custom_tool_index": "none.json"}, {}, r"arm.json: custom_tool_index: got 'none.json'"),
        ({"tool": "MY_SPOON:420901"}, {}, r"arm.json: tool: got 'MY_SPOON:420901'.*mean 'MY_PROBE"),
        ({}, {"mine.json": {"instruments": [{"model": "1"}]}}, r"mine.json: instruments.*missing"),
        ({}, {"mine.json": index() | {"x": 1}, "ours/probe.json": "{"}, r"probe.json: is not JSON"),
        (
            {},
            {
                "ours/probe.json": probe(
                    coupling={"ActuatorToJointPosition": np.zeros((4, 4)).tolist()}
                )
            },
            r"probe.json: coupling.ActuatorToJointPosition: .*ones on the diagonal",
        ),
        (
            {},
            {"ours/probe.json": probe(jaw={"qmin": -1.0, "qmax": 1.0, "ftmax": -0.1})},
            r"probe.json: joint\[3\].effort_max",
        ),
        (
            {},
            {"ours/probe.json": probe(jaw={"qmin": 1.0, "qmax": 0.5, "ftmax": 0.1})},
            r"probe.json: jaw.qmin: got 1; allowed: up to qmax, 0.5",
        ),
    ],
)
def test_faults_name_the_lab_s_own_file(
    tmp_path: Path, arm: dict[str, Any], files: dict[str, Any], said: str
) -> None:
    path = with_index(tmp_path, {"tool_detection": "FIXED", "tool": PROBE, **arm}, files)
    with pytest.raises(DescriptionError, match=said) as caught:
        import_dvrk(path, tmp_path / "rig.toml")
    assert Path(caught.value.file).is_file()
    assert not (tmp_path / "rig.toml").exists()
