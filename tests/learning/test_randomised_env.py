"""Environments of randomised worlds: settings, observations and images."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions.catalogue import load_scene
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.learning.task_env import TaskEnv
from trocar.tasks import make_task


def test_the_setting_is_that_of_the_scene() -> None:
    env = TaskEnv("needle-pick", randomise="lab", tips="camera")
    own = TaskEnv(load_scene("needle-pick").randomised("lab", "camera"))
    seen = [one.reset(3)[0] for one in (env, own)]
    action = np.full(env.actions.low.shape, 0.3, np.float32)
    for _ in range(3):
        seen = [one.step(action)[0] for one in (env, own)]
        assert np.array_equal(seen[0], seen[1])
    assert env.settings["randomise"] == "lab" and env.settings["tips"] == "camera"
    assert env.settings["scene"] == "needle-pick"
    nominal = TaskEnv("needle-pick")
    assert not np.array_equal(nominal.reset(3)[0], env.reset(3)[0])
    assert "tips" not in nominal.settings


def test_a_seed_gives_the_same_observations_again() -> None:
    env = TaskEnv("needle-pick", randomise="lab")
    first = env.reset(5)[0]
    assert not np.array_equal(env.reset(6)[0], first)
    assert np.array_equal(env.reset(5)[0], first)


def test_bad_settings_are_named() -> None:
    with pytest.raises(UnknownNameError, match="lab"):
        TaskEnv("needle-pick", randomise="labs")
    with pytest.raises(InputError, match="tips: got 'eyes'; allowed: robot, camera"):
        TaskEnv("needle-pick", tips="eyes")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="got a task; allowed: a scene"):
        TaskEnv(make_task("needle-pick"), randomise="lab")
    with pytest.raises(DescriptionError, match="cannot be read"):
        TaskEnv("needle-pick", randomise="none.toml")


def test_images_differ_in_pose_exposure_and_noise_from_seed_to_seed() -> None:
    pytest.importorskip("moderngl", reason="images need the extra scope")
    env = TaskEnv("needle-pick", obs="image", randomise="lab")
    nominal = TaskEnv("needle-pick", obs="image")
    try:
        seen = [env.reset(seed)[0].astype(float) for seed in (1, 2, 1)]
        plain = nominal.reset(1)[0].astype(float)
    finally:
        env.close()
        nominal.close()
    assert np.array_equal(seen[0], seen[2])
    assert np.abs(seen[0] - seen[1]).mean() > 2.0
    assert np.abs(seen[0] - plain).mean() > 2.0
    grain = np.abs(np.diff(seen[0], axis=1)).mean(), np.abs(np.diff(plain, axis=1)).mean()
    assert grain[0] > grain[1] + 2.0  # of 0.03 of white, 7.6 of 255
