"""`trocar calibrate`: from a file of tracks to an overlay that the other commands take."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from trocar.apps.mocap.perturb import perturbed
from trocar.apps.mocap.simulate import MocapSettings, simulate_tracks
from trocar.apps.mocap.writers import write_tracks
from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.descriptions.overlay import read_overlay


@pytest.fixture(scope="module")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    robot = perturbed(load_arm("psm"), np.random.default_rng(5))
    made = simulate_tracks(robot, MocapSettings("kinematic", "both", 6.0, 0.6, 40.0, seed=5))
    path = tmp_path_factory.mktemp("tracks") / "psm.csv"
    write_tracks(path, made)
    return path


def test_calibrate_writes_an_overlay_and_prints_one_document(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "psm_overlay.toml"
    assert main(["calibrate", str(tracks), "--arm", "psm", "-o", str(output), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {"arm", "axis_distances_m", "beta_rad", "rcm", "residuals", "warnings"} <= set(document)
    assert set(document["axis_distances_m"]["3-6"]) == {"value", "sigma"}
    assert set(document["rcm"]) >= {"position_in_base_body_m", "rms_m", "distance_to_pitch_axis_m"}
    overlay = read_overlay(output)
    assert overlay.arm == "psm" and overlay.source["file"] == str(tracks)
    assert len(overlay.source["sha256"]) == 64


def test_calibrate_prints_a_table(tracks: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(tracks), "--arm", "psm"]) == 0
    out = capsys.readouterr().out
    assert "3-6" in out and "beta1" in out and "Remote centre" in out


def test_calibrate_writes_a_page_that_needs_nothing_else(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    assert main(["calibrate", str(tracks), "--arm", "psm", "--report", str(tmp_path / "page")]) == 0
    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
    assert "<svg" in page and "unexplained" in page and "absorbed [mm]" in page
    assert "index.html" in capsys.readouterr().out
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="utf-8")
    assert main(["calibrate", str(tracks), "--arm", "psm", "--report", str(blocked)]) == 2


def test_a_refused_file_leaves_no_overlay(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "overlay.toml"
    assert main(["calibrate", str(tracks), "--arm", "ecm", "-o", str(output)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("trocar: error: ") and "psm_yaw" in error and "ecm_yaw" in error
    assert not output.exists()
