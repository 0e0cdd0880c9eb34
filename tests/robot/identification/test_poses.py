"""Poses at rest, as the dVRK's script for gravity compensation collects them, are a log."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.cli import main
from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.inertial import holding_efforts
from trocar.errors import LogError
from trocar.robot.identification import default_filters, filtered, identify, predict, read_motion
from trocar.robot.identification.drivetrains import described_trains
from trocar.robot.identification.predict import LogSettings
from trocar.robot.standing import standing_arm

Array = NDArray[np.float64]
LEAN = {"psm_si": np.radians(-45.0), "ecm_si": np.radians(-70.0), "ecm": 0.0}


def grid(arm: ArmDescription) -> Array:
    """Return positions as the script has them: three joints on a grid, the others at 0."""
    lower, upper = arm.mechanism.lower[:3], arm.mechanism.upper[:3]
    places = (
        np.linspace(low, high, n) for low, high, n in zip(lower, upper, (5, 4, 3), strict=True)
    )
    found = np.array(list(itertools.product(*places)))
    return np.hstack([found, np.zeros((len(found), len(arm.joints) - 3))])


def heavier(arm: ArmDescription) -> ArmDescription:
    """Return an arm that is not quite as described."""
    rng = np.random.default_rng(4)
    return replace(
        arm,
        bodies=tuple(
            replace(b, mass=b.mass * rng.uniform(0.8, 1.2), com=b.com + rng.uniform(-0.01, 0.01, 3))
            if b.part == arm.name
            else b
            for b in arm.bodies
        ),
    )


def write(path: Path, arm: ArmDescription, up: Array, friction: float = 0.0) -> Path:
    q = grid(arm)
    held = holding_efforts(arm, q, -up)[:, :3]
    stuck = np.random.default_rng(5).uniform(-1.0, 1.0, held.shape) * friction
    np.savetxt(path, np.hstack([q[:, :3], held + stuck]), delimiter=",")
    return path


@pytest.mark.parametrize("name", LEAN)
def test_gravity_is_identified_from_poses(name: str, tmp_path: Path) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    stand = standing_arm(name, base_rpy=(LEAN[name], 0.0, 0.0))
    arm, robot = stand.arm, heavier(stand.arm)
    path = write(tmp_path / "ARM-gc-2026-01-01-12-00.csv", robot, stand.up)
    log = read_motion(path, arm, up=stand.up)
    assert log.poses and log.silent == arm.mechanism.joint_names[3:]
    settings = LogSettings(base_rpy=(LEAN[name], 0.0, 0.0))
    before = predict(path, name, "cad", settings=settings).score.relative_rms_percent
    found = identify([filtered(log, arm, default_filters(arm))], arm, mass_ratios=(0.1, 10.0))
    assert set(found.kept) == set(arm.mechanism.joint_names[3:])
    overlay = found.overlay("test")
    after = predict(path, name, overlay, settings=settings).score.relative_rms_percent
    for joint in ("yaw", "pitch", "insertion"):
        assert (after[joint] or 0.0) < 0.5, joint
    assert (before["pitch"] or 0.0) > 2.0
    # nothing was said of friction: it is the description's
    assert {n: t.terms for n, t in found.dynamics.drivetrains.items()} == {
        n: t.terms for n, t in described_trains(arm).items()
    }
    q = np.random.default_rng(6).uniform(
        arm.mechanism.lower, arm.mechanism.upper, (50, len(arm.joints))
    )
    q[:, 3:] = 0.0
    ours = holding_efforts(load_arm(name, calibration=overlay), q, -stand.up)[:, :3]
    truth = holding_efforts(robot, q, -stand.up)[:, :3]
    np.testing.assert_allclose(ours, truth, rtol=0.0, atol=0.01 * np.abs(truth).max())


def test_friction_of_an_si_at_rest_leaves_its_gravity_within_a_tenth(tmp_path: Path) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    stand = standing_arm("psm_si", base_rpy=(LEAN["psm_si"], 0.0, 0.0))
    arm, robot = stand.arm, heavier(stand.arm)
    path = write(tmp_path / "gc.csv", robot, stand.up, friction=0.5)
    log = filtered(read_motion(path, arm, up=stand.up), arm, default_filters(arm))
    found = identify([log], arm, mass_ratios=(0.1, 10.0))
    q = grid(arm)
    ours = holding_efforts(load_arm("psm_si", calibration=found.overlay("test")), q, -stand.up)
    truth = holding_efforts(robot, q, -stand.up)
    error = np.sqrt(np.mean((ours - truth)[:, :3] ** 2, axis=0))
    assert (error < 0.1 * np.sqrt(np.mean(truth[:, :3] ** 2, axis=0))).all()


def test_poses_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    stand = standing_arm(None, rig="psm_si")
    path = write(tmp_path / "gc.csv", heavier(stand.arm), stand.up)
    overlay = str(tmp_path / "own.toml")
    assert main(["identify", str(path), "--rig", "psm_si", "-o", overlay]) == 0
    assert "kept as described: roll (has no recorded efforts)" in capsys.readouterr().out
    words = ["predict", str(path), "--arm", "psm_si", "--base-rpy=-45,0,0", "--dynamics", overlay]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "60 poses at rest, gravity along (0.000, 0.707, -0.707) of its base" in text
    assert main([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["relative_rms_percent"]["pitch"] < 1.0
    assert document["relative_rms_percent"]["roll"] is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,0,0.1,1,2,3\n" * 5, "got 5 poses; allowed: 6 or more"),
        ("0,0,0.1,1,2,3\n" * 6 + "0,0,0.1,1,2\n", "row 7: got '0,0,0.1,1,2'; allowed: positions"),
        ("0,0,0.1,1,2,nan\n" * 6, "row 1: got .*efforts of yaw, pitch, insertion"),
        ("0,0,500,1,2,3\n" * 6, "positions: insertion: got 500"),
    ],
)
def test_poses_that_cannot_be_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "gc.csv"
    path.write_text(text)
    with pytest.raises(LogError, match=message):
        read_motion(path, load_arm("psm_si"))
