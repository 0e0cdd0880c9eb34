"""A log of an arm that leans is explained as well as one of an upright arm."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from trocar import World
from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.errors import LogError
from trocar.recording import record
from trocar.robot.identification import JointMotion, excite, predicted_efforts, read_motion
from trocar.robot.identification.drivetrains import described_trains
from trocar.robot.standing import standing_arm

RATE_HZ = 100.0
RIG = """
schema = 1
name = "tilted"
title = "A PSM that leans"
source = "made"
[[arm]]
name = "PSM1"
description = "psm"
place = "rcm"
xyz_m = [0.0, 0.0, 0.3]
rpy_deg = [30.0, 0.0, 0.0]
[[pose]]
name = "start"
source = "made"
q_rad_m = { PSM1 = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.0] }
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "tilted.toml"
    path.write_text(RIG)
    return path


@pytest.fixture
def log(tmp_path: Path, rig: Path) -> Path:
    """Return a table of a leaning arm with the masses and friction of its description."""
    stand = standing_arm(None, rig=rig)
    arm, names = stand.arm, stand.arm.mechanism.joint_names
    plan = excite(arm, 10.0, 1, RATE_HZ, candidates=1, up=stand.up)
    qdd = np.gradient(plan.qd, 1.0 / RATE_HZ, axis=0)
    motion = JointMotion(plan.q, plan.qd, qdd, up=stand.up)
    effort = predicted_efforts(arm, described_trains(arm), motion)
    head = ["time", *(f"{n}_{part}" for part in ("position", "velocity", "effort") for n in names)]
    path = tmp_path / "log.csv"
    table = np.column_stack([np.arange(len(plan.q)) / RATE_HZ, plan.q, plan.qd, effort])
    np.savetxt(path, table, delimiter=",", header=",".join(head), comments="")
    return path


def errors(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, float]:
    assert main([*words, "--dynamics", "cad", "--json"]) == 0
    return json.loads(capsys.readouterr().out)["relative_rms_percent"]


def test_a_rig_or_the_rotation_of_the_base_explains_the_weight_of_a_leaning_arm(
    log: Path, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    by_rig = errors(capsys, "predict", str(log), "--rig", str(rig))
    by_angles = errors(capsys, "predict", str(log), "--base-rpy=30,0,0")
    upright = errors(capsys, "predict", str(log))
    assert by_rig == pytest.approx(by_angles)
    assert by_rig["pitch"] < 5.0 and upright["pitch"] > 30.0
    assert by_rig["yaw"] < 5.0 and upright["yaw"] > 10.0


@pytest.mark.slow
def test_identify_takes_how_an_arm_stands(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    found: dict[str, dict[str, float]] = {}
    for lean in ("30,0,0", "0,0,0"):
        out = ["-o", str(tmp_path / f"{lean}.toml"), "--json"]
        assert main(["identify", str(log), f"--base-rpy={lean}", *out]) == 0
        (one,) = json.loads(capsys.readouterr().out)["logs"]
        found[lean] = one["relative_rms_percent"]
    assert found["30,0,0"]["pitch"] < 3.0
    assert found["30,0,0"]["pitch"] < 0.5 * found["0,0,0"]["pitch"]


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["psm_si", "ecm_si"])
def test_a_log_of_held_set_points_is_identified(
    rig: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A motion of `excite`, as set-points at 200 Hz, by the arm's own controller."""
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    stand = standing_arm(None, rig=rig)
    plan = excite(stand.arm, 10.0, 1, candidates=20, up=stand.up)
    world, held = World(rig), np.repeat(plan.q, 5, axis=0)
    world.set_state(stand.name, plan.q[0])
    found = world.play({stand.name: held}, every=1)
    parts = found.positions[stand.name], found.velocities[stand.name], found.efforts[stand.name]
    names = stand.arm.mechanism.joint_names
    head = ["time", *(f"{n}_{part}" for part in ("position", "velocity", "effort") for n in names)]
    table = np.column_stack([world.timestep * np.arange(len(held)), *parts])
    path = tmp_path / "log.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(head), comments="")
    out = ["-o", str(tmp_path / "own.toml"), "--json"]
    assert main(["identify", str(path), "--rig", rig, *out]) == 0
    (one,) = json.loads(capsys.readouterr().out)["logs"]
    assert one["relative_rms_percent"]["roll"] < 20.0


def test_the_direction_of_gravity_of_a_recorded_simulation_is_that_of_its_rig(
    tmp_path: Path, rig: Path
) -> None:
    world = World(rig)
    with record(world, tmp_path / "it.mcap"):
        world.step(3500)
    log = read_motion(tmp_path / "it.mcap", load_arm("psm"))
    np.testing.assert_allclose(log.up, [0.0, 0.5, np.sqrt(0.75)], atol=1e-12)
    given = read_motion(tmp_path / "it.mcap", load_arm("psm"), up=np.array([0.0, 0.0, 1.0]))
    assert given.up.tolist() == [0.0, 0.0, 1.0]
    rig.unlink()
    with pytest.raises(LogError, match=r"its rig, .* gravity in PSM1 .*cannot be read"):
        read_motion(tmp_path / "it.mcap", load_arm("psm"))


def test_angles_that_are_none_are_named(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", str(log), "--base-rpy=30,0"]) == 2
    assert "got '30,0'; allowed: R,P,Y in degrees, e.g. -45,0,0" in capsys.readouterr().err
    assert main(["predict", str(log), "--base-rpy=30,0,0", "--rig", "psm"]) == 2
    assert "got a rotation and a rig" in capsys.readouterr().err


def test_excite_takes_how_an_arm_stands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    conditions: list[float] = []
    for number, how in enumerate((["--rig", "psm_si"], ["--arm", "psm_si", "--base-rpy=-45,0,0"])):
        out = ["--candidates", "3", "-o", str(tmp_path / f"{number}.csv"), "--json"]
        assert main(["excite", *how, *out]) == 0
        conditions.append(json.loads(capsys.readouterr().out)["condition_number"])
    assert conditions[0] == pytest.approx(conditions[1])


def test_replay_takes_how_an_arm_stands(
    log: Path, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Motors of a leaning arm carry what the log has; an upright one's carry another weight."""
    table = np.loadtxt(log, delimiter=",", skiprows=1)[:, 1:]
    rows = tmp_path / "rows.csv"
    np.savetxt(rows, table, delimiter=",")
    words = ["replay", str(rows), "--rate", "100", "--wrist", "joint", "--dynamics", "cad"]
    found: dict[str, float] = {}
    for how in ("--base-rpy=30,0,0", f"--rig={rig}", "--arm=psm"):
        assert main([*words, how, "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        found[how.partition("=")[0]] = document["effort_relative_rms"]["pitch"]
    assert found["--base-rpy"] == pytest.approx(found["--rig"], rel=1e-3)
    assert found["--base-rpy"] < 0.5 * found["--arm"]
