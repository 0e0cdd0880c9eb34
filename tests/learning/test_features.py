"""Features and plans: the same for one world and many, and plans that undo actions."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from trocar.learning.features import SCALE, SceneFeatures, SetpointPlans
from trocar.learning.readings import SceneReadings, read_task
from trocar.tasks import Task, make_task


def stacked(found: list[SceneReadings]) -> SceneReadings:
    """Return readings of several worlds or periods as one."""

    def joined(values: list[Any]) -> Any:
        if isinstance(values[0], dict):
            return {key: joined([value[key] for value in values]) for key in values[0]}
        return values[0] if isinstance(values[0], tuple) else np.concatenate(values)

    parts = {f.name: joined([getattr(one, f.name) for one in found]) for f in fields(found[0])}
    return SceneReadings(**parts)


def played(task: Task, seed: int, periods: int) -> tuple[SceneReadings, np.ndarray]:
    """Return readings before each action of a scripted episode's beginning, and the actions."""
    task.reset(seed)
    seen, actions = [], []
    for action, _ in zip(task.policy(), range(periods), strict=False):
        seen.append(read_task(task))
        actions.append(action)
        task.command(action)
    return stacked(seen), np.array(actions)


@pytest.mark.parametrize("scene", ["needle-pick", "bi-peg-transfer", "ecm-reach", "needle-reach"])
def test_features_of_many_worlds_are_those_of_each(scene: str) -> None:
    task = make_task(scene)
    features, alone = SceneFeatures(task), []
    for seed in (3, 4):
        task.reset(seed)
        alone.append(read_task(task))
    found = features.encode(stacked(alone))
    assert found.shape == (2, features.size) and len(set(features.names)) == features.size
    assert found.dtype == np.float32
    for row, one in zip(found, alone, strict=True):
        np.testing.assert_array_equal(row, features.encode(one)[0])
    assert (found[0] != found[1]).any()


def test_features_name_the_way_from_the_tip_to_an_object() -> None:
    task = make_task("needle-pick")
    task.reset(1)
    features, readings = SceneFeatures(task), read_task(task)
    columns = [features.names.index(f"PSM1 to needle {axis}") for axis in "xyz"]
    way = task.object_pose("needle")[:3, 3] - readings.tips["PSM1"][0, :3, 3]
    found = features.encode(readings)[0, columns]
    np.testing.assert_allclose(found, way * SCALE, rtol=1e-6)  # float32


@pytest.mark.parametrize("scene", ["needle-pick", "ecm-reach", "needle-handover"])
def test_plans_undo_the_actions_that_they_are_made_of(scene: str) -> None:
    task, length = make_task(scene), 5
    readings, actions = played(task, 2, 40)
    plans = SetpointPlans(task)
    labels = plans.labels(readings, actions, length).reshape(-1, length, plans.width)
    for k in range(length):  # planned k periods ago, carried out as if now
        then, now = rows(readings, slice(0, 40 - k)), rows(readings, slice(k, 40))
        planned = plans.setpoints(labels[: 40 - k].astype(np.float64), then)
        found = plans.actions(planned[:, k : k + 1], now)[:, 0]
        # float32 of 50 mm at a scale of 50 per metre, over a period: 1e-7 * 2.5 / 50 / 0.02
        np.testing.assert_allclose(found, actions[k:], atol=2e-5)


def rows(readings: SceneReadings, part: slice) -> SceneReadings:
    """Return the readings of some periods."""

    def taken(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: taken(one) for key, one in value.items()}
        return value if isinstance(value, tuple) else value[part]

    return replace(readings, **{f.name: taken(getattr(readings, f.name)) for f in fields(readings)})


def test_labels_repeat_the_last_set_point_beyond_the_end() -> None:
    task = make_task("needle-pick")
    readings, actions = played(task, 2, 4)
    plans = SetpointPlans(task)
    labels = plans.labels(readings, actions, 10).reshape(4, 10, plans.width)
    np.testing.assert_array_equal(labels[-1], np.repeat(labels[-1, :1], 10, axis=0))


def test_capped_actions_keep_their_direction_and_the_jaw() -> None:
    plans = SetpointPlans(make_task("needle-pick"))
    fast = np.array([[0.3, 0.0, 0.4, 0.0, 6.0, 8.0, 0.7], [0.01, 0.0, 0.0, 0.1, 0.0, 0.0, -0.3]])
    found = plans.capped(fast, 0.15, 2.5)
    np.testing.assert_allclose(found[0], [0.09, 0.0, 0.12, 0.0, 1.5, 2.0, 0.7], rtol=1e-12)
    np.testing.assert_array_equal(found[1], fast[1])
