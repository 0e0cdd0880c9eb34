from __future__ import annotations

import numpy as np
import pytest

from trocar.learning.observations import BOUND, SCALE, StateEncoder
from trocar.learning.readings import read_task
from trocar.tasks import make_task


def columns(encoder: StateEncoder, row: np.ndarray, beginning: str) -> np.ndarray:
    return row[[k for k, name in enumerate(encoder.names) if name.startswith(beginning)]]


@pytest.mark.parametrize("scene", ["needle-reach", "bi-peg-transfer", "ecm-reach", "dynamic-stack"])
def test_each_column_has_a_name_and_is_bounded(scene: str) -> None:
    task = make_task(scene)
    encoder = StateEncoder(task)
    seen = encoder.encode(read_task(task))
    assert seen.shape == (1, encoder.size) == (1, len(encoder.names))
    assert len(set(encoder.names)) == encoder.size
    assert seen.dtype == np.float32
    assert np.abs(seen).max() <= BOUND


def test_named_columns_are_those_of_the_task() -> None:
    task = make_task("needle-pick")
    encoder = StateEncoder(task)
    row = encoder.encode(read_task(task))[0]
    seen = task.observation()
    off = SCALE * (seen["PSM1"][:3] - encoder.centre)
    assert columns(encoder, row, "PSM1.tip.") == pytest.approx(off, abs=1e-6)
    way = SCALE * (seen["needle"][:3] - seen["PSM1"][:3])
    assert columns(encoder, row, "needle.from_PSM1.") == pytest.approx(way, abs=1e-6)
    way = SCALE * (seen["goals"][0] - seen["needle"][:3])
    assert columns(encoder, row, "goal1.way.") == pytest.approx(way, abs=1e-6)
    assert columns(encoder, row, "time_left") == pytest.approx([1.0])
    assert columns(encoder, row, "PSM1.holds") == [0.0]


def test_a_held_object_is_in_the_hand_of_its_arm() -> None:
    task = make_task("needle-pick")
    encoder = StateEncoder(task)
    for action in task.policy():
        task.command(action)
        if task.referee.held:
            break
    row = encoder.encode(read_task(task))[0]
    assert columns(encoder, row, "PSM1.holds") == [1.0]
    assert columns(encoder, row, "needle.in_PSM1") == [1.0]


def test_the_goal_dict_is_the_state_without_the_goals() -> None:
    task = make_task("dynamic-stack")
    encoder = StateEncoder(task)
    readings = read_task(task)
    seen, achieved, desired = encoder.encode_goal(readings)
    whole = encoder.encode(readings)
    assert np.array_equal(seen, whole[:, : seen.shape[1]])
    assert achieved.shape == desired.shape == (1, 9)
    assert desired[0, :3] == pytest.approx(columns(encoder, whole[0], "goal1.position"))
    way = columns(encoder, whole[0], "goal1.way")
    assert (desired - achieved)[0, :3] == pytest.approx(way, abs=1e-5)


def test_the_centre_follows_from_the_scene_alone() -> None:
    task = make_task("needle-pick")
    before = StateEncoder(task).centre
    task.reset(7)
    assert np.array_equal(StateEncoder(task).centre, before)
