"""Draw the pictures of the web viewer's gallery: src/trocar/viewer/pictures/NAME.jpg.

python tools/docs/gallery_pictures.py [NAME ...]

A scene is shown in the middle of an episode of its policy, a rig at its start, from the room.
"""

from __future__ import annotations

import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tools.docs.scene_pictures import DEFAULT_S, EYE, TARGET, WHEN_S
from trocar.cameras.records import CameraDescription
from trocar.descriptions import load_rig, names
from trocar.descriptions.catalogue import load_scene
from trocar.geometry.se3 import transform
from trocar.rendering import Endoscope, Look
from trocar.simulation import World
from trocar.tasks import Task, make_task
from trocar.tasks.controller import PERIOD_S
from trocar.viewer.scene import VIEW, camera_for, corners

FOLDER = Path(__file__).parents[2] / "src" / "trocar" / "viewer" / "pictures"
#: Size and quality: sharp on a card of 200 pixels, and small in the wheel.
SIZE, QUALITY = (240, 150), 72
#: Scenes whose policy takes long, and one without one: shown at their start [s].
AT_S = {**WHEN_S, "thread-knot": 0.0, "suturing": 0.0}

Array = NDArray[np.float64]


def main(words: list[str]) -> None:
    """Write the pictures of the names that are given, or of all."""
    for name in words or (*names("scenes"), *names("rigs")):
        picture = of_scene(name) if name in names("scenes") else of_rig(name)
        Image.fromarray(picture).save(FOLDER / f"{name}.jpg", quality=QUALITY, optimize=True)
        print(name, file=sys.stderr)


def of_scene(name: str) -> NDArray[np.uint8]:
    """Return a scene in the middle of its episode."""
    scene = load_scene(name)
    cameras = (*scene.rig.cameras, room(EYE, TARGET))
    task = make_task(replace(scene, rig=replace(scene.rig, cameras=cameras)))
    task.reset(0)
    if type(task).policy is not Task.policy:
        policy = task.policy()
        for _ in range(round(AT_S.get(name, DEFAULT_S) / PERIOD_S)):
            action = next(policy, None)
            if task.done:
                break
            task.command(task.stay() if action is None else action)
    return drawn(task.world)


def of_rig(name: str) -> NDArray[np.uint8]:
    """Return a rig at its start."""
    rig, world = load_rig(name), World(name)
    arms = [shape for shape in world.shapes() if shape.arm]
    eye, target = camera_for(corners(arms, world.snapshot()), VIEW)
    return drawn(World(replace(rig, cameras=(room(eye, target),))))


def drawn(world: World) -> NDArray[np.uint8]:
    """Return what the camera in the room sees."""
    with closing(Endoscope(world, "room", look=Look(samples=4))) as view:
        return np.asarray(view.capture().left)


def room(eye: Array, target: Array) -> CameraDescription:
    """Return a camera at a place that looks at another [m]."""
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    turn = np.column_stack([right, np.cross(ahead, right), ahead])
    like = next(camera for camera in load_rig("full_cart").cameras if camera.kind == "view")
    seen = like.calibration.resized(*SIZE)
    return replace(like, name="room", pose=transform(turn, eye), calibration=seen)


if __name__ == "__main__":
    main(sys.argv[1:])
