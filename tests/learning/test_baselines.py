"""Actors of Stable-Baselines3 as networks, and their training."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="training actors needs Stable-Baselines3")

import stable_baselines3 as sb3

from trocar.errors import UnknownNameError
from trocar.learning.baselines import (
    METHODS,
    PPO,
    SAC_HER,
    ActorSettings,
    actor,
    settings_of,
    successes,
    train_actor,
)
from trocar.learning.policies import TrainedPolicy
from trocar.learning.task_env import TaskEnv

SHORT = {
    "sac-her": replace(
        SAC_HER,
        steps=60,
        every=60,
        learner={**SAC_HER.learner, "learning_starts": 30},
        env={**SAC_HER.env, "max_steps": 5},
    ),
    "ppo": replace(
        PPO,
        steps=32,
        every=32,
        worlds=2,
        learner={**PPO.learner, "n_steps": 16, "batch_size": 16},
        env={**PPO.env, "max_steps": 5},
    ),
}


@pytest.fixture(autouse=True)
def few_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trocar.learning.baselines.SEEDS", range(1))


@pytest.mark.parametrize("method", METHODS)
def test_an_exported_actor_acts_as_the_model_does(method: str, tmp_path: Path) -> None:
    file = tmp_path / "model.zip"
    ratios: list[tuple[int, float]] = []
    policy = train_actor(
        "needle-reach", method, SHORT[method], archive=file, watch=lambda *row: ratios.append(row)
    )
    model = (sb3.SAC if method == "sac-her" else sb3.PPO).load(file, device="cpu")
    env = TaskEnv("needle-reach", **SHORT[method].env)
    act, rng = actor(policy), np.random.default_rng(1)
    seen, _ = env.reset(5)
    for _ in range(5):
        expected = model.predict(seen, deterministic=True)[0]
        np.testing.assert_allclose(np.clip(act(seen), -1.0, 1.0), expected, atol=1e-5)
        seen = env.step(rng.uniform(-1.0, 1.0, len(expected)))[0]
    assert ratios == [(SHORT[method].steps, 0.0)]


def test_a_training_shorter_than_the_time_between_evaluations_is_evaluated_at_its_end() -> None:
    counts: list[int] = []
    settings = replace(SHORT["sac-her"], every=1000)
    train_actor("needle-reach", "sac-her", settings, watch=lambda step, _: counts.append(step))
    assert counts == [settings.steps]


def test_a_seed_trains_one_actor() -> None:
    found = [
        train_actor("needle-reach", "sac-her", replace(SHORT["sac-her"], seed=seed))
        for seed in (1, 1, 2)
    ]
    weights = [one.network.layers[0][0] for one in found]
    np.testing.assert_array_equal(weights[0], weights[1])
    assert not np.array_equal(weights[0], weights[2])


def test_successes_are_those_of_the_environment() -> None:
    env = TaskEnv("needle-reach", obs="goal", action="surrol", action_period=0.2, max_steps=20)

    def towards(seen: dict[str, Any]) -> Any:
        way = seen["desired_goal"] - seen["achieved_goal"]  # in 50 mm; an action moves 10 mm
        return np.concatenate([np.clip(5.0 * way, -1.0, 1.0), np.zeros(2)])

    def away(seen: dict[str, Any]) -> Any:
        return -towards(seen)

    counts: list[Callable[..., Any]] = [towards, away]
    assert [successes(env, policy, range(3)) for policy in counts] == [3, 0]


def test_an_unknown_method_is_an_error() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown method 'sac'.*known: sac-her, ppo"):
        settings_of("sac")
    with pytest.raises(UnknownNameError, match="unknown method"):
        train_actor("needle-reach", "dqn", SAC_HER)


def test_each_method_has_settings() -> None:
    found = [settings_of(method) for method in METHODS]
    assert all(isinstance(one, ActorSettings) for one in found)
    assert isinstance(TrainedPolicy, type)
