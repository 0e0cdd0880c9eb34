"""Draw a stitch as the endoscope sees it: docs/images/suturing.jpg and suturing.mp4.

python tools/docs/suturing_pictures.py [FOLDER]

The picture shows one moment of each part of the stitch, the video the whole stitch in real time.
"""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.suturing_scenes import suturing_scene
from trocar.descriptions.cameras import load_camera
from trocar.rendering import Endoscope, Look
from trocar.rendering.film import video
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.scenes.suturing import Suturing

FOLDER = Path(__file__).parents[2] / "docs" / "images"
#: The episode; size, rate and quality of the video; quality of the picture.
SEED, SIZE, RATE_HZ, FILM_QUALITY, QUALITY = 3, (480, 360), 12.5, 5.0, 85
#: Words of banners, and the share of the time that each is shown after which it is drawn.
MOMENTS = (("approach", 0.3), ("drive", 0.35), ("takes", 0.8), ("needle out", 0.9), ("done", 0.0))
#: Part of the video that the picture shows: rows and columns about the wound.
PART = slice(45, 285), slice(30, 350)


def main(words: list[str]) -> None:
    """Write both files."""
    folder = Path(words[0]) if words else FOLDER
    task = Suturing(suturing_scene())
    task.reset(SEED)
    eyes = load_camera("dvrk_sd_640x480").resized(*SIZE)
    look = Look(style="surgical", samples=4)
    policy, every = task.policy(), round(1.0 / (RATE_HZ * PERIOD_S))
    shown: dict[str, list[NDArray[np.uint8]]] = {}
    with (
        closing(Endoscope(task.world, calibration=eyes, look=look)) as scope,
        video(folder / "suturing.mp4", SIZE, RATE_HZ, overwrite=True, quality=FILM_QUALITY) as add,
    ):
        while not task.done:
            picture = task.picture(lambda: scope.capture().left)
            shown.setdefault(task.banner, []).append(picture)
            add(picture)
            for _ in range(every):
                action = next(policy, None)
                if not task.done:
                    task.command(task.stay() if action is None else action)
    strip: list[NDArray[np.uint8]] = []
    for word, share in MOMENTS:
        pictures = next(found for banner, found in shown.items() if word in banner)
        strip.append(pictures[int(share * (len(pictures) - 1))][PART])
    Image.fromarray(np.concatenate(strip, axis=1)).save(folder / "suturing.jpg", quality=QUALITY)


if __name__ == "__main__":
    main(sys.argv[1:])
