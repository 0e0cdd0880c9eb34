"""`trocar calibrate`: from a file of tracks to an overlay that the other commands take."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.descriptions.overlay import read_overlay
from trocar.robot.mocap.robots import perturbed
from trocar.robot.mocap.simulate import MocapSettings, simulate_tracks
from trocar.robot.mocap.writers import write_tracks


@pytest.fixture(scope="module")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    robot = perturbed(load_arm("psm"), np.random.default_rng(5))
    made = simulate_tracks(robot, MocapSettings("kinematic", "both", 6.0, 0.6, 40.0, seed=5))
    path = tmp_path_factory.mktemp("tracks") / "psm.csv"
    write_tracks(path, made)
    return path


@pytest.fixture(scope="module")
def takes(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A robot's sweep of the pitch, and that of the remote centre, in files of their own."""
    robot = perturbed(load_arm("psm"), np.random.default_rng(5))
    folder = tmp_path_factory.mktemp("takes")
    for part in ("axes", "rcm"):
        made = simulate_tracks(robot, MocapSettings("kinematic", part, 6.0, 0.6, 40.0, seed=5))
        write_tracks(folder / f"{part}.csv", made)
    return folder / "axes.csv", folder / "rcm.csv"


def exchanged(path: Path, one: str, two: str, folder: Path) -> Path:
    """Write tracks again, in which two bodies have each other's name."""
    text = path.read_text(encoding="utf-8")
    text = text.replace(f",{one},", ",?,").replace(f",{two},", f",{one},")
    out = folder / path.name
    out.write_text(text.replace(",?,", f",{two},"), encoding="utf-8")
    return out


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


