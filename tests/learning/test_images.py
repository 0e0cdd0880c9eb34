from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError, UnknownNameError
from trocar.learning.images import SceneCamera
from trocar.learning.task_env import TaskEnv
from trocar.tasks import make_task


def test_channels_are_of_the_same_pixels() -> None:
    task = make_task("needle-pick")
    camera = SceneCamera(task, 128, ("ids", "depth", "rgb"), 2)
    image = camera.capture()
    assert image.shape == camera.shape == (128, 128, 10)
    assert image.dtype == np.uint8
    assert camera.names[:3] == ("left.ids", "left.depth", "left.red")
    assert camera.names[5] == "right.ids"
    seen = set(np.unique(image[..., 0]).tolist())
    assert seen == {0, camera.ids["needle"], camera.ids["PSM1"]}
    instrument = image[..., 0] == camera.ids["PSM1"]
    background = image[..., 0] == 0
    assert image[instrument][:, 1].mean() < image[background][:, 1].mean()  # it is nearer
    both = SceneCamera(task, 128, ("rgb",), 2).capture()
    assert np.array_equal(both, np.concatenate([image[..., 2:5], image[..., 7:]], axis=2))
    camera.close()


def test_depth_is_in_millimetres() -> None:
    task = make_task("needle-pick")
    camera = SceneCamera(task, 84, ("depth", "ids"))
    image = camera.capture()
    T = task.world.camera("endoscope").T_world_left
    at = T[:3, :3].T @ (task.object_pose("needle")[:3, 3] - T[:3, 3])
    needle = image[image[..., 1] == camera.ids["needle"]][:, 0]
    assert abs(needle.mean() - 1000.0 * at[2]) < 8.0  # the needle's arc is 10 mm across


def test_images_follow_from_the_seed() -> None:
    def last() -> Any:
        env = TaskEnv("peg-transfer", obs="state+image", action="tip")
        env.reset(3)
        env.step(np.full(7, 0.2))
        return env.observe()["image"]

    assert np.array_equal(last(), last())


def test_the_exposure_does_not_follow_the_moment() -> None:
    task = make_task("bi-peg-transfer")
    camera = SceneCamera(task, 84, ("rgb", "ids"))
    before = camera.capture().astype(int)
    action = task.stay()
    action[[0, 1, 7, 8]] = -0.08, -0.1, 0.08, -0.1  # both instruments come into the picture
    for _ in range(20):
        task.command(action)
    after = camera.capture().astype(int)
    board = (before[..., 3] == 0) & (after[..., 3] == 0)
    assert (after[..., 3] > 0).sum() > (before[..., 3] > 0).sum() + 100
    assert np.abs(after - before)[board].max() <= 1
    again = SceneCamera(task, 84, ("rgb", "ids")).capture()  # made at another moment
    assert np.array_equal(again, after)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"channels": ("rgb", "dept")}, "unknown channel 'dept' .did you mean 'depth'"),
        ({"channels": ()}, "each of rgb, depth, ids at most once"),
        ({"eyes": 3}, "eyes: got 3; allowed: 1 or 2"),
        ({"size": 8}, "image_size: got 8; allowed: 16 to 512"),
        ({"size": (84, 84, 3)}, "image_size: got .84, 84, 3.; allowed: an edge, or width"),
    ],
)
def test_settings_that_are_not_allowed_are_named(settings: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        SceneCamera(make_task("needle-pick"), **settings)


def test_a_scene_without_an_endoscope_has_no_images() -> None:
    scene = load_scene("needle-pick")
    blind = replace(scene, rig=replace(scene.rig, cameras=()))
    with pytest.raises(InputError, match=r"needle-pick: images: the rig .* has no endoscope"):
        TaskEnv(blind, obs="image")
    with pytest.raises(UnknownNameError, match="unknown observation 'images'"):
        TaskEnv(blind, obs="images")
