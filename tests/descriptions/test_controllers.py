"""Observers, caps and coefficients of arms' controllers in files, and what is wrong with some."""

from __future__ import annotations

from pathlib import Path

import pytest

from trocar.descriptions import load_arm, load_rig
from trocar.errors import DescriptionError

LINK = '[[gravity_link]]\nname = "yaw"\nalpha_deg = 90.0\n'


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("observer = { yaw = [0.01, 50.0]", "observer = { yaw = [0.01]", r"yaw: got .*2 numbers"),
        ("observer = { yaw = [0.01, 50.0]", "observer = { yaw = [-1.0, 5.0]", "allowed: 0 or more"),
        (
            "observer = { yaw",
            "observer = { elbow",
            r"control.dvrk.observer: got 'elbow'; allowed: y",
        ),
        ("[0.0005, 0.0], ", "", r"disc_observer: got 3; allowed: 4, one of each disc"),
        ("[0.0005, 0.0], ", "[0.0005, -1.0], ", r"dvrk.disc_observer: got .*; allowed: 0 or more"),
        ("[0.0005, 0.0], ", "[0.0005], ", r"dvrk.disc_observer: got .*2 numbers"),
        ("[[0.0005", "0.5 # [[0.0005", r"disc_observer: got 0.5; allowed: 4 rows of 2 numbers"),
        (
            "insertion = [0.005, 20.0] }",
            "roll = [0.0005, 10.0] }",
            r"disc_observer: roll has an observer of its own; allowed: of joints or discs",
        ),
        ("pid_output_max = { yaw", "pid_output_max = { elbow", r"pid_output_max: got 'elbow'"),
        (
            "yaw = 10.0, pitch",
            "yaw = 0.0, pitch",
            r"pid_output_max: got 0 for yaw; allowed: above 0",
        ),
        (LINK, LINK.replace("yaw", "pitch_1"), "pitch_1' a second time"),
        (
            "q = { yaw = 1.0 }\nmass_kg",
            "q = { elbow = 1.0 }\nmass_kg",
            r"gravity_link yaw.q: got 'elb",
        ),
        ("q = { yaw = 1.0 }\nmass_kg", "mass_kg", r"gravity_link.*q: a moving link needs q"),
        (
            "mass_kg = 0.637",
            "mass_kg = -0.637",
            r"gravity_link.*mass: got -0.637; allowed: 0 or more",
        ),
    ],
)
def test_what_is_wrong_with_a_controller_is_named(tmp_path: Path, old: str, new: str, said: str):
    text = Path(load_arm("psm_si").file).read_text(encoding="utf-8")
    assert old in text
    file = tmp_path / "arm.toml"
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(DescriptionError, match=said):
        load_arm(file, "LARGE_NEEDLE_DRIVER:420006")


@pytest.mark.parametrize(
    ("rig", "pitch", "said"),
    [
        ("psm", "30.0", r"mounting_pitch: got one of psm, whose controller has no coefficients"),
        ("psm_si", "200.0", r"mounting_pitch: got 200 deg; allowed: -180 to 180"),
    ],
)
def test_a_mounting_pitch_that_no_controller_takes_is_an_error(
    tmp_path: Path, rig: str, pitch: str, said: str
):
    text = Path(load_rig(rig).file).read_text(encoding="utf-8")
    file = tmp_path / "rig.toml"
    file.write_text(
        text.replace('name = "PSM1"\n', f'name = "PSM1"\nmounting_pitch_deg = {pitch}\n', 1),
        encoding="utf-8",
    )
    with pytest.raises(DescriptionError, match=said):
        load_rig(file)
