"""A world of a batch of scenes is a Task: the same motion to the last bit, the same judgement."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions.catalogue import load_scene, names
from trocar.descriptions.robot_errors import robot_errors
from trocar.errors import InputError, UnknownNameError
from trocar.learning import scene_batch
from trocar.learning.batch_rules import obstacle
from trocar.learning.readings import read_task
from trocar.learning.scene_batch import SceneBatch
from trocar.tasks import Task, make_task
from trocar.tasks.controller import PERIOD_S

SCENES = names("scenes")
RUNNING = [name for name in SCENES if not obstacle(load_scene(name))]
#: Scenes that cannot run in a batch, and a word of the reason.
KEPT_OUT = {
    "augmented-reality": "images",
    "dynamic-band": "met",
    "misorient": "reset, met",
    "needle-through-phantom": "tissue",
    "needle-tracking": "images",
    "suturing": "tissue",
    "thread-handover": "threads",
    "thread-knot": "threads",
    "tissue-retraction": "met",
    "visual-servoing": "images",
}
SEEDS = (3, 11)


#: Model of grasps of the rig.
STICK = "friction+stick"


def task_of(name: str, grasp: str = STICK) -> Task:
    """Return the task of a scene as a batch with a model of grasps has it."""
    scene = load_scene(name)
    return make_task(replace(scene, rig=replace(scene.rig, grasp=grasp)))


def scripted(task: Task, seed: int) -> Iterator[np.ndarray]:
    """Yield actions of the scripted policy, then those that hold the arms."""
    task.reset(seed)
    script = task.policy()
    while True:
        action = next(script, None)
        yield task.stay() if action is None else action


def check_same(batch: SceneBatch, tasks: list[Task], steps: int) -> None:
    """Drive a batch and tasks with the same actions and compare all that both have."""
    scripts = [scripted(task, seed) for task, seed in zip(tasks, SEEDS, strict=True)]
    actions = [next(script) for script in scripts]
    batch.reset(seeds=SEEDS)
    for world, task in enumerate(tasks):
        np.testing.assert_array_equal(batch.physics.rows[world], task.world.save().row)
    for _ in range(steps):
        rewards = [
            0.0 if task.done else task.command(action)
            for task, action in zip(tasks, actions, strict=True)
        ]
        np.testing.assert_array_equal(batch.command(actions), rewards)
        for world, task in enumerate(tasks):
            check_judgement(batch, world, task)
        if all(task.done for task in tasks):
            break
        actions = [
            task.stay() if task.done else next(script)
            for task, script in zip(tasks, scripts, strict=True)
        ]


def check_judgement(batch: SceneBatch, world: int, task: Task) -> None:
    """Compare the motion, readings and the count of a world with a task's."""
    if "FAULT" not in task.reason:
        np.testing.assert_array_equal(batch.physics.rows[world], task.world.save().row)
    endings = {"success": batch.success, "failure": batch.failed, "truncation": batch.late}
    found = [name for name, mask in endings.items() if mask[world]] or ["running"]
    assert found == [task.referee.ending.value], task.reason
    assert batch.drops[world] == task.referee.drops
    assert batch.met_count[world] == task.referee.met_count
    one, many = read_task(task), batch.readings
    for arm, held in one.held.items():
        assert many.held[arm][world] == held[0]
        assert many.stalled[arm][world] == one.stalled[arm][0]
    np.testing.assert_array_equal(many.met[world], one.met[0])
    assert many.time[world] == one.time[0]


@pytest.mark.parametrize("name", RUNNING)
def test_a_world_of_a_batch_moves_as_its_task_does_to_the_last_bit(name):
    check_same(SceneBatch(name, 2, threads=2), [task_of(name), task_of(name)], 15)


@pytest.mark.slow
@pytest.mark.parametrize("grasp", [STICK, "friction"])
@pytest.mark.parametrize("name", RUNNING)
def test_whole_episodes_in_a_batch_are_those_of_tasks(name, grasp):
    batch = SceneBatch(name, 2, threads=2, grasp=grasp)
    check_same(batch, [task_of(name, grasp), task_of(name, grasp)], 3000)


@pytest.mark.parametrize("grasp", [STICK, "friction", "attach"])
def test_an_episode_with_a_grasp_is_that_of_a_task(grasp):
    batch = SceneBatch("needle-pick", 2, threads=1, grasp=grasp)
    check_same(batch, [task_of("needle-pick", grasp), task_of("needle-pick", grasp)], 200)
    assert batch.success.all()


def test_goals_of_a_later_stage_count_in_a_batch_once_those_before_are_met():
    scene = load_scene("dual-reach")
    first, second = scene.goals
    staged = replace(scene, goals=(first, replace(second, stage=1)))
    batch = SceneBatch(staged, 2, threads=1)
    check_same(batch, [make_task(staged), make_task(staged)], 200)
    assert batch.success.all()


