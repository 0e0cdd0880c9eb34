"""An environment of a vector environment is a SceneEnv with its seed."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from trocar.errors import InputError, UnknownNameError
from trocar.learning.scene_env import SceneEnv
from trocar.learning.vector_env import SceneVectorEnv

N = 3


def same(one: Any, other: Any) -> None:
    """Compare observations."""
    if isinstance(one, dict):
        for key in one:
            np.testing.assert_allclose(one[key], other[key], atol=2e-6)  # float32 up to 10
    else:
        np.testing.assert_allclose(one, other, atol=2e-6)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("needle-reach", {"obs": "goal", "action": "surrol", "action_period": 0.2, "max_steps": 3}),
        ("needle-pick", {"action": "tip", "action_period": 0.1, "max_steps": 5}),
        ("needle-handover", {"action": "joint", "action_period": 0.1, "max_steps": 4}),
        ("ecm-reach", {"action": "joint", "action_period": 0.02, "max_steps": 6}),
        ("needle-pick", {"action": "tip-setpoint", "reward": "dense", "max_steps": 5}),
    ],
)
def test_a_vector_environment_is_so_many_environments(name, settings, mode):
    many = SceneVectorEnv(name, N, threads=2, autoreset_mode=mode, **settings)
    each = SyncVectorEnv([lambda: SceneEnv(name, **settings)] * N, autoreset_mode=mode)
    assert many.single_observation_space == each.single_observation_space
    assert many.single_action_space == each.single_action_space
    assert many.observation_space == each.observation_space
    assert many.action_space == each.action_space
    seen, _ = many.reset(seed=5)
    expected, _ = each.reset(seed=5)
    same(seen, expected)
    many.action_space.seed(0)
    for _ in range(9):
        actions = many.action_space.sample()
        seen, reward, terminated, truncated, info = many.step(actions)
        expected, its, ends, cuts, its_info = each.step(actions)
        same(seen, expected)
        np.testing.assert_allclose(reward, its, atol=1e-6)
        np.testing.assert_array_equal(terminated, ends)
        np.testing.assert_array_equal(truncated, cuts)
        assert many.observation_space.contains(seen)
        if "final_info" in its_info:
            for world in np.flatnonzero(its_info["_final_obs"]):
                same(info["final_obs"][world], its_info["final_obs"][world])
            ending = info["final_info"]["ending"]
            assert ending.tolist() == its_info["final_info"]["ending"].tolist()
        elif mode is AutoresetMode.NEXT_STEP:
            assert info["ending"].tolist() == its_info["ending"].tolist()
    many.close()
    each.close()


def test_gymnasium_makes_a_batch_of_an_id():
    env = gymnasium.make_vec("trocar/NeedlePick-v0", num_envs=4, action_period=0.2)
    assert isinstance(env.unwrapped, SceneVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    first, _ = env.reset(seed=1)
    again, _ = env.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    shape = env.single_observation_space.shape
    assert shape is not None and first.shape == (4, *shape) and first.dtype == np.float32
    env.close()


def test_without_autoreset_worlds_begin_by_a_mask():
    env = SceneVectorEnv(
        "needle-reach", 2, threads=1, autoreset_mode=AutoresetMode.DISABLED, max_steps=1
    )
    env.reset(seed=3)
    still = np.zeros_like(env.action_space.sample())
    _, _, _, truncated, info = env.step(still)
    assert truncated.all() and info["ending"].tolist() == ["truncation"] * 2
    with pytest.raises(InputError, match="the episode of world 0 is over; allowed: reset"):
        env.step(still)
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(InputError, match="the episode of world 1 is over"):
        env.step(still)
    env.reset(options={"reset_mask": np.array([False, True])})
    env.step(still)


def test_rewards_of_other_goals_are_computed_for_many_at_once():
    env = SceneVectorEnv("needle-reach", 2, threads=1, obs="goal")
    seen, _ = env.reset(seed=0)
    at = seen["desired_goal"]
    np.testing.assert_array_equal(env.compute_reward(at, at, {}), [0.0, 0.0])
    assert not hasattr(SceneVectorEnv("needle-reach", 1, threads=1), "compute_reward")


@pytest.mark.parametrize(
    ("actions", "why"),
    [
        ([[0.0] * 7, [0.0, np.nan, *[0.0] * 5]], r"world 1: got nan"),
        (np.zeros((2, 3)), r"got the shape \(2, 3\); allowed: \(2, 7\)"),
    ],
)
def test_actions_that_are_not_allowed_name_the_world(actions, why):
    env = SceneVectorEnv("needle-pick", 2, threads=1)
    env.reset(seed=0)
    with pytest.raises(InputError, match=why):
        env.step(np.array(actions))


def test_other_arguments_are_rejected():
    with pytest.raises(UnknownNameError, match="autoreset_mode"):
        SceneVectorEnv("needle-reach", 2, autoreset_mode="never")
    with pytest.raises(UnknownNameError, match="render_mode"):
        SceneVectorEnv("needle-reach", 2, render_mode="human")
    env = SceneVectorEnv("needle-reach", 2, threads=1)
    with pytest.raises(InputError, match="got 1 seeds; allowed: 2"):
        env.reset(seed=[1])
    with pytest.raises(InputError, match="reset_mask, a mask of 2 worlds"):
        env.reset(options={"objects": {}})


def test_images_of_worlds_are_those_of_single_environments():
    settings = {"obs": "state+image", "image_size": 64}
    many = SceneVectorEnv("needle-pick", 2, threads=1, render_mode="endoscope", **settings)
    seen, _ = many.reset(seed=2)
    assert seen["image"].shape == (2, 64, 64, 3) and seen["image"].dtype == np.uint8
    one = SceneEnv("needle-pick", render_mode="endoscope", **settings)
    for world in range(2):
        expected, _ = one.reset(seed=2 + world)
        np.testing.assert_array_equal(seen["image"][world], expected["image"])
        np.testing.assert_array_equal((many.render() or ())[world], one.render())
    assert (seen["image"][0] != seen["image"][1]).any()
    many.close()
    one.close()
