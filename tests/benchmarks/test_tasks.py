"""Figures of scenes."""

from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.random_actions import random_actions
from benchmarks.tasks import asleep_and_awake, figures, tasks
from trocar.errors import InputError
from trocar.tasks import Episode


def episode(success: bool, time_s: float) -> Episode:
    reason = "done" if success else "time"
    each = {"PSM1": 1.0}
    return Episode(
        "s", 0, success, reason, 1.0, time_s, 1, 1, 2, each, each, each, each, "friction", "cad", ""
    )


def test_times_are_those_of_successes_and_drops_those_of_all() -> None:
    results = [episode(True, 4.0), episode(True, 6.0), episode(False, 10.0)]
    found = {figure.name: figure.value for figure in figures(results, 2.0, 1e-5)}
    assert found["s: success"] == pytest.approx(2.0 / 3.0)
    assert found["s: time"] == 5.0
    assert found["s: drops"] == 6
    assert found["s: speed"] == 10.0
    assert found["s: a millisecond"] == pytest.approx(10.0)  # 0.1 ms, in steps of 10 us


def test_episodes_that_a_file_has_are_not_run_again(tmp_path: Path) -> None:
    file, scene = tmp_path / "kept.jsonl", ["needle-reach"]
    quiet: Callable[[str], None] = lambda _: None  # noqa: E731
    tasks(scene, 1, quiet, file)
    kept = file.read_text(encoding="utf-8")
    again = tasks(scene, 2, quiet, file)
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    assert lines[0] == kept and len(lines) == 2
    file.write_text(lines[0] + lines[1].replace('"success": true', '"success": false'))
    assert (again[0].value, tasks(scene, 2, quiet, file)[0].value) == (1.0, 0.5)


def test_episodes_of_a_policy_file_are_kept_apart_from_scripted_ones(tmp_path: Path) -> None:
    still = "def make_policy(env):\n    return lambda obs: 0.0 * env.actions.low\n"
    file, policy = tmp_path / "kept.jsonl", tmp_path / "still.py"
    policy.write_text(still, encoding="utf-8")
    quiet: Callable[[str], None] = lambda _: None  # noqa: E731
    for _ in range(2):
        assert tasks(["needle-reach"], 1, quiet, file, policy=policy)[0].value == 0.0
        assert tasks(["needle-reach"], 1, quiet, file)[0].value == 1.0
    assert len(file.read_text(encoding="utf-8").splitlines()) == 2
    with pytest.raises(InputError, match=r"still.py is for any scene; allowed: with --scene"):
        tasks([], 1, quiet, policy=policy)


def test_an_object_costs_less_while_it_sleeps() -> None:
    asleep, awake = asleep_and_awake()
    assert 0.0 < asleep.value < awake.value


def test_an_episode_of_random_efforts_ends_when_something_has_left_the_table() -> None:
    found = random_actions(["needle-handover"], 14, 0.8, lambda _: None)  # the last flings it off
    values = {figure.name.split(": ")[1]: figure for figure in found}
    assert values["fastest object"].value > 2.0
    assert values["deepest object"].value < 2.0  # mm; on the floor, 0.75 m below, 2.1
    assert "of 0.77 s" in values["deepest object"].source


def test_what_lies_on_the_table_is_pressed_in_by_nanometres_for_longer_than_it_hits() -> None:
    found = random_actions(["dynamic-bar"], 1, 0.12, lambda _: None)
    values = {figure.name.split(": ")[1]: figure.value for figure in found}
    assert 0.0 < values["deepest object for 20 ms"] < values["deepest object"] < 2.0
