"""trocar learn train and trocar learn evaluate."""

import csv
import json
from pathlib import Path

import pytest

from trocar.cli.program import main


def test_a_clone_is_trained_written_and_plays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch", reason="training needs PyTorch")
    out = tmp_path / "run"
    words = ["learn", "train", "needle-reach", "--method", "bc", "--episodes", "8"]
    words += ["--steps", "150", "--copies", "1", "--shift", "3"]
    words += ["--no-video", "--json", "-o", str(out)]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["episodes"] == 8
    assert document["settings"]["shift_m"] == pytest.approx(3e-3)
    assert document["settings"]["turn_rad"] == pytest.approx(0.075)
    assert document["command"].startswith("trocar learn train needle-reach --method bc")
    written = {file.name for file in out.iterdir()}
    assert {"policy.toml", "policy.safetensors", "curve.csv", "training.json"} <= written
    rows = list(csv.DictReader((out / "curve.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["step"] for row in rows] == ["100", "150"]
    assert float(rows[-1]["loss"]) < float(rows[0]["loss"])
    words = ["learn", "evaluate", "needle-reach", "--policy", str(out / "policy.toml")]
    assert main([*words, "--seeds", "3", "--json"]) == 0
    own, scripted = json.loads(capsys.readouterr().out)["policies"]
    assert (own["policy"], scripted["policy"]) == ("policy.toml", "scripted")
    assert scripted["successes"] == scripted["episodes"] == own["episodes"] == 3
    assert own["distance_m"] != scripted["distance_m"]
    assert main([*words[:3], "--seeds", "2"]) == 0
    assert "scripted" in capsys.readouterr().out


def test_a_folder_with_a_policy_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch", reason="training needs PyTorch")
    (tmp_path / "policy.toml").touch()
    assert main(["learn", "train", "needle-reach", "--method", "bc", "-o", str(tmp_path)]) == 2
    assert "exists; allowed: a new folder, or --overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("method", "option", "message"),
    [
        ("bc", ["--archive"], "--archive: has no effect here; allowed with --method sac-her"),
        ("ppo", ["--episodes", "3"], "--episodes: has no effect here; allowed with --method bc"),
        ("bc", ["--steps", "0"], "--steps: got 0; allowed: 1 or more"),
        ("bc", ["--epochs", "2", "--steps", "3"], "--steps: has no effect here; allowed without"),
        ("bc", ["--seed", "-1"], "--seed: got -1; allowed: 0 or more"),
        ("bc", ["--copies", "-1"], "--copies: got -1; allowed: 0 or more"),
        ("bc", ["--shift", "0"], "--shift: got 0; allowed: above 0 mm"),
    ],
)
def test_options_without_effect_are_refused(
    method: str, option: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["learn", "train", "needle-reach", "--method", method, "-o", str(tmp_path / "run")]
    assert main([*words, *option]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["needle-pik"], "unknown scene 'needle-pik' (did you mean 'needle-pick'?)"),
        (["needle-pick", "--data", "nowhere"], "nowhere/meta/info.json: no such file"),
    ],
)
def test_bad_input_makes_no_folder(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch", reason="training needs PyTorch")
    out = tmp_path / "run"
    assert main(["learn", "train", *words, "--method", "bc", "-o", str(out)]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_errors_of_robots_change_the_episodes(capsys: pytest.CaptureFixture[str]) -> None:
    paths: list[float] = []
    for errors in ([], ["--errors", "lab"]):
        assert main(["learn", "evaluate", "needle-reach", "--seeds", "2", *errors, "--json"]) == 0
        (found,) = json.loads(capsys.readouterr().out)["policies"]
        paths.append(found["distance_m"])
    assert paths[0] != paths[1]


def test_errors_of_robots_replace_those_of_a_preset_of_worlds(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["learn", "evaluate", "needle-reach", "--seeds", "3", "--json", "--randomise", "lab"]
    successes: list[int] = []
    for errors in ([], ["--errors", "perfect"]):
        assert main([*words, *errors]) == 0
        successes.append(json.loads(capsys.readouterr().out)["policies"][0]["successes"])
    assert successes[0] < successes[1] == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--trust"], "--trust: has no effect here; allowed with --policy FILE.zip"),
        (["--cluster", "host:1", "--workers", "2"], "--workers: has no effect here"),
    ],
)
def test_options_without_effect_on_an_evaluation_are_refused(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["learn", "evaluate", "needle-reach", *words]) == 2
    assert message in capsys.readouterr().err


def test_bad_numbers_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["learn", "evaluate", "needle-reach", "--seeds", "0"]) == 2
    assert "--seeds: got 0; allowed: 1 or more" in capsys.readouterr().err
    assert main(["learn", "evaluate", "needle-reach", "--errors", "labb"]) == 2
    assert "did you mean 'lab'?" in capsys.readouterr().err
