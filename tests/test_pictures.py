"""Pictures of the pages: they are what the commands beside them draw."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from trocar.cli import main

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
SHOWN = re.compile(r"!\[[^\]]*\]\(([^)]+\.(?:jpg|png))\)")
#: What draws a picture: a command of trocar, or a program of tools/docs.
DRAWS = re.compile(r"`((?:trocar render|python tools/docs/\w+\.py)[^`]*)`")
#: Pictures without such a command beside them, by their origin.
OTHERWISE = {
    "screenshots in a browser (tools/docs/viewer_picture.py)": (
        "cart.png", "mirror.png", "si-cart.png", "teleoperation.png", "viewer-depth.png",
        "viewer-branch.png", "viewer-forces.png", "viewer-gallery.png", "viewer-gone.png",
        "viewer-hands.png", "viewer-help.png", "viewer-levels.png", "viewer-outline.png",
        "viewer-people.png", "viewer-phone.png", "viewer-reach.png", "viewer-recording.png",
        "viewer-scene.png", "viewer-upload.png",
        "your-lab-si.png", "props.png",
    ),
    "another program": ("rviz-full-cart.png",),
    "plots of measurements": (
        "assistance.png", "dynamics-mtmr.png", "dynamics-psm.png", "recording-plot.png",
        "scripts-circle.png", "soak.png", "verify-remote-centre.png",
    ),
    "a board before the scope, as tests draw it": ("board.jpg", "checkerboard.png"),
}  # fmt: skip
#: Folders of the solids (`make cad`) and of the tutorial's notebooks.
FOLDERS = "arms/", "tutorial/"
#: Width to which pictures are reduced [px], and differences that are allowed there, of 255: the
#: mean, and what all but a hundredth are below. Source: drawn again on one machine 0 to 0.6 and 0
#: to 5 (JPEG); other drivers round edges otherwise; an instrument elsewhere has a mean of 5.
WIDTH, MEAN, MOST = 96, 3.0, 20.0


def commands() -> dict[str, list[str]]:
    """Return the commands in the paragraph below each picture of a page, by its path."""
    found: dict[str, list[str]] = {}
    for page in PAGES:
        paragraphs = page.read_text(encoding="utf-8").split("\n\n")
        for row, paragraph in enumerate(paragraphs):
            below = " ".join(paragraphs[row + 1 : row + 2])
            drawn = DRAWS.findall(below) if paragraph.startswith("![") else []
            for shown in SHOWN.findall(paragraph):
                name = (page.parent / shown).resolve().relative_to(ROOT / "docs").as_posix()
                name = name.removeprefix("images/")
                found.setdefault(name, []).extend(drawn)
    return found


DRAWN = {name: some for name, some in commands().items() if some}


def test_every_picture_has_the_command_that_draws_it_or_a_known_origin() -> None:
    without = {n for n in commands() if n not in DRAWN and not n.startswith(FOLDERS)}
    assert without == {name for some in OTHERWISE.values() for name in some}
    assert len(DRAWN) >= 11


def test_a_picture_that_differs_is_noticed() -> None:
    picture = np.asarray(Image.open(IMAGES / "endoscope-eyes.jpg"))
    assert differences(picture, picture) == (0.0, 0.0)
    for other in (np.roll(picture, 40, axis=1), picture // 2, picture[:, ::-1]):
        mean, most = differences(picture, other)
        assert mean > MEAN or most > MOST


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("name", DRAWN)
def test_a_picture_is_what_the_command_beside_it_draws(name: str, tmp_path: Path) -> None:
    drawn: list[NDArray[np.uint8]] = []
    for command in dict.fromkeys(DRAWN[name]):
        program, *words = shlex.split(command)
        if program == "trocar":
            words[words.index("-o") + 1] = path = str(tmp_path / words[words.index("-o") + 1])
            assert main(words) == 0
            drawn.append(np.asarray(Image.open(path).convert("RGB")))
        else:
            tool, *rest = words
            arguments = [str(tmp_path), *(word for word in rest if word != "docs/images")]
            importlib.import_module(f"tools.docs.{Path(tool).stem}").main(arguments)
            drawn.append(np.asarray(Image.open(tmp_path / name).convert("RGB")))
    shown = np.asarray(Image.open(IMAGES / name).convert("RGB"))
    mean, most = differences(shown, np.concatenate(drawn, axis=1))
    assert mean < MEAN and most < MOST


def differences(one: NDArray[np.uint8], two: NDArray[np.uint8]) -> tuple[float, float]:
    """Return mean and 99th percentile of the differences of reduced pictures, of 255."""
    ratio = one.shape[0] / one.shape[1]
    assert two.shape[0] / two.shape[1] == pytest.approx(ratio, rel=0.01)
    size = WIDTH, round(WIDTH * ratio)
    small = [
        np.asarray(Image.fromarray(each).resize(size, Image.Resampling.BOX)) for each in (one, two)
    ]
    off = np.abs(small[0].astype(float) - small[1])
    return float(off.mean()), float(np.percentile(off, 99.0))
