"""Still pictures: what is there is in them, at the size that the view promises."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from trocar.cli import main
from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import TrocarError
from trocar.rendering import portrait

SIZE = (160, 120)


def picture(rig, **options) -> np.ndarray:
    try:
        return portrait(rig, size=SIZE, **options)
    except TrocarError as problem:
        pytest.skip(str(problem))


@pytest.mark.parametrize("view", ["front", "side", "top", "three_quarter"])
def test_an_arm_fills_its_picture_and_touches_no_edge(view) -> None:
    image = picture(lone_arm_rig(load_arm("psm")), view=view)
    assert image.shape == (120, 160, 3)
    drawn = np.argwhere((image < 250).any(axis=2))
    span = (drawn.max(axis=0) - drawn.min(axis=0) + 1) / [120, 160]
    assert span.max() > 0.6
    assert drawn.min() > 0 and drawn[:, 0].max() < 119 and drawn[:, 1].max() < 159


def test_the_arm_stands_as_it_is_told() -> None:
    rig = lone_arm_rig(load_arm("psm"))
    turned = np.array([0.5, 0.3, 0.1, 0.0, 0.0, 0.0, 0.0])
    assert (picture(rig, view="front") != picture(rig, view="front", q={"PSM1": turned})).any()


def test_a_rig_s_floor_is_left_out() -> None:
    image = picture(load_rig("psm"), view="top")
    assert (image[[0, 0, -1, -1], [0, -1, 0, -1]] == 255).all()


@pytest.mark.slow
def test_show_writes_four_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture(lone_arm_rig(load_arm("psm")))
    assert main(["show", "ecm", "--picture", str(tmp_path / "ecm")]) == 0
    names = ["front", "side", "top", "three_quarter"]
    assert capsys.readouterr().out.split() == [str(tmp_path / "ecm" / f"{n}.png") for n in names]
    with Image.open(tmp_path / "ecm" / "side.png") as image:
        assert image.size == (1200, 900)


def test_a_folder_that_cannot_be_written_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture(lone_arm_rig(load_arm("psm")))
    (tmp_path / "taken").touch()
    assert main(["show", "ecm", "--picture", str(tmp_path / "taken")]) == 2
    assert "taken: cannot be written: " in capsys.readouterr().err
