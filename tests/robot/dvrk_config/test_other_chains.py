"""Chains and instruments that are not trocar's own become serial arms and tools of their own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.dvrk_config import configurations as lab
from trocar.errors import DescriptionError
from trocar.kinematics.forward import pose
from trocar.robot.dvrk_config import import_dvrk
from trocar.simulation import World


def one_arm(folder: Path, kind: str, rows: list[dict[str, Any]]) -> Path:
    arm = {"kinematic": "mine.json", "generation": "Classic"}
    if kind == "PSM":
        arm |= {"tool_detection": "FIXED", "tool": "LARGE_NEEDLE_DRIVER:400006"}
    else:
        arm |= {"endoscope": "Classic_SD_STRAIGHT"}
    system = {"arms": [{"name": kind, "type": kind, "arm_file": "arm.json"}]}
    mine = {"DH": {"convention": "modified", "joints": rows}}
    return lab.write(folder, {"system-lab.json": system, "arm.json": arm, "mine.json": mine})


def test_a_psm_of_other_lengths_is_serial_and_reaches_where_its_file_says(tmp_path: Path) -> None:
    rows = json.loads(json.dumps(lab.PSM))
    rows[2] |= {"offset": -0.45, "qmax": 0.26}
    found = import_dvrk(one_arm(tmp_path, "PSM", rows), tmp_path / "rig.toml")
    arm = found.rig.arm("PSM").arm
    assert not arm.mechanism.closures
    assert arm.joint("insertion").upper == 0.26
    assert any("kinematic chain differs from psm" in text for text in found.notes)
    rng = np.random.default_rng(3)
    for q in rng.uniform(arm.mechanism.lower, arm.mechanism.upper, (10, 7)):
        tip = lab.chain([*rows, *lab.TOOL["Classic"]], q[:6]) @ lab.TOOLTIP
        np.testing.assert_allclose(pose(arm.mechanism, q), tip, atol=1e-9)
    assert found.agreement["chains"].metres < 1e-9
    world = World(found.rig)
    world.arm("PSM").servo_jp(np.array([0.1, 0.1, 0.13, 0.0, 0.0, 0.0]))
    world.step(500)
    assert abs(world.arm("PSM").joints.readings()[0][0] - 0.1) < 0.01


def test_an_ecm_of_other_lengths_is_serial_too(tmp_path: Path) -> None:
    rows = json.loads(json.dumps(lab.ECM))
    rows[3]["D"] = 0.41
    found = import_dvrk(one_arm(tmp_path, "ECM", rows), tmp_path / "rig.toml")
    mechanism = found.rig.arm("ECM").arm.mechanism
    rng = np.random.default_rng(4)
    for q in rng.uniform(mechanism.lower, mechanism.upper, (10, 4)):
        np.testing.assert_allclose(
            pose(mechanism, q), lab.chain(rows, q) @ lab.SCOPE_TIP, atol=1e-9
        )


def instrument(length: float, wrist: float) -> dict[str, Any]:
    """Return a tool's file like share/tool/LARGE_NEEDLE_DRIVER_400006.json."""
    rows = json.loads(json.dumps(lab.TOOL["Classic"]))
    rows[0]["D"], rows[2]["A"] = length, wrist
    for row, reach in zip(rows, (4.53786, 1.39626, 1.39626), strict=True):
        row |= {"qmin": -reach, "qmax": reach, "ftmax": 0.3}
    coupling = [
        [-1.5632, 0.0, 0.0, 0.0],
        [0.0, 1.0186, 0.0, 0.0],
        [0.0, -0.8306, 0.6089, 0.6089],
        [0.0, 0.0, -1.2177, 1.2177],
    ]
    return {
        "DH": {"convention": "modified", "joints": rows},
        "jaw": {"qmin": -0.3, "qmax": 1.2, "ftmax": 0.16},
        "tooltip-offset": lab.TOOLTIP,
        "coupling": {"ActuatorToJointPosition": coupling},
        "tool-engage-position": {"lower": [0.0] * 4, "upper": [0.0] * 4},
    }


def with_tool(folder: Path, tool: str, file: dict[str, Any]) -> Path:
    arm = {"kinematic": "kinematic/PSM.json", "tool_detection": "FIXED", "tool": tool}
    system = {"arms": [{"name": "PSM1", "type": "PSM", "arm_file": "arm.json"}]}
    name = tool.replace(":", "_")
    files = {"system-lab.json": system, "arm.json": arm, f"tool/{name}.json": file}
    return lab.write(folder, files)


def test_an_instrument_that_trocar_has_not_comes_from_its_file(tmp_path: Path) -> None:
    file = instrument(0.4250, 0.0120)
    path = with_tool(tmp_path, "MEGA_NEEDLE_DRIVER:400194", file)
    found = import_dvrk(path, tmp_path / "rig.toml")
    arm = found.rig.arm("PSM1").arm
    assert arm.tool == "MEGA_NEEDLE_DRIVER:400194"
    assert (arm.joint("jaw").lower, arm.joint("jaw").upper) == (-0.3, 1.2)
    assert arm.joint("roll").effort_max == 0.3
    assert found.unknown == ()
    rng = np.random.default_rng(5)
    for q in rng.uniform(arm.mechanism.lower, arm.mechanism.upper, (10, 7)):
        tip = lab.chain([*lab.PSM, *file["DH"]["joints"]], q[:6]) @ lab.TOOLTIP
        np.testing.assert_allclose(pose(arm.mechanism, q), tip, atol=1e-9)
    World(found.rig).step(10)


def test_an_instrument_that_trocar_has_stays_its_own_where_the_file_agrees(tmp_path: Path) -> None:
    file = instrument(0.4162, 0.0091)
    efforts = (0.33, 0.25, 0.20)
    for row, effort in zip(file["DH"]["joints"], efforts, strict=True):
        row["ftmax"] = effort
    file["jaw"] = {"qmin": -0.698132, "qmax": 1.39626, "ftmax": 0.16}
    path = with_tool(tmp_path, "LARGE_NEEDLE_DRIVER:400006", file)
    found = import_dvrk(path, tmp_path / "rig.toml")
    assert found.files == (str(tmp_path / "rig.toml"),)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"DH": {"convention": "modified", "joints": lab.PSM}}, "unsupported chain of"),
        ({"tooltip-offset": np.diag([2.0, 1, 1, 1]).tolist()}, r"tooltip-offset: got .* rotation"),
        ({"coupling": {"ActuatorToJointPosition": [[1.0]]}}, "allowed: 4 rows of 4 numbers"),
        ({"jaw": {"qmax": 1.0}}, "jaw.qmin: is missing"),
    ],
)
def test_a_tool_s_file_that_cannot_be_is_refused(
    tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    path = with_tool(tmp_path, "SPOON:400001", {**instrument(0.4162, 0.0091), **change})
    with pytest.raises(DescriptionError, match=said):
        import_dvrk(path, tmp_path / "rig.toml")
