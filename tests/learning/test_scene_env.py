from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from trocar.errors import InputError, UnknownNameError
from trocar.learning.ids import SCENES
from trocar.learning.scene_env import SceneEnv

#: Scenes that take seconds to reset or to step.
SLOW = {
    "augmented-reality",
    "fls-peg-transfer",
    "needle-through-phantom",
    "needle-tracking",
    "peg-board",
    "suturing",
    "thread-handover",
    "thread-knot",
    "visual-servoing",
}
EACH = [pytest.param(scene, marks=pytest.mark.slow) if scene in SLOW else scene for scene in SCENES]


@pytest.mark.parametrize("scene", EACH)
def test_every_scene_passes_both_checks(scene: str) -> None:
    env = SceneEnv(scene, action="joint")
    check_env(env, skip_render_check=True)
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker", reason="the second check")
    sb3.check_env(env)
    env.close()


KINDS: list[dict[str, Any]] = [
    {"obs": "goal", "action": "surrol", "action_period": 0.2},
    {"obs": "goal", "action": "tip", "reward": "dense"},
    {"obs": "state", "action": "tip-setpoint", "action_period": 0.02, "reward": "sparse"},
    {"obs": "image", "action": "tip"},
    {"obs": "image", "channels": ("rgb", "depth", "ids"), "eyes": 2, "image_size": (48, 36)},
    {"obs": "state+image", "action": "joint"},
]


@pytest.mark.parametrize("scene", ["bi-peg-transfer", "ecm-reach", "dynamic-stack"])
@pytest.mark.parametrize("settings", KINDS)
def test_every_kind_passes_both_checks(
    scene: str, settings: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    env = SceneEnv(scene, **settings)
    check_env(env, skip_render_check=True)
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker", reason="the second check")
    sb3.check_env(env)
    assert ("GoalEnv" in capsys.readouterr().out) == (settings["obs"] == "goal")
    env.close()


def test_spaces_are_bounded_float32_and_normalised() -> None:
    env = SceneEnv("needle-pick", obs="goal")
    assert isinstance(env.observation_space, gymnasium.spaces.Dict)
    for space in (*env.observation_space.values(), env.action_space):
        assert isinstance(space, gymnasium.spaces.Box)
        assert space.dtype == np.float32
        assert space.is_bounded()
    assert isinstance(env.action_space, gymnasium.spaces.Box)
    assert env.action_space.low.tolist() == [-1.0] * 7
    assert env.action_space.high.tolist() == [1.0] * 7


def test_the_same_seed_gives_the_same_rollout_through_gymnasium() -> None:
    rows: list[list[float]] = []
    for _ in range(2):
        env = gymnasium.make("trocar/NeedlePick-v0", action="surrol", action_period=0.2)
        env.action_space.seed(4)
        seen, _ = env.reset(seed=11)
        rows.append([*seen])
        for _ in range(5):
            seen, reward, *_ = env.step(env.action_space.sample())
            rows[-1] += [*seen, float(reward)]
    assert rows[0] == rows[1]


@pytest.mark.parametrize("mode", ["endoscope", "room", "rgb_array"])
def test_render_modes_are_pictures(mode: str) -> None:
    env = SceneEnv("needle-pick", render_mode=mode)
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (360, 640, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10.0
    env.close()


def test_views_are_of_different_places() -> None:
    pictures: list[Any] = []
    for mode in ("endoscope", "room"):
        env = SceneEnv("needle-pick", render_mode=mode)
        pictures.append(env.render())
        env.close()
    assert np.abs(pictures[0].astype(int) - pictures[1]).mean() > 10.0
    assert SceneEnv("needle-pick").render() is None
    with pytest.raises(UnknownNameError, match=r"unknown render_mode 'rooms' .did you mean 'room'"):
        SceneEnv("needle-pick", render_mode="rooms")


@pytest.mark.parametrize(
    ("action", "says"),
    [
        (np.full(7, np.nan, np.float32), "got nan as PSM1.x"),
        (np.zeros(6, np.float32), r"got the shape \(6,\); allowed: \(7,\)"),
        (np.zeros(7, np.complex64), "got complex64 as dtype"),
    ],
)
def test_wrong_actions_are_named(action: Any, says: str) -> None:
    env = SceneEnv("needle-reach")
    env.reset(seed=0)
    with pytest.raises(InputError, match=says):
        env.step(action)


def test_her_of_stable_baselines3_relabels_goals() -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="trains")
    env = SceneEnv("needle-reach", obs="goal", action="surrol", action_period=0.2, max_steps=5)
    model = sb3.SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=sb3.HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": True},
        learning_starts=12,
        buffer_size=100,
        seed=0,
    )
    model.learn(16)
    batch = model.replay_buffer.sample(200)
    assert set(batch.rewards.unique().tolist()) <= {0.0, -1.0}
    at = batch.next_observations
    near = (at["achieved_goal"] - at["desired_goal"]).abs().amax(1) <= 1e-6
    assert near.any()  # goals that were replaced by what was achieved in the same step
    assert (batch.rewards[near] == 0.0).all()
