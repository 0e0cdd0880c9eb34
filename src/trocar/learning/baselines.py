"""SAC with HER and PPO of Stable-Baselines3 on a scene, and their actors as networks."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Scene
from trocar.errors import MissingExtraError, UnknownNameError
from trocar.learning.cloning import torch_on
from trocar.learning.networks import NEAR_WAY, WAY, goal_difference, make_perceptron
from trocar.learning.policies import TrainedPolicy
from trocar.learning.scene_env import SceneEnv
from trocar.learning.task_env import TaskEnv

#: Called with the steps so far and the ratio of successes of an evaluation.
Watch = Callable[[int, float], None]

METHODS = ("sac-her", "ppo")
#: Settings of `TaskEnv` that a policy needs where it plays.
PLAYED = ("obs", "action", "action_period")
#: Seeds of the evaluations during a training. Source: our own choice; no policy is judged by them.
SEEDS = range(20_000, 20_010)


@dataclass(frozen=True)
class ActorSettings:
    """Settings of a training by Stable-Baselines3.

    Attributes:
        env: of `TaskEnv`
        learner: of the algorithm, by the names of Stable-Baselines3
        hidden: neurons of the hidden layers of actor and critic
        worlds: environments that step together
        steps: of all environments
        every: steps between evaluations
        seed: of initial weights, exploration and episodes
    """

    env: Mapping[str, Any]
    learner: Mapping[str, Any]
    hidden: tuple[int, ...]
    worlds: int = 1
    steps: int = 5000
    every: int = 1000
    seed: int = 0


#: Of SAC with HER. Source: chosen on needle-reach, with seeds 10,000 to 10,049; action and duration
#: are SurRoL's.
SAC_HER = ActorSettings(
    env={"obs": "goal", "action": "surrol", "action_period": 0.2, "max_steps": 20},
    learner={
        "learning_rate": 1e-3,
        "gamma": 0.95,
        "batch_size": 128,
        "buffer_size": 100_000,
        "learning_starts": 300,
    },
    hidden=(64, 64),
)
#: Of PPO. Source: our own choice; not tuned.
PPO = ActorSettings(
    env={
        "obs": "state",
        "action": "surrol",
        "action_period": 0.2,
        "reward": "dense",
        "max_steps": 20,
    },
    learner={"learning_rate": 1e-3, "gamma": 0.95, "n_steps": 64, "batch_size": 128},
    hidden=(64, 64),
    worlds=8,
    steps=40_000,
    every=8000,
)


def settings_of(method: str) -> ActorSettings:
    """Return the settings of a method, see `METHODS`.

    Raises:
        UnknownNameError: no such method
    """
    known = dict(zip(METHODS, (SAC_HER, PPO), strict=True))
    if method not in known:
        raise UnknownNameError("method", method, METHODS)
    return known[method]


def train_actor(
    scene: Scene | str,
    method: str,
    settings: ActorSettings,
    device: str = "cpu",
    archive: Path | None = None,
    watch: Watch = lambda _steps, _ratio: None,
) -> TrainedPolicy:
    """Train an actor on a scene, on one thread, so that a seed gives one network.

    Args:
        scene: a scene, its name, or the path of its file
        method: one of `METHODS`
        settings: of the training
        device: "cpu" or "cuda", of the networks; PPO's worlds are simulated on it, too (extra gpu),
            with actions of tips
        archive: .zip to keep what Stable-Baselines3 saves, which plays with --trust; the .toml
            beside it has the settings of `TaskEnv`
        watch: called after each evaluation, the last one at the end

    Raises:
        UnknownNameError: no such method or scene
        InputError: no such device, or the scene lacks the observation or action
        MissingExtraError: PyTorch or Stable-Baselines3 is not installed
    """
    if method not in METHODS:
        raise UnknownNameError("method", method, METHODS)
    torch, sb3 = torch_on(device), _stable_baselines()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    if method == "ppo" and device != "cpu":
        settings = replace(settings, env={**settings.env, "obs": "state", "action": "tip"})
    judge = TaskEnv(scene, **settings.env)
    try:
        make = _sac_her if method == "sac-her" else _ppo
        model = make(torch, sb3, scene, settings, device)
        judged = _judged(sb3, model, judge, settings, watch)
        model.learn(settings.steps, callback=judged)
        policy = _policy(judge, model, settings)
        if judged.last < model.num_timesteps:
            judged.judge()
        if archive is not None:
            # its buffer of relabelled transitions could only be loaded with an environment
            model.save(archive, exclude=["replay_buffer_class", "replay_buffer_kwargs"])
            table = {"scene": policy.scene, **policy.env}
            lines = [f"{key} = {json.dumps(value)}\n" for key, value in table.items()]
            archive.with_suffix(".toml").write_text("".join(lines), encoding="utf-8")
        return policy
    finally:
        judge.close()
        torch.set_num_threads(threads)


def successes(env: TaskEnv, policy: Callable[[Any], Any], seeds: Sequence[int]) -> int:
    """Return the number of seeds on which a policy succeeds within the environment's steps.

    Args:
        env: whose episodes are run
        policy: returns an action from an observation
        seeds: of the episodes
    """
    found = 0
    for seed in seeds:
        seen, info = env.reset(seed)
        over = False
        while not over:
            seen, _, ended, late, info = env.step(policy(seen))
            over = ended or late
        found += bool(info["is_success"])
    return found


def _stable_baselines() -> Any:
    try:
        import stable_baselines3
    except ImportError as problem:
        raise MissingExtraError("Stable-Baselines3", "learn", "training an actor") from problem
    return stable_baselines3


def _sac_her(torch: Any, sb3: Any, scene: Scene | str, settings: ActorSettings, device: str) -> Any:
    """Return an untrained SAC whose buffer replaces goals by those that were reached later."""
    base = sb3.common.torch_layers.BaseFeaturesExtractor

    class GoalDifference(base):
        """`goal_difference` of observations, in PyTorch."""

        def __init__(self, space: Any) -> None:
            goal = space["achieved_goal"].shape[0]
            super().__init__(space, space["observation"].shape[0] + 2 * goal)  # pyright: ignore[reportUnknownMemberType]  of Any

        def forward(self, seen: Any) -> Any:
            way = seen["desired_goal"] - seen["achieved_goal"]
            return torch.cat([seen["observation"], WAY * way, torch.tanh(NEAR_WAY * way)], dim=1)

    return sb3.SAC(
        "MultiInputPolicy",
        SceneEnv(scene, **settings.env),
        replay_buffer_class=sb3.HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        policy_kwargs={
            "net_arch": [*settings.hidden],
            "features_extractor_class": GoalDifference,
        },
        seed=settings.seed,
        device=device,
        **settings.learner,
    )


def _ppo(torch: Any, sb3: Any, scene: Scene | str, settings: ActorSettings, device: str) -> Any:  # noqa: ARG001
    """Return an untrained PPO on worlds side by side: on CPU threads, or all on the device."""
    worlds = import_module("trocar.learning.vec_env").make_worlds(
        scene, settings.worlds, device=device, seed=settings.seed, **settings.env
    )
    return sb3.PPO(
        "MlpPolicy",
        worlds,
        policy_kwargs={"net_arch": [*settings.hidden]},
        seed=settings.seed,
        device=device,
        **settings.learner,
    )


def _judged(sb3: Any, model: Any, judge: TaskEnv, settings: ActorSettings, watch: Watch) -> Any:
    """Return a callback that evaluates the actor now and then."""
    base = sb3.common.callbacks.BaseCallback

    class Judged(base):
        due, last = settings.every, 0

        def _on_step(self) -> bool:
            if self.num_timesteps >= self.due:
                self.due += settings.every
                self.judge()
            return True

        def judge(self) -> None:
            self.last = self.num_timesteps
            policy = actor(_policy(judge, model, settings))
            watch(self.last, successes(judge, policy, SEEDS) / len(SEEDS))

    return Judged()


def actor(policy: TrainedPolicy) -> Callable[[Any], NDArray[np.float32]]:
    """Return the function from an observation of `TaskEnv` to an action that an actor is."""
    network = policy.network
    if policy.inputs == "observation":
        return lambda seen: network(np.asarray(seen, np.float32)[None])[0]
    parts = ("observation", "achieved_goal", "desired_goal")
    return lambda seen: network(goal_difference(*(seen[name][None] for name in parts)))[0]


def _policy(env: TaskEnv, model: Any, settings: ActorSettings) -> TrainedPolicy:
    """Return the actor of a model, without its critic and its noise."""
    sac = hasattr(model.policy, "actor")
    if sac:
        stack, last = model.policy.actor.latent_pi, model.policy.actor.mu
    else:
        stack, last = model.policy.mlp_extractor.policy_net, model.policy.action_net
    linear = [one for one in [*stack, last] if hasattr(one, "weight")]
    layers = [
        (one.weight.detach().cpu().numpy(), one.bias.detach().cpu().numpy()) for one in linear
    ]
    network = make_perceptron(layers, *(("relu", "tanh") if sac else ("tanh", "identity")))
    return TrainedPolicy(
        kind="actor",
        scene=env.task.scene.name,
        network=network,
        env={key: settings.env[key] for key in PLAYED if key in settings.env},
        inputs="goal-difference" if sac else "observation",
    )
