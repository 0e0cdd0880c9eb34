"""`trocar sample`: the same files everywhere, which the tour of README.md uses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_samples_are_the_same_each_time_and_small(trocar, tmp_path):
    pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    answer = trocar("sample", tmp_path / "one")
    assert (answer.status, answer.err) == (0, "")
    document = trocar("sample", tmp_path / "two", "--json").document
    one, two = contents(tmp_path / "one"), contents(tmp_path / "two")
    assert one == two
    assert set(document["files"]) <= set(one)
    assert all(name in answer.out for name in document["files"])
    assert sum(map(len, one.values())) < 3_000_000
    truth = json.loads(one["tracks.csv.truth.json"])
    assert truth["robot"] == "perturbed with seed 7"


def test_the_files_of_a_simulated_robot_say_so(trocar, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    files = trocar("sample", tmp_path / "new", "--json").document["files"]
    recorded = ("psm_log.csv.gz", "psm.bag", "tracks.csv", "touches.toml")
    assert [files[name] for name in recorded if "simulated" not in files[name]] == []


def test_a_folder_that_holds_something_is_left_alone(trocar, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    answer = trocar("sample", tmp_path)
    assert answer.status == 2
    assert "is not empty (got mine.txt)" in answer.complaint
    assert contents(tmp_path) == {"mine.txt": b"mine"}