@pytest.mark.parametrize(
    ("one", "two", "off"),
    [
        # Measured: sides of the robot of `takes`; nominal: those of the description.
        ("psm_pitch_back", "psm_pitch_end", "3-4 416.9 mm (nominal 96.0)"),
        ("psm_pitch_bottom", "psm_pitch_top", "3-6 184.3 mm (nominal 150.0)"),
    ],
)
@pytest.mark.parametrize("closure", ["parallelogram", "general"])
def test_exchanged_labels_are_refused_with_the_distances_that_they_make(
    takes: tuple[Path, Path],
    one: str,
    two: str,
    off: str,
    closure: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    axes, rcm = (exchanged(take, one, two, tmp_path) for take in takes)
    output, page = tmp_path / "overlay.toml", tmp_path / "page"
    words = ["calibrate", str(axes), "--rcm", str(rcm), "--arm", "psm", "--closure", closure]
    assert main([*words, "-o", str(output), "--report", str(page)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"trocar: error: {axes}: too far from the description: axis distances")
    assert off in error and "within 10 mm" in error
    assert "labelled wrongly" in error and one in error and two in error and "--bodies" in error
    assert not output.exists() and not page.exists()
    # The same files, their bodies put right.
    words += ["--bodies", f"{one}={two},{two}={one}"]
    assert main([*words, "-o", str(output)]) == 0
    assert output.exists()


def test_exchanged_names_on_the_command_line_are_refused_as_the_file_has_them(
    takes: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["calibrate", str(takes[0]), "--arm", "psm", "--bodies"]
    names = "psm_pitch_front=psm_pitch_end,psm_pitch_end=psm_pitch_front"
    assert main([*words, names]) == 2
    error = capsys.readouterr().err
    assert "6-8 97.8 mm (nominal 516.0)" in error and "psm_pitch_front ('psm_pitch_end')" in error


@pytest.mark.parametrize(
    ("one", "two", "off"),
    [
        ("psm_pitch_front", "psm_pitch_end", "remote centre from axis 3 97.9 mm (nominal 516.0)"),
        ("psm_pitch_back", "psm_pitch_front", "remote centre at (1.5, -416.9, 0.0) mm"),
        ("psm_base", "psm_pitch_end", "joint axes at 0.000 rad (nominal 1.571)"),
    ],
)
def test_labels_exchanged_in_the_sweep_of_the_remote_centre_are_refused(
    takes: tuple[Path, Path],
    one: str,
    two: str,
    off: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    axes, rcm = takes[0], exchanged(takes[1], one, two, tmp_path)
    assert main(["calibrate", str(axes), "--rcm", str(rcm), "--arm", "psm"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"trocar: error: {rcm}: too far from the description")
    assert off in error and "labelled wrongly" in error


def test_exchanged_links_of_a_small_linkage_are_refused_by_a_smaller_bound(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = Path(__file__).parents[2] / "examples" / "mechanisms" / "four_bar_gripper.toml"
    made = simulate_tracks(load_arm(arm), MocapSettings("kinematic", "axes", 6.0, 0.6, 40.0))
    path = tmp_path / "gripper.csv"
    write_tracks(path, made)
    assert main(["calibrate", str(path), "--arm", str(arm)]) == 0
    out = exchanged(path, "four_bar_gripper_crank", "four_bar_gripper_rocker", tmp_path)
    capsys.readouterr()
    assert main(["calibrate", str(out), "--arm", str(arm)]) == 2
    error = capsys.readouterr().err
    assert "A-B 46.0 mm (nominal 40.0)" in error and "within 4.6 mm" in error


@pytest.mark.slow
def test_a_plan_is_a_table_a_document_and_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    words = ["calibrate-plan", "--arm", "psm", "--duration", "6"]
    assert main([*words, "--json", "--report", str(tmp_path)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["sweep_longer"]["distance 3-6"] in document["sweeps_s"]
    sigma = [one["sigma"]["distance 3-6"] for one in document["by_amplitude"]]
    assert sigma == sorted(sigma, reverse=True)  # wider sweeps are better
    assert "remote centre" in (tmp_path / "index.html").read_text(encoding="utf-8")
    for wrong, text in ((["--rate", "0"], "--rate: got 0; allowed: 1 to 10000 Hz"),):
        assert main([*words, *wrong]) == 2
        assert text in capsys.readouterr().err


def test_readings_of_the_arms_themselves_register_their_bases(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, output = tmp_path / "touches.toml", tmp_path / "registration.toml"
    assert main(["touches", "--arm", "PSM1=psm", "--arm", "PSM2=psm", "-o", str(file)]) == 0
    truth = json.loads((tmp_path / "touches.toml.truth.json").read_text())
    capsys.readouterr()
    words = ["calibrate-bases", str(file), "-o", str(output)]
    assert main(words) == 0
    assert "T_PSM1_PSM2" in capsys.readouterr().out
    found = tomllib.loads(output.read_text())["arms"]["PSM1"]
    off = np.array(found["xyz_m"]) - np.array(truth["PSM1"]["T_reference_base"])[:3, 3]
    assert (np.abs(off) < 4.0 * np.array(found["xyz_sigma_m"])).all()
    assert main([*words, "--overwrite", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)["bases"]) == {"T_PSM1_PSM2"}
    for wrong, text in (
        (["calibrate-bases"], "the following arguments are required: TOUCHES"),
        (["calibrate", "tracks.csv"], "the following arguments are required: --arm"),
        (["touches", "--arm", "psm", "-o", str(file)], "--arm: got 'psm'; allowed: NAME=ARM"),
    ):
        assert main(wrong) == 2
        assert text in capsys.readouterr().err


def test_setup_joints_are_calibrated_joint_by_joint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tracks, overlay = str(tmp_path / "suj.csv"), str(tmp_path / "suj.toml")
    sweep = ["--motion", "kinematic", "--rate", "20", "--perturb", "3"]
    assert main(["mocap", "--arm", "suj_ecm", *sweep, "-o", tracks, "--json"]) == 0
    truth = json.loads(capsys.readouterr().out)["joints"]["distances_m"]
    words = ["calibrate", tracks, "--arm", "suj_ecm"]
    assert main([*words, "-o", overlay, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["joints"]["distances_m"]
    for label, value in truth.items():
        assert abs(found[label]["value"] - value) < 4.0 * found[label]["sigma"] < 1e-3
    assert main(["show", "suj_ecm", "--calibration", overlay]) == 0
    assert main([*words, "-o", overlay, "--overwrite"]) == 0
    assert "suj_2-suj_3" in capsys.readouterr().out
    assert main([*words, "--closure", "general"]) == 2
    assert (
        "--closure: has no effect here; allowed with an arm that has closed loops"
        in capsys.readouterr().err
    )
