"""Randomised worlds: functions of their seeds, judged by truth, observed with errors."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import inverse, transform
from trocar.learning import randomisation as module
from trocar.learning.randomisation import (
    FIELDS,
    PRESETS,
    Randomisation,
    Sight,
    randomised_task,
    randomised_world,
    read_randomisation,
    sight_of,
    with_errors,
)
from trocar.learning.readings import SceneReadings, read_task
from trocar.rendering import Look
from trocar.tasks import Task, make_task, run_episode

SCENE = "needle-pick"
#: Velocities of the tip [m/s, rad/s], and an open jaw.
ACTION = np.array([0.03, -0.02, -0.02, 0.1, 0.2, 0.3, 0.5])


def joined(a: SceneReadings, b: SceneReadings) -> SceneReadings:
    """Join the readings of two worlds."""

    def both(one: Any, two: Any) -> Any:
        if isinstance(one, dict):
            return {name: both(one[name], two[name]) for name in one}
        return one if isinstance(one, tuple) else np.concatenate([one, two])

    found = {f.name: both(getattr(a, f.name), getattr(b, f.name)) for f in fields(a)}
    return SceneReadings(**found)


def moved(task: Task, seed: int, periods: int = 25) -> bytes:
    """Return the state after some periods of motion."""
    task.reset(seed)
    for _ in range(periods):
        task.command(ACTION)
    return task.world.save().row.tobytes()


@pytest.fixture(scope="module")
def lab() -> Task:
    return randomised_task(SCENE, "lab", tips="camera")


def test_none_is_the_scene_itself_to_the_last_bit() -> None:
    own = randomised_task(SCENE, "none")
    assert randomised_world(own) is None and sight_of(own) is None
    assert moved(own, 3) == moved(make_task(SCENE), 3)


def test_a_randomisation_without_spreads_moves_as_the_scene_to_the_last_bit() -> None:
    still = randomised_task(SCENE, Randomisation(colour_noise=0.1))
    assert randomised_world(still) is not None
    assert moved(still, 3) == moved(make_task(SCENE), 3)


def test_an_episode_is_a_function_of_its_seed_whatever_came_before(lab: Task) -> None:
    first = moved(lab, 1)
    assert moved(lab, 2) != first
    assert moved(lab, 1) == first
    assert moved(randomised_task(SCENE, "lab", tips="camera"), 1) == first


def test_one_spread_does_not_move_what_the_others_draw() -> None:
    alone = randomised_task(SCENE, Randomisation(object_mass=0.1))
    lab = randomised_task(SCENE, replace(read_randomisation("lab"), errors=""))
    alone.reset(4)
    lab.reset(4)
    assert np.array_equal(alone.world.mj_model.body_mass, lab.world.mj_model.body_mass)
    assert not np.array_equal(alone.world.mj_model.dof_damping, lab.world.mj_model.dof_damping)


def test_draws_stay_within_their_spreads_and_differ(lab: Task) -> None:
    part, nominal = randomised_world(lab), make_task(SCENE).world.mj_model
    assert part is not None
    gains, masses, damping = [], [], []
    body = nominal.body("needle").id
    for seed in range(20):
        lab.reset(seed)
        gains.append(part.gains)
        masses.append(lab.world.mj_model.body_mass[body] / nominal.body_mass[body])
        dofs = nominal.dof_damping > 0.0
        damping.append(lab.world.servos.friction[1][: len(dofs)][dofs] / nominal.dof_damping[dofs])
    for drawn, width in ((gains, 0.04), (masses, 0.1), (damping, 0.4)):
        off = np.abs(np.concatenate([np.ravel(row) for row in drawn]) - 1.0)
        assert off.max() <= width + 1e-12
        assert off.mean() == pytest.approx(width / 2.0, rel=0.3)  # uniform


def test_an_object_keeps_its_inverse_weight_times_its_mass(lab: Task) -> None:
    nominal = make_task(SCENE).world.mj_model
    lab.reset(7)
    drawn, body = lab.world.mj_model, nominal.body("needle").id
    for one, other in (("body_mass", "body_invweight0"), ("body_inertia", "body_invweight0")):
        ratio = getattr(drawn, one)[body] / getattr(nominal, one)[body]
        back = getattr(drawn, other)[body] / getattr(nominal, other)[body]
        assert np.mean(ratio) != 1.0
        assert np.mean(ratio) * np.mean(back) == pytest.approx(1.0, abs=1e-12)
    assert drawn.body_subtreemass[0] == pytest.approx(drawn.body_mass.sum())


def test_fields_that_are_not_drawn_are_the_compiled_ones() -> None:
    task = randomised_task(SCENE, Randomisation(object_mass=0.1))
    nominal, drawn = make_task(SCENE).world.mj_model, task.world.mj_model
    for name in set(FIELDS) - {"body_mass", "body_inertia", "body_subtreemass"}:
        if "invweight" not in name and name != "dof_M0":
            assert np.array_equal(getattr(drawn, name), getattr(nominal, name)), name


def test_a_saved_world_goes_on_with_its_own_draws(lab: Task) -> None:
    lab.reset(5)
    state = lab.world.save()
    lab.world.step(200)
    after = lab.world.save().row.tobytes()
    lab.reset(6)
    lab.world.load(state)
    lab.world.step(200)
    assert lab.world.save().row.tobytes() == after


# ------------------------------------------------------------------ tips


def test_an_action_moves_a_registered_tip_in_axes_of_the_world() -> None:
    task = make_task(SCENE)
    T = transform(rotation_z(0.5), [0.002, -0.001, 0.003])
    task.controller.registration["PSM1"] = T
    task.reset(0)
    for _ in range(10):  # begins to move
        task.command(ACTION)
    before = task.controller.target("PSM1")
    task.command(ACTION)
    after = task.controller.target("PSM1")
    assert after[:3, 3] - before[:3, 3] == pytest.approx(0.02 * ACTION[:3], abs=1e-12)
    measured = task.world.arms["PSM1"].measured_cp("world").matrix
    assert inverse(T) @ task.controller.tip("PSM1") == pytest.approx(measured, abs=1e-12)
    reached = task.observation()["PSM1"][:3]
    assert reached == pytest.approx((T @ measured)[:3, 3], abs=1e-12)


def test_goals_are_judged_by_the_true_tip() -> None:
    task = make_task(with_errors("needle-reach", "wide"))
    ((goal, at),) = task.goals
    run_episode(task, 2)
    true = task.world.true_state("PSM1").world[:3, 3]
    off = true - at - task.object_pose(goal.object)[:3, 3]
    assert task.met(goal, at) == bool(np.hypot(*off[:2]) <= 0.002 and abs(off[2]) <= 0.002)
    assert np.linalg.norm(true - task.controller.tip("PSM1")[:3, 3]) > 0.002


def off_m(task: Task) -> float:
    """Return the distance from the true to the observed tip [m]."""
    true = task.world.true_state("PSM1").world[:3, 3]
    return float(np.linalg.norm(true - read_task(task).tips["PSM1"][0, :3, 3]))


def test_a_camera_brings_the_observed_tip_to_the_true_one_while_it_moves() -> None:
    found: dict[str, list[float]] = {"robot": [], "camera": []}
    for tips in ("robot", "camera"):
        task = randomised_task(SCENE, Randomisation(errors="lab"), tips=tips)
        for seed in range(5):
            moved(task, seed)
            found[tips].append(off_m(task))
    assert np.mean(found["robot"]) > 1.5e-3
    assert max(found["camera"]) < 0.4e-3  # moves at 40 mm/s, its readings are 5 ms late


def test_a_robots_observed_tips_have_the_errors_of_its_registration() -> None:
    task = randomised_task(SCENE, Randomisation(errors="lab"))
    task.reset(3)
    errors = task.world.servos.errors
    assert errors is not None
    T = task.world.camera("endoscope").T_world_camera
    measured = task.world.arms["PSM1"].measured_cp("world").matrix
    seen = inverse(T) @ read_task(task).tips["PSM1"][0]
    assert seen == pytest.approx(errors.registration["PSM1"] @ inverse(T) @ measured, abs=1e-9)


# ------------------------------------------------------------------ sight


def test_perfect_sight_changes_nothing(lab: Task) -> None:
    lab.reset(0)
    readings = read_task(lab)
    sight = Sight(Randomisation(), lab.scene.goals)
    sight.begin([0])
    seen = sight.observe(readings)
    assert seen.objects["needle"] == pytest.approx(readings.objects["needle"], abs=1e-12)
    assert seen.achieved == pytest.approx(readings.achieved, abs=1e-12)


def test_the_bias_of_an_objects_pose_lasts_an_episode_and_its_goal_moves_along() -> None:
    task = randomised_task("needle-reach", Randomisation(object_bias=0.001))
    sight = sight_of(task)
    assert sight is not None
    offs = []
    for seed in (1, 2):
        task.reset(seed)
        sight.begin([seed])
        for _ in range(3):
            task.command(np.array([0, 0, 0, 0, 0, 0, 0.5]))
            true, seen = read_task(task), sight.observe(read_task(task))
            offs.append((seen.objects["needle"] - true.objects["needle"])[0, :3])
            assert (seen.goals - true.goals)[0, 0] == pytest.approx(offs[-1], abs=1e-12)
    assert offs[0] == pytest.approx(offs[2], abs=1e-9)
    assert np.linalg.norm(offs[0] - offs[3]) > 1e-4
    assert 1e-4 < np.linalg.norm(offs[0]) < 5e-3


def test_seen_objects_are_as_old_as_the_image() -> None:
    task = make_task(SCENE)
    sight = Sight(Randomisation(vision_age=0.04), task.scene.goals)
    task.reset(0)
    sight.begin([0])
    task.world.objects["needle"].set_cp(transform(np.eye(3), [0.0, 0.0, 0.05]))  # falls
    true, seen = [], []
    for _ in range(4):
        task.command(ACTION)
        true.append(read_task(task).objects["needle"][0])
        seen.append(sight.observe(read_task(task)).objects["needle"][0])
    assert not np.allclose(true[0], true[1], atol=1e-6)
    assert np.array(seen) == pytest.approx(np.array([true[0], true[0], true[0], true[1]]), abs=1e-9)


def test_n_worlds_are_seen_as_each_alone() -> None:
    task, spread = make_task(SCENE), read_randomisation("wide")
    rows = []
    for seed in (0, 1):
        task.reset(seed)
        rows.append([])
        for _ in range(8):
            task.command(ACTION)
            rows[-1].append(read_task(task))
    alone = []
    for seed, row in enumerate(rows):
        sight = Sight(spread, task.scene.goals)
        sight.begin([seed])
        alone.append([sight.observe(one).objects["needle"][0] for one in row])
    both = Sight(spread, task.scene.goals, 2)
    both.begin([0, 1])
    for k in range(4):
        seen = both.observe(joined(rows[0][k], rows[1][k])).objects["needle"]
        assert seen == pytest.approx(np.array([alone[0][k], alone[1][k]]), abs=1e-12)
    both.begin([1], [0])  # the first world begins the second one's episode
    for k in range(4):
        seen = both.observe(joined(rows[1][k], rows[1][k + 4])).objects["needle"]
        assert seen == pytest.approx(np.array([alone[1][k], alone[1][k + 4]]), abs=1e-12)


def test_the_look_and_the_camera_follow_from_the_seed(lab: Task) -> None:
    part = randomised_world(lab)
    assert part is not None
    looks, places = [], []
    for seed in (1, 2, 1):
        lab.reset(seed)
        looks.append(part.look_of(Look(exposure=0.0)))
        places.append(part.seen_from(lab.world.camera("endoscope")).T_world_camera)
    assert looks[0] == looks[2] != looks[1]
    assert looks[0].noise == 0.03 and looks[0].exposure != 0.0
    assert np.array_equal(places[0], places[2])
    assert 1e-5 < np.linalg.norm(places[0][:3, 3] - places[1][:3, 3]) < 1e-2


# ------------------------------------------------------------------ files


def test_every_key_of_the_presets_has_a_source() -> None:
    text = PRESETS.read_text()
    source = text.split('"""')[1]
    for f in fields(Randomisation):
        root = f.name.removesuffix("_turn")
        root = "tip_bias" if root == "tip_noise" else root
        assert root.split("_noise")[0] in source, f.name


