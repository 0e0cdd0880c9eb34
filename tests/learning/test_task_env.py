from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from trocar.errors import InputError, UnknownNameError
from trocar.learning.actions import REACH_M
from trocar.learning.task_env import TaskEnv
from trocar.tasks import make_task


def test_the_same_seed_gives_the_same_rollout() -> None:
    rows = []
    for _ in range(2):
        env = TaskEnv("needle-pick", action="tip", action_period=0.02)
        rng = np.random.default_rng(1)
        seen, _ = env.reset(5)
        rows.append([seen])
        for _ in range(20):
            seen, *_ = env.step(rng.uniform(-1.0, 1.0, 7))
            rows[-1].append(seen)
        rows[-1].append(env.reset()[0])  # and the seeds that follow
    assert np.array_equal(rows[0], rows[1])


@pytest.mark.parametrize("kind", ["tip", "tip-setpoint", "joint", "surrol"])
def test_a_script_yields_the_actions_of_steps(kind: str) -> None:
    env = TaskEnv("needle-pick", action=kind, action_period=0.1)
    other = TaskEnv("needle-pick", action=kind, action_period=0.1)

    def policy(seen: np.ndarray) -> np.ndarray:
        return 0.3 * np.sin(np.arange(len(env.actions.names)) + 10.0 * seen[0])

    seen, _ = env.reset(3)
    for _ in range(6):
        seen, *_ = env.step(policy(seen))
    other.task.reset(3)
    for action in islice(other.script(policy), 30):
        other.task.command(action)
    assert np.array_equal(env.task.world.save().row, other.task.world.save().row)


def test_a_set_point_is_reached_at_the_end_of_the_action() -> None:
    env = TaskEnv("needle-reach", action="tip-setpoint", action_period=0.2)
    env.reset(0)
    action = np.array([0.2, 0.05, 0.2, 0.0, 0.0, 0.0, 0.0])
    env.step(action)
    at = env.task.controller.target("PSM1")[:3, 3]
    assert at == pytest.approx(env.encoder.centre + REACH_M * action[:3], abs=1e-9)


def test_a_step_of_a_period_is_a_command_of_the_task() -> None:
    env, task = TaskEnv("needle-reach", action_period=0.02), make_task("needle-reach")
    env.reset(2)
    task.reset(2)
    action = np.array([0.5, -0.25, 0.1, 0.0, 0.0, 0.2, -1.0])
    env.step(action)
    task.command([0.1, -0.05, 0.02, 0.0, 0.0, 0.8, -0.3])
    assert np.array_equal(env.task.world.save().row, task.world.save().row)


def test_success_is_an_ending_of_its_own() -> None:
    env = TaskEnv("needle-reach", obs="goal", action="tip", action_period=0.02)
    env.reset(0)
    low, high = env.task.limits
    script = env.task.policy()
    while not env.done:
        action = next(script, env.task.stay())
        jaw = 2.0 * (action[6] - low[6]) / (high[6] - low[6]) - 1.0
        step = env.step(np.array([*(action[:6] / high[:6]), jaw]))
        seen, reward, terminated, truncated, info = step
        assert reward == env.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
        if terminated:
            assert (truncated, reward, info["is_success"]) == (False, 0.0, True)
            assert info["ending"] == "success"
    with pytest.raises(InputError, match="the episode is over; allowed: reset"):
        env.step(np.zeros(7))


def test_an_episode_is_truncated_after_its_steps() -> None:
    env = TaskEnv("needle-reach", max_steps=3)
    env.reset(0)
    ends = [env.step(np.zeros(7))[2:] for _ in range(3)]
    assert [end[1] for end in ends] == [False, False, True]
    assert not ends[-1][0]
    assert ends[-1][2]["ending"] == "truncation"
    assert ends[-1][2]["reason"] == "time"


@pytest.mark.parametrize("obs", ["state", "goal"])
def test_a_fault_ends_or_truncates(obs: str) -> None:
    env = TaskEnv("needle-pick", obs=obs, action_period=0.02)
    env.reset(0)
    env.task.world.arms["PSM1"].runtime.states.fault("of a test")
    _, _, terminated, truncated, info = env.step(np.zeros(7))
    assert info["ending"] == "failure"
    assert "FAULT" in info["reason"]
    assert (terminated, truncated) == ((True, False) if obs == "state" else (False, True))


