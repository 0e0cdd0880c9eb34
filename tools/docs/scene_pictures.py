"""Draw the scenes of `trocar.apps.tasks` in the middle of episodes: docs/images/scenes.jpg.

python tools/docs/scene_pictures.py [FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from benchmarks.tasks import own_scenes
from trocar.apps.task import Task
from trocar.apps.tasks import make_task
from trocar.descriptions.catalogue import load_scene
from trocar.rendering import Endoscope, Look

FILE = Path(__file__).parents[2] / "docs" / "images" / "scenes.jpg"
#: Size of a picture, pictures in a row, quality.
SIZE, COLUMNS, QUALITY = (320, 180), 6, 85
#: When pictures are taken: something is held or moved then. [s]
WHEN_S = {
    "dynamic-pendulum": 0.6,
    "dynamic-stack": 8.0,
    "needle-pick": 1.2,
    "match-board": 9.0,
    "needle-handover": 3.6,
    "needle-regrasp": 3.6,
}
DEFAULT_S = 2.2


def main(words: list[str]) -> None:
    """Write the sheet."""
    names = [n for n in own_scenes() if load_scene(n).arms != ("ECM",)]  # nothing is drawn there
    width, height = SIZE
    rows = -(-len(names) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width, rows * height))
    for k, name in enumerate(names):
        task = make_task(name)
        picture = Image.fromarray(middle(task)).resize(SIZE, Image.Resampling.LANCZOS)
        ImageDraw.Draw(picture).text((8, 6), name, fill="white", font_size=13, stroke_width=1)
        sheet.paste(picture, ((k % COLUMNS) * width, (k // COLUMNS) * height))
        print(name, file=sys.stderr)
    sheet.save(words[0] if words else FILE, quality=QUALITY)


def middle(task: Task) -> np.ndarray:
    """Return what the left eye sees in the middle of an episode, (height, width, 3)."""
    task.reset(0)
    for action in task.policy():
        if task.done or task.time >= WHEN_S.get(task.scene.name, DEFAULT_S):
            break
        task.command(action)
    scope = Endoscope(task.world, "endoscope", look=Look())
    try:
        return np.asarray(scope.capture().left)
    finally:
        scope.close()


if __name__ == "__main__":
    main(sys.argv[1:])
