"""Scenes on MuJoCo Warp begin as their task does, move as it does, and hold what it holds.

All run on Warp's CPU backend, which compiles for minutes the first time.
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest

from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError, MissingExtraError
from trocar.learning.observations import StateEncoder
from trocar.learning.readings import SceneReadings, read_task
from trocar.tasks import Task
from trocar.tasks.registry import make_task

LEARN = "PyTorch is not installed: pip install 'trocar[learn]'"
GPU = "MuJoCo Warp is not installed: pip install 'trocar[gpu]'"
torch = pytest.importorskip("torch", reason=LEARN)
pytest.importorskip("mujoco_warp", reason=GPU)

from benchmarks.learning_gpu import PickScript, loop_gap, rows  # noqa: E402  after the skip
from trocar.learning.warp_env import TensorEncoder, WarpVectorEnv  # noqa: E402
from trocar.learning.warp_scene import WarpScene  # noqa: E402

#: Rounding of single precision: the state is float32, lengths are below 1 m, angles below 4 rad.
SINGLE = 5e-7
#: A needle that friction holds creeps by other amounts at impratio 10 and 1000: 0.47 mm apart at
#: the goal was measured. [m]
CREPT = 1e-3
#: Loops under a grip: 0.06 um was measured. [m]
GAP = 2e-7
#: Joints with a grip, which the arm's weight and other contacts move apart: 1.4e-3 was measured.
#: [rad or m]
APART = 5e-3


def friction_task(name: str) -> Task:
    scene = load_scene(name)
    return make_task(replace(scene, rig=replace(scene.rig, grasp="friction")))


def assert_same(ours: SceneReadings, task: Task, world: int, tolerance: float) -> None:
    """Compare readings of a world with those of its task, where both have not moved yet."""
    theirs = read_task(task)
    assert ours.names == theirs.names
    for field in ("tips", "targets", "q", "v", "setpoints", "objects", "held", "stalled"):
        mine, want = getattr(ours, field), getattr(theirs, field)
        assert mine.keys() == want.keys()
        for name in want:
            np.testing.assert_allclose(mine[name][world], want[name][0], atol=tolerance)
    for field in ("time", "goals", "achieved", "met"):
        mine, want = getattr(ours, field)[world], getattr(theirs, field)[0]
        np.testing.assert_allclose(mine, want, atol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["needle-pick", "bi-peg-transfer", "ecm-reach"])
def test_episodes_begin_as_the_task_begins_them_and_are_encoded_alike(name):
    scene = WarpScene(name, 3, device="cpu", seed=5, pool=4)
    scene.reset(rows=torch.tensor([2, 0, 3]))
    task, encoder = friction_task(name), TensorEncoder(scene.task, "cpu")
    coded = encoder.encode(scene.readings)
    theirs = StateEncoder(task)
    assert encoder.names == theirs.names and coded.shape == (3, theirs.size)
    for world, row in enumerate((2, 0, 3)):
        task.reset(scene.seeds[row])
        assert_same(scene.readings.numpy(), task, world, SINGLE)
        np.testing.assert_allclose(
            coded[world].numpy(), theirs.encode(read_task(task))[0], atol=1e-5
        )
    held = scene.qpos[1].clone()
    scene.reset(torch.tensor([True, False, True]))
    assert torch.equal(scene.qpos[1], held)  # worlds that are not reset stay


@dataclass
class Pick:
    """A scripted pick in two worlds, and their tasks under the same actions."""

    scene: WarpScene
    tasks: list[Task]
    apart: list[float]
    joints: list[float]
    held: list[tuple[bool, bool]]
    rewards: list[list[float]]
    gap: float
    encoded: float


@pytest.fixture(scope="module")
def pick() -> Pick:
    scene = WarpScene("needle-pick", 2, device="cpu", pool=2)
    scene.reset(rows=torch.tensor([0, 1]))
    tasks = [friction_task("needle-pick") for _ in range(2)]
    for task, seed in zip(tasks, scene.seeds, strict=True):
        task.reset(seed)
    script = PickScript(scene)
    found = Pick(scene, tasks, [], [], [], [[], []], 0.0, 0.0)
    encoder, theirs = TensorEncoder(scene.task, "cpu"), StateEncoder(scene.task)
    for period in range(110):
        actions = script()
        scene.command(actions)
        readings = scene.readings
        if period % 10 == 0:
            found.gap = max(found.gap, loop_gap(scene))
            off = encoder.encode(readings).numpy() - theirs.encode(readings.numpy())
            found.encoded = max(found.encoded, float(np.abs(off).max()))
        for world, task in enumerate(tasks):
            found.rewards[world].append(float(scene.reward[world]))
            if task.done:
                continue
            task.command(actions[world].numpy())
            at = readings.objects["needle"][world, :3].numpy()
            found.apart.append(float(np.linalg.norm(at - task.object_pose("needle")[:3, 3])))
            q = task.world.arms["PSM1"].joints.positions()
            found.joints.append(float(np.abs(readings.q["PSM1"][world].numpy() - q).max()))
            held = bool(readings.held["PSM1"][world] >= 0), bool(task.referee.held)
            found.held.append(held)
    return found


@pytest.mark.slow
def test_a_scripted_pick_succeeds_in_all_worlds_with_loops_closed(pick):
    assert pick.scene.success.all() and not pick.scene.failed.any()
    assert all(task.reason == "done" for task in pick.tasks)
    assert int(pick.scene.broken_count) == 0 and not pick.scene.overflows.any()
    assert 0.0 < pick.gap < GAP
    for rewards in pick.rewards:  # the goal is met once
        assert sum(rewards) == 1.0


@pytest.mark.slow
def test_the_needle_goes_where_the_task_brings_it_by_the_same_actions(pick):
    assert max(pick.apart) < CREPT
    assert max(pick.joints) < APART
    assert np.mean([ours == theirs for ours, theirs in pick.held]) > 0.97
    assert any(ours for ours, _ in pick.held)


@pytest.mark.slow
def test_observations_of_tensors_are_those_of_arrays_while_a_needle_is_held(pick):
    assert pick.encoded < 1e-5


@pytest.mark.slow
def test_a_world_that_is_not_finite_begins_anew_alone_and_is_counted():
    scene = WarpScene("needle-reach", 2, device="cpu", pool=1)  # both worlds begin alike
    actions = torch.zeros(2, len(scene.limits[0]), dtype=torch.float64)
    actions[:, 0] = 0.05
    states = []
    for _ in range(4):
        scene.command(actions)
        assert torch.equal(scene.qpos[0], scene.qpos[1])
        states.append(scene.qpos[1].clone())
    scene.reset()
    scene.command(actions)
    scene.qpos[0, 0] = torch.nan  # x of the needle
    scene.command(actions)
    assert scene.broken.tolist() == [True, False] and int(scene.broken_count) == 1
    assert scene.time.tolist() == [0.0, 0.04]
    for count in range(2):  # as if nothing had been
        scene.command(actions)
        assert not scene.broken.any() and int(scene.broken_count) == 1
        assert torch.equal(scene.qpos[0], states[count])
        assert torch.equal(scene.qpos[1], states[count + 2])


@pytest.mark.slow
def test_actions_that_are_not_finite_or_of_another_shape_are_rejected_with_the_world():
    scene = WarpScene("needle-reach", 2, device="cpu", pool=1)
    actions = torch.zeros(2, 7)
    actions[1, 3] = torch.inf
    with pytest.raises(InputError, match=r"needle-reach: .* not finite in world 1 and 0 others"):
        scene.command(actions)
    with pytest.raises(InputError, match=r"shape \(2, 6\); allowed: \(2, 7\)"):
        scene.command(torch.zeros(2, 6))
    assert scene.time.tolist() == [0.0, 0.0]


@pytest.mark.slow
def test_environments_that_end_begin_anew_with_their_last_observation_kept():
    env = WarpVectorEnv("needle-reach", 2, device="cpu", max_steps=2, action_period=0.02)
    first = env.reset()
    assert first.shape == (2, env.observation_size) and first.dtype == torch.float32
    actions = torch.zeros(2, env.action_size)
    _, reward, terminated, truncated, info = env.step(actions)
    assert reward.dtype == torch.float32 and not terminated.any() and not truncated.any()
    last, _, terminated, truncated, info = env.step(actions)
    assert truncated.all() and not terminated.any()
    left = env.encoder.names.index("time_left")
    limit = env.scene.task.scene.time_limit
    assert torch.allclose(info["final_obs"][:, left], torch.tensor(1.0 - 0.04 / limit))
    assert torch.equal(last[:, left], torch.ones(2))
    assert env.scene.time.tolist() == [0.0, 0.0]


def test_scenes_that_cannot_run_are_rejected_with_the_reason():
    with pytest.raises(InputError, match=r"suturing: cannot run on MuJoCo Warp: .*soft tissue"):
        WarpScene("suturing", 2, device="cpu")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"device": "tpu"}, "got device='tpu'; allowed: cuda, cpu"),
        ({"timestep": 0.003}, "got timestep=0.003; allowed: a whole fraction of 0.01 s"),
        ({"n": 0}, "WarpScene: n: got 0; allowed: 1 to"),
        ({"n": 10**8}, "got n=100000000, of which a world takes .* allowed: up to"),
    ],
)
def test_settings_that_are_not_allowed_are_rejected(settings, message):
    with pytest.raises(InputError, match=message):
        WarpScene("needle-pick", **{"n": 2, "device": "cpu", "pool": 1, **settings})


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_figures_of_a_gpu_are_printed_as_not_measured_without_one():
    found = rows()
    assert found and all(value is None for _, value, _, _ in found)
    assert all("not measured: no CUDA device" in figure for figure, _, _, _ in found)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_machine_without_a_gpu_gets_one_clear_error():
    with pytest.raises(InputError, match=r"device='cuda', but .*CUDA.*; allowed: 'cpu'"):
        WarpScene("needle-pick", 2)


@pytest.mark.parametrize(
    ("library", "name"), [("mujoco_warp", "MuJoCo Warp"), ("torch", "PyTorch")]
)
def test_a_library_that_is_not_installed_is_named_with_its_extra(monkeypatch, library, name):
    for module in ("warp_env", "warp_scene", "torch_controller"):
        monkeypatch.delitem(sys.modules, f"trocar.learning.{module}", raising=False)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=rf"needs {name}, .* pip install 'trocar\[gpu\]'"):
        importlib.import_module("trocar.learning.warp_env")


@pytest.mark.slow
def test_stable_baselines_trains_on_worlds_of_warp():
    sb3 = pytest.importorskip("stable_baselines3", reason=LEARN)
    from trocar.learning.vec_env import WorldsVecEnv

    env = WarpVectorEnv("ecm-reach", 2, device="cpu", max_steps=2, action_period=0.02)
    worlds = WorldsVecEnv(env)
    assert worlds.observation_space.contains(worlds.reset()[1])
    worlds.step_async(np.zeros((2, env.action_size)))
    _, _, ended, infos = worlds.step_wait()
    assert not ended.any() and infos == [{}, {}]
    _, _, ended, infos = worlds.step(np.zeros((2, env.action_size)))
    assert ended.all() and all(info["TimeLimit.truncated"] for info in infos)
    assert infos[0]["terminal_observation"].shape == (env.observation_size,)
    learner = sb3.PPO("MlpPolicy", worlds, n_steps=4, batch_size=4, n_epochs=1, seed=0)
    before = [p.clone() for p in learner.policy.parameters()]
    learner.learn(8)
    after = list(learner.policy.parameters())
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