def test_an_object_that_a_world_holds_is_free_after_its_reset():
    batch, fresh = SceneBatch("needle-pick", 2, threads=1), SceneBatch("needle-pick", 2, threads=1)
    task = task_of("needle-pick")
    batch.reset(seeds=[1, 1])
    for action in scripted(task, 1):
        task.command(action)
        batch.command(np.tile(action, (2, 1)))
        if task.referee.held and task.time > 1.0:
            break
    assert (batch.readings.held["PSM1"] >= 0).all()
    for each in (batch, fresh):
        each.reset(np.array([True, False]), [5])
    assert batch.readings.held["PSM1"].tolist() == [-1, 0]
    low, high = batch.limits
    rng = np.random.default_rng(0)
    for _ in range(20):
        actions = 0.5 * rng.uniform(low, high, (2, len(low)))
        batch.command(actions)
        fresh.command(actions)
    np.testing.assert_array_equal(batch.physics.rows[0], fresh.physics.rows[0])


@pytest.mark.parametrize("name", ["needle-handover", "ecm-reach", "peg-board"])
def test_readings_of_a_batch_are_those_of_its_tasks(name):
    batch, task = SceneBatch(name, 3, threads=1), task_of(name)
    batch.reset(seeds=[1, 5, 9])
    script = scripted(task, 5)
    for _ in range(10):
        action = next(script)
        task.command(action)
        batch.command(np.tile(action, (3, 1)))
    one, many = read_task(task), batch.readings
    assert many.names == one.names and len(many) == 3
    for field in ("tips", "targets", "q", "v", "setpoints", "objects", "held", "stalled"):
        mine, its = getattr(many, field), getattr(one, field)
        assert mine.keys() == its.keys()
        for key, value in its.items():
            np.testing.assert_allclose(mine[key][1], value[0], atol=1e-12)
    for field in ("time", "goals", "achieved", "met"):
        np.testing.assert_allclose(getattr(many, field)[1], getattr(one, field)[0], atol=1e-12)


@pytest.mark.parametrize("name", ["needle-pick", "needle-handover"])
def test_random_actions_move_a_batch_as_its_tasks(name):
    batch, tasks = SceneBatch(name, 2, threads=2), [task_of(name), task_of(name)]
    low, high = batch.limits
    rng = np.random.default_rng(7)
    batch.reset(seeds=SEEDS)
    for task, seed in zip(tasks, SEEDS, strict=True):
        task.reset(seed)
    stalled, actions = False, np.zeros((2, len(low)))
    for k in range(60):
        if k % 10 == 0:  # held for 0.2 s: arms come to limits of reach and speed
            actions = rng.uniform(1.2 * low, 1.2 * high, (2, len(low)))
        batch.command(actions)
        for world, task in enumerate(tasks):
            if not task.done:
                task.command(actions[world])
            check_judgement(batch, world, task)
            stalled |= any(task.controller.stalls().values())
    assert stalled


def test_an_arm_that_goes_into_fault_fails_the_episode_when_it_does_in_the_task():
    batch, task = SceneBatch("needle-pick", 2, threads=1), task_of("needle-pick")
    batch.reset(seeds=[3, 4])
    task.reset(3)
    rng = np.random.default_rng(3)  # these actions press the tip into the pad
    low, high = batch.limits
    action = np.zeros(len(low))
    for k in range(100):
        if k % 10 == 0:
            action = rng.uniform(low, high)
        task.command(action)
        batch.command(np.stack([action, task.stay()]))
        check_judgement(batch, 0, task)
        if task.done:
            break
    assert task.reason == "PSM1: FAULT" and batch.failed[0] and not batch.over[1]
    assert batch.physics.tripped[0].any() and not batch.physics.tripped[1].any()


def test_worlds_begin_anew_one_by_one_and_the_others_go_on():
    batch, lone = SceneBatch("needle-pick", 4, threads=2), SceneBatch("needle-pick", 4, threads=1)
    for each in (batch, lone):
        each.reset(seeds=[1, 2, 3, 4])
    rng = np.random.default_rng(0)
    low, high = batch.limits
    for k in range(12):
        actions = 0.5 * rng.uniform(low, high, (4, len(low)))
        if k == 7:
            batch.reset(np.array([False, True, False, False]), [2])
            np.testing.assert_array_equal(batch.seeds, [1, 2, 3, 4])
        batch.command(actions)
        lone.command(actions)
    np.testing.assert_array_equal(batch.physics.rows[[0, 2, 3]], lone.physics.rows[[0, 2, 3]])
    assert batch.readings.time[1] == pytest.approx(5 * PERIOD_S)
    again = SceneBatch("needle-pick", 1, threads=1)
    again.reset(seeds=[2])
    rng = np.random.default_rng(0)
    actions = [0.5 * rng.uniform(low, high, (4, len(low))) for _ in range(12)]
    for action in actions[7:]:
        again.command(action[1:2])
    np.testing.assert_array_equal(again.physics.rows[0], batch.physics.rows[1])


