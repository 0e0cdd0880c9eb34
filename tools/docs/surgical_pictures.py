"""Draw the surgical style of the endoscope: docs/images/endoscope-surgical.jpg and cavity.jpg.

python tools/docs/surgical_pictures.py [FOLDER]

The style: left as it is, right with blood, smoke, noise and vignette. The cavity: scenes at a
moment of their episodes, as `trocar play SCENE --place cavity --video` draws them.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.needle_stage import held_pose
from trocar.descriptions.catalogue import load_scene
from trocar.geometry import inverse, transform
from trocar.rendering import Endoscope, Look
from trocar.rendering.look import bleeding_place, vignette_of
from trocar.simulation.records import DrawnCurve, DrawnSurface
from trocar.tasks import make_task, scene_with

FOLDER = Path(__file__).parents[2] / "docs" / "images"
SIZE, QUALITY = (640, 480), 85
LOOKS = (
    Look("surgical", samples=4),
    Look("surgical", samples=4, blood=0.1, smoke=0.3, noise=0.02, vignette=0.4),
)
#: Scenes in a cavity: seed, commands before the picture, and bleeding [ml/min].
CAVITY = {
    "needle-pick": (0, 75, 0.0),
    "suturing": (7, 400, 0.0),
    "tissue-retraction": (3, 105, 3.0),
}
#: The tissue: half its side, its vertices a side, the height of its lowest point [m].
HALF_M, VERTICES, BED_M = 0.06, 121, 0.006
#: Where the instruments' tips are, in the world, and how far their jaws are open. [m, rad]
TIPS = {"PSM1": ([0.008, 0.006, 0.026], 0.05), "PSM2": ([-0.020, -0.006, 0.016], 0.6)}


def main(words: list[str]) -> None:
    """Write both files."""
    folder = Path(words[0]) if words else FOLDER
    style().save(folder / "endoscope-surgical.jpg", quality=QUALITY)
    cavity().save(folder / "cavity.jpg", quality=QUALITY)


def cavity() -> Image.Image:
    """Return the scenes in a cavity, beside each other."""
    seen: list[np.ndarray] = []
    for name, (seed, commands, bleeding) in CAVITY.items():
        task = make_task(scene_with(name, {"surroundings": "cavity"}))
        task.reset(seed)
        policy = task.policy()
        for _ in range(commands):
            task.command(next(policy))
        rig = task.world.rig
        look = Look(
            "surgical",
            vignette=vignette_of(rig),
            bleeding=bleeding,
            bleeding_at=bleeding_place(rig),
            samples=4,
        )
        scope = Endoscope(task.world, preset="dvrk_sd_640x480", look=look)
        seen.append(np.asarray(scope.capture().left))
        scope.close()
    return Image.fromarray(np.concatenate(seen, axis=1))


def style() -> Image.Image:
    """Return both pictures of the style beside each other."""
    task = make_task(replace(load_scene("needle-tracking"), welded=()))
    task.reset(4)
    world = task.world
    (needle,) = (prop.needle for prop in world.rig.objects if prop.needle is not None)
    for name, (at, jaw) in TIPS.items():
        arm = world.arms[name]
        T = transform(arm.measured_cp("world").matrix[:3, :3], at)
        q = arm.joints.positions()
        local = inverse(world.reference_pose(name)) @ T
        world.set_state(name, np.append(arm.local.inverse_kinematics(local, q[:-1]), jaw))
    held = held_pose(needle, np.random.default_rng(5))
    T_needle = world.arms["PSM1"].measured_cp("world").matrix @ held
    ground, thread = tissue(), run_of_thread((T_needle @ needle.swage)[:3, 3])
    world.draw("tissue", lambda: ground)
    world.draw("thread", lambda: thread)
    sheet = Image.new("RGB", (2 * SIZE[0], SIZE[1]))
    for k, look in enumerate(LOOKS):
        scope = Endoscope(world, preset="dvrk_sd_640x480", look=look)
        frame = scope.render(world.snapshot(), world.cameras(), poses={"needle": T_needle})
        sheet.paste(Image.fromarray(np.asarray(frame.left)), (k * SIZE[0], 0))
        scope.close()
    return sheet


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of the tissue, soft hills, [m]."""
    hills = np.sin(95.0 * x + 30.0 * y) * np.cos(80.0 * y) + 0.6 * np.sin(170.0 * y - 60.0 * x)
    return BED_M + 0.0016 * (1.6 + hills)


def tissue() -> DrawnSurface:
    """Return a sheet of tissue over the bed."""
    line = np.linspace(-HALF_M, HALF_M, VERTICES)
    x, y = np.meshgrid(line, line)
    points = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    a = (np.arange(VERTICES - 1)[:, None] * VERTICES + np.arange(VERTICES - 1)).ravel()
    b = a + VERTICES
    faces = np.concatenate([np.stack([a, a + 1, b + 1], 1), np.stack([a, b + 1, b], 1)])
    return DrawnSurface("tissue", points, faces, material="tissue", rest=points)


def run_of_thread(start: np.ndarray) -> DrawnCurve:
    """Return a thread from the needle's swage that lies down on the tissue in bends."""
    t = np.linspace(0.0, 1.0, 160)
    x = start[0] + 0.006 * t - 0.007 * np.sin(7.0 * t)
    y = start[1] - 0.030 * t
    lying = height(x, y) + 0.0003
    down = np.clip(t / 0.45, 0.0, 1.0)
    z = start[2] + (lying - start[2]) * down**2 * (3.0 - 2.0 * down)
    return DrawnCurve("thread", np.stack([x, y, z], axis=1), radius=0.0002)


if __name__ == "__main__":
    main(sys.argv[1:])
