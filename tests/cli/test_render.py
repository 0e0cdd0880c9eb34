"""trocar render: what it writes, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from trocar.cli import main


@pytest.mark.usefixtures("opengl")
def test_a_picture_of_both_eyes_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "scope.png"
    options = ["--preset", "dvrk_sd_640x480", "--rig", "two_psm_ecm"]
    assert main(["render", "-o", str(path), *options]) == 0
    assert capsys.readouterr().out == f"{path}: 1280 x 480\n"
    both = np.asarray(Image.open(path)).astype(int)
    assert both.shape == (480, 1280, 3)
    assert np.abs(both[:, :640] - both[:, 640:]).max() > 20
    assert both.max() > 60


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("show", ["depth", "ids", "normals"])
def test_depth_ids_and_normals_are_written(show: str, tmp_path: Path) -> None:
    path = tmp_path / "scope.png"
    options = ["--rig", "two_psm_ecm", "--show", show, "--eye", "left"]
    assert main(["render", "-o", str(path), *options]) == 0
    assert len(np.unique(np.asarray(Image.open(path)).reshape(-1, 3), axis=0)) > 3


@pytest.mark.usefixtures("opengl")
def test_a_video_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not there")
    path = tmp_path / "room.mp4"
    options = ["--camera", "room", "--duration", "0.4", "--rate", "10", "--json"]
    assert main(["render", "-o", str(path), *options]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"file": str(path), "width": 1280, "height": 720, "pictures": 4}
    assert path.stat().st_size > 1000


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["-o", "scope.gif"], "allowed: .png, .jpg, .jpeg, .mp4"),
        (["-o", "nowhere/scope.png"], "no folder"),
        (["-o", "scope.png", "--rig", "psm"], "has no camera"),
        (["-o", "scope.png", "--rig", "ecm", "--camera", "kitchen"], "known: endoscope"),
        (["-o", "scope.png", "--rig", "ecm", "--preset", "kitchen"], "dvrk_sd_640x480"),
        (["-o", "scope.png", "--rig", "ecm", "--pose", "kitchen"], "unknown pose"),
        (["-o", "scope.png", "--rig", "ecm", "--noise", "7"], "noise: got 7"),
        (["-o", "scope.png", "--rig", "ecm", "--exposure", "bright"], 'of stops, or "auto"'),
        (["-o", "scope.png", "--rig", "ecm", "--exposure", "99"], "exposure: got 99"),
        (["-o", "scope.png", "--rig", "ecm", "--angle", "45"], "45"),
        (["-o", "scope.png", "--rig", "ecm", "--after", "-1"], "--after: got -1"),
        (["-o", "scope.png", "--rig", "ecm", "--duration", "3"], "with a video (.mp4) only"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_what_is_allowed(
    options: list[str], complaint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    pytest.importorskip("moderngl", reason="the extra `scope` is not there")
    monkeypatch.chdir(tmp_path)
    assert main(["render", *options]) == 2
    assert complaint in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