def test_a_world_whose_episode_is_over_stays_until_its_reset():
    batch = SceneBatch("needle-reach", 2, threads=1)
    batch.reset(seeds=[1, 2])
    task = task_of("needle-reach")
    for action in scripted(task, 1):
        task.command(action)
        actions = batch.idle()
        actions[0] = action
        batch.command(actions)
        if task.done:
            break
    assert batch.success[0]
    kept, time = batch.physics.rows[0].copy(), batch.readings.time[1]
    assert batch.command(batch.idle())[0] == 0.0
    np.testing.assert_array_equal(batch.physics.rows[0], kept)
    assert batch.readings.time[1] > time and batch.success[0]
    batch.reset(np.array([True, False]))
    assert not batch.over.any() and batch.readings.time[0] == 0.0


def test_the_same_seed_draws_the_same_episodes():
    batches = [SceneBatch("needle-reach", 3, threads=1, seed=8) for _ in range(2)]
    np.testing.assert_array_equal(batches[0].physics.rows, batches[1].physics.rows)
    assert len(set(batches[0].seeds.tolist())) == 3
    before = batches[0].seeds.copy()
    batches[0].reset()
    assert not np.isin(batches[0].seeds, before).any()


def test_every_scene_runs_in_a_batch_or_a_reason_is_known():
    assert {name for name in SCENES if name not in RUNNING} == {*KEPT_OUT}


@pytest.mark.parametrize(("name", "why"), KEPT_OUT.items())
def test_scenes_that_cannot_run_in_a_batch_are_rejected_with_the_reason(name, why):
    with pytest.raises(InputError, match=rf"SceneBatch: {name}: .*{why}.*allowed in a batch"):
        SceneBatch(name, 2)


def test_other_models_of_grasps_are_rejected():
    with pytest.raises(UnknownNameError, match="glue"):
        SceneBatch("needle-pick", 2, grasp="glue")  # pyright: ignore[reportArgumentType]


def test_robots_with_errors_are_kept_out():
    scene = load_scene("needle-reach")
    scene = replace(scene, rig=replace(scene.rig, errors=robot_errors("lab")))
    with pytest.raises(InputError, match=r"errors of robots \(lab\)"):
        SceneBatch(scene, 2)


def test_a_place_out_of_reach_is_the_error_of_the_task(monkeypatch):
    scene = load_scene("needle-pick")
    (goal,) = scene.goals
    wide = replace(scene, goals=(replace(goal, spread=np.array([0.0, 0.0, 0.07])),))
    task, errors = make_task(wide), dict[int, str]()
    for seed in range(40):
        try:
            task.reset(seed)
        except InputError as problem:
            errors[seed] = str(problem)
    assert 2 < len(errors) < 38
    good = [seed for seed in range(40) if seed not in errors]
    with monkeypatch.context() as patch:  # its first seed is any
        patch.setattr(SceneBatch, "reset", lambda _: None)
        batch = SceneBatch(wide, 1, threads=1)
    for seed, error in list(errors.items())[:3]:
        with pytest.raises(InputError) as caught:
            batch.reset(seeds=[seed])
        assert str(caught.value) == error
    batch.reset(seeds=good[:1])
    assert not batch.over.any()


@pytest.mark.parametrize(
    ("actions", "why"),
    [
        (np.zeros((2, 6)), r"needle-pick: got actions of shape \(2, 6\); allowed: 2 actions of 7"),
        (np.array([[0.0] * 7, [np.nan] * 7]), r"needle-pick: world 1: got the action \[nan"),
        ("up", r"got actions 'up'; allowed"),
    ],
)
def test_actions_that_are_not_allowed_move_nothing(actions, why):
    batch = SceneBatch("needle-pick", 2, threads=1)
    before = batch.physics.rows.copy()
    with pytest.raises(InputError, match=why):
        batch.command(actions)
    np.testing.assert_array_equal(batch.physics.rows, before)


@pytest.mark.parametrize(
    ("mask", "seeds", "why"),
    [
        (np.ones(3, bool), None, "2 of True and False"),
        (None, [1], "2 whole numbers from 0 on"),
        (None, [1, -1], "2 whole numbers from 0 on"),
        (None, [0.5, 1.0], "2 whole numbers from 0 on"),
    ],
)
def test_masks_and_seeds_that_are_not_allowed_are_rejected(mask, seeds, why):
    batch = SceneBatch("needle-reach", 2, threads=1)
    with pytest.raises(InputError, match=why):
        batch.reset(mask, seeds)


@pytest.mark.parametrize("n", [0, -1, 1.5, True])
def test_a_number_of_worlds_is_a_whole_number_above_0(n):
    with pytest.raises(InputError, match="allowed: a whole number above 0"):
        SceneBatch("needle-reach", n)


def test_more_worlds_than_memory_holds_are_rejected_with_how_many_fit(monkeypatch):
    monkeypatch.setattr(scene_batch, "free_memory", lambda: 10_000_000)
    with pytest.raises(InputError, match=r"got n=64, which takes .* GB; allowed: up to 1\d, "):
        SceneBatch("needle-reach", 64)
