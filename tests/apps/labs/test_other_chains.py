"""Chains and instruments that are not trocar's own become serial arms and tools of their own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from trocar.apps.labs import import_dvrk
from trocar.kinematics.forward import pose
from trocar.simulation import World

from . import configurations as lab


def one_arm(folder: Path, kind: str, rows: list[dict[str, Any]]) -> Path:
    arm = {"kinematic": "mine.json", "generation": "Classic"}
    if kind == "PSM":
        arm |= {"tool_detection": "FIXED", "tool": "LARGE_NEEDLE_DRIVER:400006"}
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
    assert any("its chain is not psm's" in text for text in found.said)
    rng = np.random.default_rng(3)
    for q in rng.uniform(arm.mechanism.lower, arm.mechanism.upper, (10, 7)):
        tip = lab.chain([*rows, *lab.TOOL["Classic"]], q[:6]) @ lab.TOOLTIP
        np.testing.assert_allclose(pose(arm.mechanism, q), tip, atol=1e-9)
    assert found.agreement.chain_m < 1e-9
    world = World(found.rig)
    world.arm("PSM").servo_jp(np.array([0.1, 0.1, 0.13, 0.0, 0.0, 0.0]))
    world.step(500)
    assert abs(world.arm("PSM").readings()[0][0] - 0.1) < 0.01


def test_an_ecm_of_other_lengths_is_serial_too(tmp_path: Path) -> None:
    rows = json.loads(json.dumps(lab.ECM))
    rows[3]["D"] = 0.41
    found = import_dvrk(one_arm(tmp_path, "ECM", rows), tmp_path / "rig.toml")
    mechanism = found.rig.arm("ECM").arm.mechanism
    rng = np.random.default_rng(4)
    for q in rng.uniform(mechanism.lower, mechanism.upper, (10, 4)):
        np.testing.assert_allclose(pose(mechanism, q), lab.chain(rows, q), atol=1e-9)
