"""`trocar mocap`: its files, its document, its table, its refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest

from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.descriptions.overlay import closure_patch, write_overlay
from trocar.descriptions.overlay_records import Overlay
from trocar.robot.calibration import read_tracks

QUICK = ("--motion", "kinematic", "--duration", "6", "--rate", "20")


@pytest.mark.parametrize("layout", ["tidy", "motive"])
def test_what_is_written_can_be_read_and_has_its_truth_beside_it(layout, trocar, tmp_path):
    file = tmp_path / "tracks.csv"
    answer = trocar("mocap", "--arm", "psm", "--format", layout, *QUICK, "-o", file, "--json")
    assert (answer.status, answer.err) == (0, "")
    tracks = read_tracks(file)
    assert list(tracks.poses) == [
        f"psm_{link}" for link in (
            "base", "yaw", "pitch_back", "pitch_front", "pitch_bottom", "pitch_top", "pitch_end"
        )
    ]  # fmt: skip
    assert (tracks.warnings, tracks.rate_hz) == ((), pytest.approx(20.0))
    document = answer.document
    truth = json.loads((tmp_path / "tracks.csv.truth.json").read_text(encoding="utf-8"))
    told = {key: document.pop(key) for key in ("file", "format", "truth_file")}
    assert told == {
        "file": str(file), "format": layout, "truth_file": f"{file}.truth.json"
    }  # fmt: skip
    assert document == truth
    assert truth["robot"] == "as drawn"
    assert truth["axis_distances_m"]["3-6"] == pytest.approx(0.150)
    assert {"still", "axes", "rcm"} == set(truth["parts_s"])


def test_both_formats_tell_the_same_to_six_decimals(trocar, tmp_path):
    for layout in ("tidy", "motive"):
        words = ("--arm", "ecm", "--perturb", 3, "--seed", 5, "--noise-mm", 0.1, "--dropout", 0.1)
        trocar("mocap", *words, *QUICK, "--format", layout, "-o", tmp_path / layout)
    exact, rounded = read_tracks(tmp_path / "tidy"), read_tracks(tmp_path / "motive")
    for body, pose in exact.poses.items():
        assert rounded.poses[body] == pytest.approx(pose, abs=4e-6, nan_ok=True)
        assert np.abs(rounded.poses[body] - pose)[exact.tracked(body)].max() > 1e-8


def test_people_are_told_what_was_written_and_what_is_true(trocar, tmp_path):
    file = tmp_path / "a.csv"
    answer = trocar("mocap", "--arm", "psm", "--perturb", 7, *QUICK, "-o", file)
    assert answer.out.startswith(
        f"{file}: psm perturbed with seed 7, 7 bodies, 241 samples at 20 Hz\n"
        "  still 0 to 2 s, axes 2 to 6 s, rcm 6 to 12 s\n"
    )
    for said in ("3-6                          152.3833  mm", "beta2", "remote centre to pitch"):
        assert said in answer.out


def test_tracks_are_noisy_unless_noise_is_switched_off(trocar, tmp_path):
    """Without noise every standard deviation that a calibration states would be 0."""
    truths = [
        trocar("mocap", "--arm", "psm", *QUICK, *words, "-o", tmp_path / name, "--json").document
        for name, words in (("a.csv", ()), ("b.csv", ("--noise-mm", "0", "--noise-deg", "0")))
    ]
    noise = [truth["settings"]["noise"] for truth in truths]
    assert noise[0]["position"] == pytest.approx(1e-4)
    assert noise[0]["rotation"] == pytest.approx(np.radians(0.05))
    assert noise[1]["position"] == noise[1]["rotation"] == 0.0


def test_a_calibrated_robot_stands_before_the_cameras(trocar, tmp_path):
    patches = {}
    for closure in load_arm("psm").mechanism.closures:
        patches[closure.name] = closure_patch(closure)
    write_overlay(tmp_path / "o.toml", Overlay("psm", closures=patches))
    words = ("--arm", "psm", "--calibration", tmp_path / "o.toml", *QUICK)
    answer = trocar("mocap", *words, "-o", tmp_path / "a.csv", "--json")
    assert answer.document["robot"] == f"calibrated by {tmp_path / 'o.toml'}"
    refused = trocar("mocap", "--arm", "ecm", *words[2:], "-o", tmp_path / "b.csv")
    assert "is a calibration of 'psm'; it cannot be laid over 'ecm'" in refused.complaint
    assert not list(tmp_path.glob("b.csv*"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--arm", "pms"], "unknown arm 'pms' (did you mean 'psm'?)"),
        (["--arm", "suj_psm1", "--parts", "axes"], "suj_psm1: has no closed loop"),
        (["--arm", "mtml", "--parts", "rcm"], "mtml: has no remote centre"),
        (["--arm", "psm", "--parts", "chain"], 'psm: parts: got "chain"; allowed: axes, rcm'),
        (["--arm", "psm", "--perturb", "-1"], "--perturb: got -1; allowed"),
        (
            ["--arm", "psm", "--worn", "--calibration", "x"],
            "--worn: got --calibration too",
        ),
        (
            ["--arm", "psm", "--loops-mm", "1", "--calibration", "x"],
            "--loops-mm: got --calibration",
        ),
        (["--arm", "psm", "--loops-mm", "1", "--worn"], "--worn: got --loops-mm too"),
        (["--arm", "psm", "--loops-mm", "9"], "--loops-mm: got 9; allowed: 0 to 5 mm"),
        (["--arm", "psm", "--perturb", "1", "--calibration", "x"], "not allowed with argument"),
        (["--arm", "psm", "--duration", "2"], "duration: got 2 s; allowed: at least 6 s"),
        (["--arm", "psm", "--dropout", "5"], "noise, dropout: got 5.0; allowed: 0 to 0.9"),
        (["--arm", "psm", "--noise-mm", "-1"], "noise, position: got -0.001; allowed"),
        (["--arm", "psm", "--format", "c3d"], "invalid choice: 'c3d'"),
        ([], "the following arguments are required: --arm"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(words, said, trocar, tmp_path):
    answer = trocar("mocap", *words, "-o", tmp_path / "a.csv")
    assert answer.status == 2
    assert said in answer.complaint
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_bad_input(tmp_path, capsys):
    words = ["mocap", "--arm", "psm", *QUICK, "-o", str(tmp_path / "no" / "a.csv")]
    assert main(words) == 2
    assert "cannot be written: No such file or directory" in capsys.readouterr().err