def test_a_goal_that_asks_for_a_grasp_is_not_met_by_its_place_alone() -> None:
    env = TaskEnv("needle-pick", obs="goal", action="surrol", action_period=0.2)
    seen, _ = env.reset(0)
    _, _, _, _, info = env.step(np.array([0.0, 0.0, 0.0, 0.0, 1.0]))
    there = seen["desired_goal"]
    assert not info["conditions"].any()
    assert env.compute_reward(there, there, info) == -1.0
    assert env.compute_reward(there, there, {}) == 0.0
    many = np.repeat(there[None], 3, axis=0)
    assert env.compute_reward(many, many, [info, info, info]).tolist() == [-1.0] * 3
    assert env.compute_reward(many, many + 1.0, [{}] * 3).tolist() == [-1.0] * 3


def test_dense_rewards_grow_on_the_way() -> None:
    env = TaskEnv("needle-reach", obs="goal", reward="dense")
    seen, _ = env.reset(0)
    a, d = seen["achieved_goal"], seen["desired_goal"]
    rewards = [env.compute_reward(a + k * (d - a), d, {}) for k in (0.0, 0.5, 1.0)]
    assert rewards[0] < rewards[1] < rewards[2] == pytest.approx(0.0, abs=1e-6)
    assert rewards[0] == pytest.approx(-np.linalg.norm(d - a), rel=1e-6)


def test_a_trained_policy_runs_where_a_scripted_one_does() -> None:
    task = make_task("needle-reach")
    env = TaskEnv(task, action="tip", action_period=0.02)

    def policy(seen: np.ndarray) -> np.ndarray:
        way = seen[[env.encoder.names.index(f"goal1.way.{axis}") for axis in "xyz"]]
        return np.concatenate([way, np.zeros(4)])

    task.reset(4)
    for action in env.script(policy):
        task.command(action)
        if task.done:
            break
    assert task.result(4).success


def test_objects_begin_where_options_have_them() -> None:
    env = TaskEnv("needle-pick")
    pose = [0.01, -0.005, 0.006, 1.0, 0.0, 0.0, 0.0]
    env.reset(0, {"objects": {"needle": pose}})
    assert env.task.object_pose("needle")[:3, 3] == pytest.approx(pose[:3])
    with pytest.raises(UnknownNameError, match=r"unknown object 'nedle' .did you mean 'needle'"):
        env.reset(0, {"objects": {"nedle": pose}})
    with pytest.raises(InputError, match="needle-pick: options: got"):
        env.reset(0, {"object": {}})
    with pytest.raises(InputError, match="options: needle: got"):
        env.reset(0, {"objects": {"needle": [0.0] * 6}})


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"obs": "gaol"}, "unknown observation 'gaol' .did you mean 'goal'"),
        ({"action": "joints"}, "unknown action 'joints' .did you mean 'joint'"),
        ({"reward": "spare"}, "unknown reward 'spare' .did you mean 'sparse'"),
        ({"max_steps": 0}, "max_steps: got 0"),
        ({"image_size": 128}, "got them with obs 'state'; allowed: with 'image'"),
        ({"obs": "goal", "channels": ("rgb", "depth")}, "got them with obs 'goal'"),
    ],
)
def test_unknown_settings_are_named(settings: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        TaskEnv("needle-reach", **settings)  # pyright: ignore[reportArgumentType]


def test_goals_by_stages_have_no_goal_dict() -> None:
    with pytest.raises(InputError, match="goals count by stages"):
        TaskEnv("fls-peg-transfer", obs="goal")


def test_seeds_and_goals_of_other_shapes_are_refused() -> None:
    env = TaskEnv("needle-reach", obs="goal")
    with pytest.raises(InputError, match="needle-reach: seed: got -1"):
        env.reset(-1)
    env.reset(2**32 - 1)  # Stable-Baselines3 draws such seeds
    with pytest.raises(InputError, match=r"allowed: equal shapes \(\.\.\., 3\)"):
        env.compute_reward(np.zeros(6), np.zeros(6), {})
    with pytest.raises(InputError, match="compute_reward: got the reward 'task'"):
        TaskEnv("needle-reach").compute_reward(np.zeros(3), np.zeros(3), {})
