"""A flap of tissue that is lifted out of the endoscope's view of a vessel."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.rendering import Endoscope
from trocar.tasks import make_task, run_episode
from trocar.tasks.scenes.retraction import TissueRetraction, passes


@pytest.fixture(scope="module")
def task() -> TissueRetraction:
    found = make_task("tissue-retraction")
    assert isinstance(found, TissueRetraction)
    return found


@pytest.mark.parametrize("seed", [0, pytest.param(9, marks=pytest.mark.slow)])
def test_a_flap_that_hides_the_vessel_is_held_up_until_both_eyes_see_all_of_it(
    task: TissueRetraction, seed: int
) -> None:
    task.reset(seed)
    assert task.exposed() == 0.0
    base = task.object_pose("base")[:3, 3]
    found = run_episode(task, seed)
    assert found.success and found.figures == {"exposed": 1.0} and found.drops == 0
    moved = np.linalg.norm(task.object_pose("base")[:3, 3] - base)
    assert moved < 1e-3  # what the flap grows from stays


def test_a_flap_that_is_let_go_falls_back_by_its_own_weight_and_hides_the_vessel(
    task: TissueRetraction,
) -> None:
    assert run_episode(task, 2).success
    jaw = task.world.arms["PSM1"].jaw
    assert jaw is not None
    jaw.servo_jp([0.8])
    task.world.step(1500)
    assert task.exposed() == 0.0
    turns = [task.object_pose(f"flap{k}")[2, 2] for k in range(1, 7)]
    assert min(turns) > 0.95  # flat


def test_the_flap_bends_at_all_of_its_hinges_when_its_edge_is_lifted(
    task: TissueRetraction,
) -> None:
    run_episode(task, 1)
    names = ["edge", *(f"flap{k}" for k in range(1, 7)), "base"]
    tilt = [np.arctan2(T[2, 1], T[2, 2]) for T in map(task.object_pose, names)]
    bends = np.abs(np.diff(tilt))
    assert (bends > 0.02).sum() >= 5 and bends.max() < 1.6


@pytest.mark.usefixtures("opengl")
def test_sight_by_lines_agrees_with_what_the_renderer_shows(task: TissueRetraction) -> None:
    scope = Endoscope(task.world, preset="dvrk_sd_640x480", visible=["vessel"])
    flap = ["edge", *(f"flap{k}" for k in range(1, 7)), "base"]
    for seed, ends in ((0, True), (1, True), (1, False)):
        task.reset(seed)
        if ends:
            run_episode(task, seed)
        now, cameras = task.world.snapshot(), task.world.cameras()
        seen = scope.render(now, cameras, only=["vessel", *flap]).visible["vessel"]
        assert seen == pytest.approx(task.exposed(), abs=0.05)
    scope.close()


def test_a_line_passes_a_box_where_points_of_it_are_inside() -> None:
    rng = np.random.default_rng(0)
    half = np.array([1.0, 0.5, 0.2])
    start, ends = rng.uniform(-2.0, 2.0, 3), rng.uniform(-2.0, 2.0, (500, 3))
    along = start + np.linspace(0.0, 1.0, 4001)[:, None, None] * (ends - start)
    inside = (np.abs(along) <= half).all(axis=2).any(axis=0)
    found = passes(start, ends, half)
    assert (found | ~inside).all() and (found != inside).mean() < 0.01  # grazing a corner
