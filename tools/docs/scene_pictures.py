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
from trocar.rendering import Endoscope, Look

FILE = Path(__file__).parents[2] / "docs" / "images" / "scenes.jpg"
#: When the picture is taken, of the episode; size of a picture, pictures in a row, quality.
SHARE, SIZE, COLUMNS, QUALITY = 0.45, (400, 225), 4, 82


def main(words: list[str]) -> None:
    """Write the sheet."""
    names = own_scenes()
    width, height = SIZE
    rows = -(-len(names) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width, rows * height))
    for k, name in enumerate(names):
        task = make_task(name)
        picture = Image.fromarray(middle(task)).resize(SIZE, Image.Resampling.LANCZOS)
        ImageDraw.Draw(picture).text((8, 6), name, fill="white", font_size=15, stroke_width=1)
        sheet.paste(picture, ((k % COLUMNS) * width, (k // COLUMNS) * height))
        print(name, file=sys.stderr)
    sheet.save(words[0] if words else FILE, quality=QUALITY)


def middle(task: Task) -> np.ndarray:
    """Return what the left eye sees in the middle of an episode, (height, width, 3)."""
    actions: list[np.ndarray] = []
    task.reset(0)
    for action in task.policy():
        actions.append(action)
        task.command(action)
        if task.done:
            break
    task.reset(0)
    for action in actions[: round(SHARE * len(actions))]:
        task.command(action)
    scope = Endoscope(task.world, "endoscope", look=Look())
    try:
        return np.asarray(scope.capture().left)
    finally:
        scope.close()


if __name__ == "__main__":
    main(sys.argv[1:])
