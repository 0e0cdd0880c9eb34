"""A batch of randomised worlds: each moves and is seen as its task."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.randomisation import Randomisation, read_randomisation
from trocar.descriptions.records import GraspKind
from trocar.errors import InputError
from trocar.learning.readings import SceneReadings, read_task
from trocar.learning.scene_batch import SceneBatch
from trocar.tasks import make_task

#: All of the preset but the errors of robots, which a batch does not have.
WIDE = replace(read_randomisation("wide"), errors="")


def worst(batch: SceneReadings, world: int, task: SceneReadings) -> float:
    """Return the largest difference of a world's readings from a task's."""
    found = [0.0]
    for f in fields(SceneReadings):
        one, other = getattr(batch, f.name), getattr(task, f.name)
        pairs = [(one, other)]
        if isinstance(one, dict):
            pairs = [(one[name], other[name]) for name in other]
        found += [
            float(np.abs(np.asarray(a[world], float) - np.asarray(b[0], float)).max(initial=0.0))
            for a, b in pairs
            if f.name != "names"
        ]
    return max(found)


@pytest.mark.parametrize("grasp", ["friction", "friction+stick"])
@pytest.mark.parametrize("name", ["needle-pick", "needle-reach"])
def test_a_world_moves_and_is_seen_as_the_task_with_its_seed(name: str, grasp: GraspKind) -> None:
    scene = load_scene(name).randomised(WIDE)
    batch = SceneBatch(scene, 2, threads=1, grasp=grasp)
    task = make_task(replace(scene, rig=replace(scene.rig, grasp=grasp)))
    batch.reset(seeds=[1, 2])
    batch.reset([True, False], [7])  # one world alone, anew
    task.reset(2)
    script = task.policy()
    actions: list[np.ndarray] = []
    assert worst(batch.readings, 1, read_task(task)) <= 1e-10
    while len(actions) < 60 and not task.done:
        actions.append(next(script, task.stay()))
        task.command(actions[-1])
        batch.command(np.array([actions[-1], actions[-1]]))
    assert len(actions) > 20
    assert worst(batch.readings, 1, read_task(task)) <= 1e-10
    task.reset(7)
    for action in actions:
        if not task.done:
            task.command(action)
    assert worst(batch.readings, 0, read_task(task)) <= 1e-10
    mass = batch.physics.expand("body_mass")
    assert not np.array_equal(mass[0], mass[1])


def test_a_batch_without_spreads_moves_as_before() -> None:
    ends = []
    for scene in (load_scene("needle-pick"), load_scene("needle-pick").randomised("none")):
        batch = SceneBatch(scene, 2, threads=1)
        batch.reset(seeds=[1, 2])
        for _ in range(5):
            batch.command(np.full((2, 7), 0.02))
        ends.append(batch.physics.rows.copy())
    assert np.array_equal(*ends)


def test_what_a_batch_lacks_is_named() -> None:
    scene = load_scene("needle-pick")
    with pytest.raises(InputError, match="tips of the camera; allowed in a batch: of the robot"):
        SceneBatch(scene.randomised(Randomisation(), "camera"), 2)
    with pytest.raises(InputError, match="errors of robots"):
        SceneBatch(scene.randomised("lab"), 2)


def test_a_vector_environment_of_an_id_has_the_randomised_worlds_of_single_ones(
    tmp_path: Path,
) -> None:
    gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed (extra gym)")
    spreads = tmp_path / "mine.toml"
    spreads.write_text("gains = 0.1\nobject_bias_mm = 1.0\n", encoding="utf-8")
    words = {"randomise": spreads, "action": "tip"}
    both = gymnasium.make_vec("trocar:trocar/NeedlePick-v0", num_envs=2, **words)
    one, plain = (
        gymnasium.make("trocar:trocar/NeedlePick-v0", **more) for more in (words, {"action": "tip"})
    )
    action = np.full(7, 0.3, np.float32)
    ends = []
    for env, given in ((both, np.stack([action, action])), (one, action), (plain, action)):
        env.reset(seed=4)
        ends.append(np.atleast_2d(env.step(given)[0])[0])
        env.close()
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)
    assert not np.allclose(ends[0], ends[2], atol=1e-6)
