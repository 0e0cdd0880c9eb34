"""Draw the scenes of `trocar.tasks`: docs/images/scenes.jpg and scenes.mp4.

python tools/docs/scene_pictures.py [FOLDER [--stills]]

The picture shows each scene in the middle of an episode, as the endoscope sees it with the surgical
look and from the room; the video, which --stills leaves out, the first ten seconds of an episode of
each, side by side.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from benchmarks.tasks import own_scenes
from trocar.cameras.records import CameraDescription
from trocar.descriptions import load_rig
from trocar.descriptions.catalogue import load_scene
from trocar.geometry.se3 import transform
from trocar.rendering import Endoscope, Look
from trocar.rendering.film import video
from trocar.tasks import make_task
from trocar.tasks.controller import PERIOD_S

FOLDER = Path(__file__).parents[2] / "docs" / "images"
#: Size of a picture, scenes in a row, quality of the sheet, pictures a second, length [s].
SIZE, ACROSS, QUALITY, RATE_HZ, LENGTH_S = (256, 144), 7, 80, 12.5, 10.0
#: When pictures are taken: something is held or moved then. [s]
WHEN_S = {
    "dynamic-pendulum": 0.6,
    "dynamic-stack": 8.0,
    "needle-pick": 1.2,
    "match-board": 9.0,
    "needle-handover": 3.6,
    "needle-regrasp": 3.6,
    "thread-handover": 2.6,
    "thread-knot": 3.5,
    "tissue-retraction": 2.0,
}
DEFAULT_S = 2.2
#: Where the room's camera is, and what it looks at [m].
EYE, TARGET = np.array([0.24, -0.36, 0.26]), np.array([0.0, 0.0, 0.05])

Picture = NDArray[np.uint8]


def main(words: list[str]) -> None:
    """Write both files, or the picture alone."""
    folder, stills = Path(words[0]) if words else FOLDER, "--stills" in words
    names = [n for n in own_scenes() if load_scene(n).rig.objects]  # others show arms alone
    width, height = SIZE
    rows = -(-len(names) // ACROSS)
    sheet = np.zeros((2 * rows * height, ACROSS * width, 3), np.uint8)
    film = np.zeros((round(RATE_HZ * LENGTH_S), rows * height, ACROSS * width, 3), np.uint8)
    for k, name in enumerate(names):
        down, across = (k // ACROSS) * height, (k % ACROSS) * width
        columns = slice(across, across + width)
        when = round(WHEN_S.get(name, DEFAULT_S) * RATE_HZ)
        count = when + 1 if stills else len(film)
        for n, (left, still) in enumerate(islice(pictures(name, when, not stills), count)):
            film[n, down : down + height, columns] = left
            if still is not None:
                sheet[2 * down : 2 * (down + height), columns] = still
        print(name, file=sys.stderr)
    Image.fromarray(sheet).save(folder / "scenes.jpg", quality=QUALITY)
    if stills:
        return
    size = ACROSS * width, rows * height
    with video(folder / "scenes.mp4", size, RATE_HZ, overwrite=True) as add:
        for picture in film:
            add(picture)


def pictures(name: str, when: int, film: bool) -> Iterator[tuple[Picture, Picture | None]]:
    """Yield the left eye's pictures of an episode, black without a film, and at one both stills."""
    scene = load_scene(name)
    cameras = (*scene.rig.cameras, room())
    task = make_task(replace(scene, rig=replace(scene.rig, cameras=cameras)))
    eyes = task.world.camera("endoscope").calibration.resized(*SIZE)
    plain, surgical = Look(samples=4), Look(style="surgical", samples=4)
    task.reset(0)
    policy, every = task.policy(), round(1.0 / (RATE_HZ * PERIOD_S))
    with closing(Endoscope(task.world, calibration=eyes, look=plain)) as scope:
        for n in range(round(RATE_HZ * LENGTH_S)):
            still = None
            if n == when:
                with (
                    closing(Endoscope(task.world, calibration=eyes, look=surgical)) as wet,
                    closing(Endoscope(task.world, "room", look=plain)) as view,
                ):
                    seen = named(name, wet.capture().left), np.asarray(view.capture().left)
                    still = np.concatenate(seen)
            black = np.zeros((*SIZE[::-1], 3), np.uint8)
            yield named(name, scope.capture_next().left) if film else black, still
            for _ in range(every):
                action = next(policy, None)
                if not task.done:
                    task.command(task.stay() if action is None else action)


def named(name: str, picture: Picture) -> Picture:
    """Return a picture with a name in its corner."""
    image = Image.fromarray(np.asarray(picture))
    pen = ImageDraw.Draw(image)
    pen.text((6, 4), name, fill="white", font_size=12, stroke_width=1, stroke_fill="black")
    return np.asarray(image)


def room() -> CameraDescription:
    """Return a camera in the room that looks at the table."""
    ahead = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    turn = np.column_stack([right, np.cross(ahead, right), ahead])
    like = next(camera for camera in load_rig("full_cart").cameras if camera.kind == "view")
    return replace(
        like, name="room", pose=transform(turn, EYE), calibration=like.calibration.resized(*SIZE)
    )


if __name__ == "__main__":
    main(sys.argv[1:])