def test_a_file_replaces_values_of_a_preset(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('preset = "lab"\nobject_bias_mm = 2\n')
    assert read_randomisation(path) == replace(read_randomisation("lab"), object_bias=0.002)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("object_bias = 2\n", "object_bias"),
        ("gain = 2\n", "gain"),
        ("gains = -0.1\n", "gains: got -0.1; allowed: 0 to 0.9"),
        ('preset = "labs"\n', "preset: .*labs.*did you mean"),
        ('errors = "worn"\n', "errors: .*worn"),
    ],
)
def test_broken_files_name_the_key(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(DescriptionError, match=message):
        read_randomisation(path)


def test_unknown_presets_and_tips_are_named() -> None:
    with pytest.raises(UnknownNameError, match="wide"):
        randomised_task(SCENE, "wild")
    with pytest.raises(UnknownNameError, match="perfect"):
        with_errors(SCENE, "none")
    with pytest.raises(InputError, match="tips: got 'eye'; allowed: robot, camera"):
        randomised_task(SCENE, "lab", tips="eye")  # pyright: ignore[reportArgumentType]


def test_the_expert_picks_on_a_lab_robot_that_a_camera_registers() -> None:
    task = randomised_task(SCENE, "lab", tips="camera")
    assert module.PART in task.world.parts
    assert sum(run_episode(task, seed).success for seed in range(3)) == 3
