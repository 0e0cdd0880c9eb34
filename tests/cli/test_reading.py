"""Recordings of real arms of any layout on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.kinematics.chain_pose import chain_pose
from trocar.tasks.scoring import score_tip

PSM = load_arm("psm")
TIME = np.arange(90) / 30.0
Q = np.array([0.1, -0.2, 0.15, 0.3, 0.1, 0.2, 0.5]) + 0.1 * np.sin(TIME[:, None] + np.arange(7)) * [
    1, 1, 0.2, 1, 1, 1, 1
]  # fmt: skip


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Positions alone of two PSMs at 30 Hz, in degrees and millimetres."""
    scale = np.array([1.0 if j.kind == "prismatic" else np.rad2deg(1.0) for j in PSM.joints])
    scale[2] = 1e3
    names = [f"{arm}_q{k}" for arm in ("PSM1", "PSM2") for k in range(1, 8)]
    table = np.column_stack([TIME, Q * scale, Q[::-1] * scale])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(["t", *names]))
    return tmp_path / "log.csv"


WORDS = ["--of", "PSM1", "--units", "deg/mm"]


def test_replay_says_what_it_understood(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(log), *WORDS, "--json"]) == 0
    out, err = capsys.readouterr()
    assert "PSM1: 7 joints at 30.0 Hz, velocities by differences, no efforts" in err
    report = json.loads(out)
    assert report["samples"] / report["rate_hz"] == pytest.approx(3.0, abs=0.05)
    assert main(["replay", str(log)]) == 2
    assert "holds 2 arms; select one with --of: PSM1, PSM2" in capsys.readouterr().err


def test_score_takes_the_joints_of_a_real_robot(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["score", str(log), "--units", "deg/mm", "--json"]) == 0
    arms = json.loads(capsys.readouterr().out)["arms"]
    expected = score_tip(TIME, chain_pose(PSM.mechanism)(Q)[:, :3, 3]).motion
    assert set(arms) == {"PSM1", "PSM2"}
    for arm in arms.values():  # one moves as the other backwards
        assert arm["motion"]["path_length_m"] == pytest.approx(expected.path_length_m, rel=1e-6)
    assert main(["score", str(log), "--arm", "PSM3"]) == 2
    assert "unknown arm 'PSM3'" in capsys.readouterr().err


def test_a_table_is_mirrored(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = log.read_text().replace("PSM2", "OTHER")
    log.write_text(text)
    assert main(["mirror", "--bag", str(log), "--rig", "psm", "--no-page", "--json"]) == 2
    assert "--units deg/mm" in capsys.readouterr().err
    rad = np.column_stack([TIME, Q])
    names = ["t", *(f"PSM1_q{k}" for k in range(1, 8))]
    np.savetxt(log, rad, delimiter=",", header=",".join(names))
    assert main(["mirror", "--bag", str(log), "--rig", "psm", "--no-page", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["arms"]["PSM1"]["heard"] == 90


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--wrist", "joint"], "--wrist: has no effect here; allowed with rows without a header"),
        (["--topic", "/x"], "--topic: has no effect here; allowed with a bag"),
        (["--of", "PSM1", "--units", "furlong"], "unknown unit 'furlong'"),
        (["--base", "1,2,3"], "allowed: X,Y,Z,QW,QX,QY,QZ"),
        (["--rate", "-3"], "rate: got -3.0 Hz; allowed: more than 0"),
    ],
)
def test_options_of_other_files_are_refused(
    log: Path, words: list[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(log), *words]) == 2
    assert problem in capsys.readouterr().err
