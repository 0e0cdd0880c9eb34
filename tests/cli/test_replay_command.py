"""trocar replay: what it takes and what it prints."""

from __future__ import annotations

import argparse
import io
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from trocar.cli import replay
from trocar.errors import LogError

KEYS = [
    "log", "arm", "mode", "understood", "up", "rate_hz", "pieces", "samples", "clipped",
    "tracking_rms", "effort_rms", "effort_relative_rms",
]  # fmt: skip
JOINTS = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def run(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    replay.add_arguments(parser)
    return replay.run(parser.parse_args(arguments, argparse.Namespace(given={})))


@pytest.fixture
def log(write_psm_log: Callable[..., Path], tmp_path: Path) -> str:
    time = 0.005 * np.arange(60)[:, None]
    q = np.array([0.1, 0.1, 0.12, 0.0, 0.0, 0.0, 0.5]) + 0.02 * np.sin(time)
    return str(write_psm_log(tmp_path / "log.csv", q, 0.02 * np.cos(time) + 0.0 * q, 0.0 * q + 0.1))


@pytest.mark.parametrize("mode", ["position", "effort"])
def test_json_is_one_document_with_these_keys(
    log: str, mode: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    assert run(log, "--arm", "psm", "--mode", mode, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert list(report) == KEYS
    assert (report["log"], report["arm"], report["mode"]) == (log, "psm", mode)
    assert (report["samples"], report["clipped"]) == (60, 0)
    for figure in KEYS[-3:]:
        assert list(report[figure]) == JOINTS
        assert all(isinstance(value, float) for value in report[figure].values())
    bar, said = terminal.getvalue().rsplit("\x1b[2K", 1)  # the bar is wiped
    assert bar and said == "psm: 7 joints at 200.0 Hz\n" == report["understood"] + "\n"


def test_the_table_has_a_line_per_joint_with_units(
    log: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(log, "--mode", "effort", "--window", "0.1") == 0
    printed = capsys.readouterr()
    head, _, _, *lines = printed.out.splitlines()
    assert "60 samples (0.30 s), 0 clipped" in head and "gravity" not in head
    assert [line.split()[0] for line in lines] == JOINTS
    assert " mrad" in lines[0] and " N m" in lines[0]
    assert " mm" in lines[2] and " N " in lines[2]
    assert printed.err == "psm: 7 joints at 200.0 Hz\n"  # no progress bar without a terminal


def test_the_table_says_how_the_arm_leans(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(log, "--base-rpy=90,0,0") == 0
    head = capsys.readouterr().out.splitlines()[0]
    assert head.endswith("joint limit, gravity along (0.000, -1.000, 0.000) of its base")


def test_a_terminal_sees_how_far_it_is(log: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    assert run(log) == 0
    assert "60 of 60 rows" in terminal.getvalue()


def test_the_bar_is_wiped_before_an_error_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torn = tmp_path / "torn.csv"
    torn.write_text(",".join("0" * 21) + "\n" + ",".join("0" * 20) + ",here\n", encoding="utf-8")
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with pytest.raises(LogError):
        run(str(torn))
    assert terminal.getvalue().endswith("\x1b[2K")  # erase the line


@pytest.mark.parametrize("option", [("--mode", "fast"), ("--wrist", "left"), ("--window", "long")])
def test_a_wrong_option_ends_with_status_2(
    log: str, option: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        run(log, *option)
    assert caught.value.code == 2
    assert option[1] in capsys.readouterr().err
