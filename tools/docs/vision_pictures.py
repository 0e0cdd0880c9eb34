"""Draw the scenes of the endoscope's images: docs/images/NAME.jpg and NAME.mp4 of each.

python tools/docs/vision_pictures.py [FOLDER [NAME ...]]

The picture shows two moments of an episode, the video some seconds of it: the left eye's images
with what the scene draws into them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.descriptions.catalogue import load_scene
from trocar.rendering.film import video
from trocar.tasks import make_task
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.scenes.vision import EndoscopeTask

FOLDER = Path(__file__).parents[2] / "docs" / "images"
#: Images a second, length [s], size [px] and quality of a video; gap and quality of a picture.
RATE_HZ, LENGTH_S, SMALL, PLAYED, GAP_PX, QUALITY = 12.5, 8.0, (480, 360), 4.4, 10, 85
#: When the video begins, and when both pictures are taken [s].
WHEN_S = {
    "needle-tracking": (0.0, (1.6, 5.4)),
    "augmented-reality": (0.0, (3.4, 5.4)),
    "visual-servoing": (1.0, (3.0, 7.0)),
}
#: Less noise than the scenes have, so that files are small, and smooth edges.
LOOK = {"noise": 0.01, "samples": 4}

Picture = NDArray[np.uint8]


def main(words: list[str]) -> None:
    """Write the files."""
    folder = Path(words[0]) if words else FOLDER
    for name in words[1:] or WHEN_S:
        begin, moments = WHEN_S[name]
        last = max(begin + LENGTH_S, *moments)
        shown = list(islice(images(name), round(RATE_HZ * last) + 1))
        stills = [shown[round(RATE_HZ * moment)] for moment in moments]
        gap = np.full((len(stills[0]), GAP_PX, 3), 255, np.uint8)
        sheet = np.concatenate([stills[0], gap, stills[1]], axis=1)
        Image.fromarray(sheet).save(folder / f"{name}.jpg", quality=QUALITY)
        first = round(RATE_HZ * begin)
        film = folder / f"{name}.mp4"
        with video(film, SMALL, RATE_HZ, overwrite=True, quality=PLAYED) as add:
            for picture in shown[first : first + round(RATE_HZ * LENGTH_S)]:
                add(np.asarray(Image.fromarray(picture).resize(SMALL, Image.Resampling.BOX)))
        print(name, file=sys.stderr)


def images(name: str) -> Iterator[Picture]:
    """Yield the images of an episode as the scene shows them."""
    task = make_task(replace(load_scene(name), look=LOOK))
    assert isinstance(task, EndoscopeTask)  # noqa: S101
    task.reset(0)
    policy = task.policy()
    while not task.done:
        yield task.picture(lambda: np.zeros((1, 1, 3), np.uint8))
        for _ in range(round(1.0 / (RATE_HZ * PERIOD_S))):
            action = next(policy, None)
            if not task.done:
                task.command(task.stay() if action is None else action)
    task.close()


if __name__ == "__main__":
    main(sys.argv[1:])
