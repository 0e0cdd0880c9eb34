"""--calibration: the same robot in every command."""

from __future__ import annotations

import json

import numpy as np
import pytest

from trocar.cli.program import main
from trocar.descriptions import load_arm
from trocar.descriptions.overlay import write_overlay
from trocar.kinematics import pose

Q = [0.1, 0.3, 0.12, 0.0, 0.2, 0.0]


@pytest.fixture
def file(tmp_path, skew_overlay, rng) -> str:
    write_overlay(tmp_path / "mine.toml", skew_overlay("psm", rng))
    return str(tmp_path / "mine.toml")


def test_fk_and_ik_are_those_of_the_calibrated_robot(file, capsys):
    assert main(["fk", "psm", *map(str, Q), "--calibration", file, "--json"]) == 0
    found = np.array(json.loads(capsys.readouterr().out)["pose"])
    wanted = pose(load_arm("psm", calibration=file).mechanism, [*Q, 0.0])
    assert np.abs(found - wanted).max() < 1e-12
    assert np.abs(found - pose(load_arm("psm").mechanism, [*Q, 0.0])).max() > 1e-4


def test_show_names_the_overlay(file, capsys):
    assert main(["show", "psm", "--calibration", file]) == 0
    assert f"overlay  {file} (general)" in capsys.readouterr().out
    assert main(["show", "psm", "--calibration", file, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["calibration"]
    assert (told["file"], told["closure"], told["closures"]) == (file, "general", ["c1", "c2"])
    assert main(["show", "psm", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["calibration"] is None


def test_an_overlay_for_another_arm_is_one_line_and_exit_status_2(file, capsys):
    for words in (["fk", "ecm", "0", "0", "0.1", "0"], ["sim", "--rig", "ecm", "--headless"]):
        assert main([*words, "--calibration", file]) == 2
        error = capsys.readouterr().err
        assert "is a calibration of 'psm'" in error
        assert len(error.splitlines()) == 1
