"""Randomised worlds: functions of their seeds, judged by truth, observed with errors."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.randomisation import PRESETS, Randomisation, TipSource, read_randomisation
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.geometry.rotations import matrix_from_quaternion, rotation_z
from trocar.geometry.se3 import inverse, transform
from trocar.learning.readings import read_task
from trocar.tasks import Task, make_task, run_episode
from trocar.tasks.randomisation import FIELDS, RandomisedWorld, Sight

SCENE = "needle-pick"
#: Velocities of the tip [m/s, rad/s], and an open jaw.
ACTION = np.array([0.03, -0.02, -0.02, 0.1, 0.2, 0.3, 0.5])


def randomised(spreads: Randomisation | str, tips: TipSource = "robot", scene: str = SCENE) -> Task:
    return make_task(load_scene(scene).randomised(spreads, tips))


def part(task: Task) -> RandomisedWorld:
    assert task.randomised is not None
    return task.randomised


def moved(task: Task, seed: int, periods: int = 25) -> bytes:
    """Return the state after some periods of motion."""
    task.reset(seed)
    for _ in range(periods):
        task.command(ACTION)
    return task.world.save().row.tobytes()


@pytest.fixture(scope="module")
def lab() -> Task:
    return randomised("lab", "camera")


def test_none_is_the_scene_itself_to_the_last_bit() -> None:
    own = randomised("none")
    assert own.randomised is None
    assert moved(own, 3) == moved(make_task(SCENE), 3)


def test_a_randomisation_without_spreads_moves_as_the_scene_to_the_last_bit() -> None:
    still = randomised(Randomisation(colour_noise=0.1))
    assert still.randomised is not None
    assert moved(still, 3) == moved(make_task(SCENE), 3)


def test_an_episode_is_a_function_of_its_seed_whatever_came_before(lab: Task) -> None:
    first = moved(lab, 1)
    assert moved(lab, 2) != first
    assert moved(lab, 1) == first
    assert moved(randomised("lab", "camera"), 1) == first


def test_one_spread_does_not_move_what_the_others_draw() -> None:
    alone = randomised(Randomisation(object_mass=0.1))
    lab = randomised(replace(read_randomisation("lab"), errors=""))
    alone.reset(4)
    lab.reset(4)
    assert np.array_equal(alone.world.mj_model.body_mass, lab.world.mj_model.body_mass)
    assert not np.array_equal(alone.world.mj_model.dof_damping, lab.world.mj_model.dof_damping)


def test_draws_stay_within_their_spreads_and_differ(lab: Task) -> None:
    nominal = make_task(SCENE).world.mj_model
    gains, masses, damping = [], [], []
    body = nominal.body("needle").id
    for seed in range(20):
        lab.reset(seed)
        gains.append(lab.world.servos.gains[:, 0] / lab.world.joints.gains[:, 0])
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
    task = randomised(Randomisation(object_mass=0.1))
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
    task.reset(0)
    task.controller.registration["PSM1"] = T
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
    task = make_task(load_scene("needle-reach").with_errors("wide"))
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
        task = randomised(Randomisation(errors="lab"), tips)
        for seed in range(5):
            moved(task, seed)
            found[tips].append(off_m(task))
    assert np.mean(found["robot"]) > 1.5e-3
    assert max(found["camera"]) < 0.4e-3  # moves at 40 mm/s, its readings are 5 ms late


def test_a_robots_observed_tips_have_the_errors_of_its_registration() -> None:
    task = randomised(Randomisation(errors="lab"))
    task.reset(3)
    errors = task.world.servos.errors
    assert errors is not None
    T = task.world.camera("endoscope").T_world_camera
    measured = task.world.arms["PSM1"].measured_cp("world").matrix
    seen = inverse(T) @ read_task(task).tips["PSM1"][0]
    assert seen == pytest.approx(errors.registration["PSM1"] @ inverse(T) @ measured, abs=1e-9)


# ------------------------------------------------------------------ sight


def test_perfect_sight_changes_nothing() -> None:
    poses = np.random.default_rng(0).normal(size=(1, 3, 7))
    assert np.array_equal(Sight(Randomisation(), 3).see(poses), poses)


def test_the_bias_of_an_objects_pose_lasts_an_episode_and_its_goal_moves_along() -> None:
    task = randomised(Randomisation(object_bias=0.001), scene="needle-reach")
    offs = []
    for seed in (1, 2):
        task.reset(seed)
        for _ in range(3):
            task.command(np.array([0, 0, 0, 0, 0, 0, 0.5]))
            seen, true = read_task(task), task.object_pose("needle")[:3, 3]
            offs.append(seen.objects["needle"][0, :3] - true)
            assert task.observation()["needle"][:3] == pytest.approx(true + offs[-1], abs=1e-12)
            ((goal, at),) = task.goals
            assert seen.goals[0, 0] == pytest.approx(at + true + offs[-1], abs=1e-12)
            assert goal.object == "needle"
    assert offs[0] == pytest.approx(offs[2], abs=1e-9)
    assert np.linalg.norm(offs[0] - offs[3]) > 1e-4
    assert 1e-4 < np.linalg.norm(offs[0]) < 5e-3


def test_a_goal_on_an_object_is_seen_where_the_object_is_seen() -> None:
    scene = replace(load_scene("icra2026-peg-transfer"), hidden=())
    task = make_task(scene.randomised(Randomisation(object_bias=0.001, object_bias_turn=0.02)))
    true = make_task(scene)
    for one in (task, true):
        one.reset(3)
    seen, places = read_task(task), read_task(true)
    for k, (goal, at) in enumerate(task.goals):
        found = []
        for readings in (seen, places):
            pose = readings.objects[goal.on][0]
            T = transform(matrix_from_quaternion(pose[3:]), pose[:3])
            found.append((T @ [*at, 1.0])[:3])
            assert readings.goals[0, k] == pytest.approx(found[-1], abs=1e-12)
        assert np.linalg.norm(found[0] - found[1]) > 1e-4


def test_seen_objects_are_as_old_as_the_image() -> None:
    task = randomised(Randomisation(vision_age=0.04))
    task.reset(0)
    task.world.objects["needle"].set_cp(transform(np.eye(3), [0.0, 0.0, 0.05]))  # falls
    task.begin()
    true, seen = [task.object_pose("needle")[:3, 3]], [read_task(task).objects["needle"][0, :3]]
    for _ in range(4):
        task.command(ACTION)
        true.append(task.object_pose("needle")[:3, 3])
        seen.append(read_task(task).objects["needle"][0, :3])
    assert not np.allclose(true[0], true[1], atol=1e-6)
    expected = [true[0], true[0], true[0], true[1], true[2]]
    assert np.array(seen) == pytest.approx(np.array(expected), abs=1e-9)


def test_n_worlds_are_seen_as_each_alone() -> None:
    spread = read_randomisation("wide")
    poses = np.random.default_rng(0).normal(size=(2, 16, 1, 3, 7))
    poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    alone = []
    for seed, row in enumerate(poses):
        sight = Sight(spread, 3)
        sight.begin([seed])
        alone.append([sight.see(one)[0] for one in row[:8]])
    both = Sight(spread, 3, 2)
    both.begin([0, 1], [0, 1])
    for k in range(8):
        seen = both.see(poses[:, k, 0], [0, 1])
        assert seen == pytest.approx(np.array([alone[0][k], alone[1][k]]), abs=1e-12)
    both.begin([1], [0])  # the first world begins the second one's episode, the other rests
    for k in range(8):
        assert both.see(poses[1, k], [0])[0] == pytest.approx(alone[1][k], abs=1e-12)


def test_the_camera_and_the_exposure_follow_from_the_seed(lab: Task) -> None:
    stops, places = [], []
    for seed in (1, 2, 1):
        lab.reset(seed)
        stops.append(part(lab).stops)
        places.append(part(lab).seen_from(lab.world.camera("endoscope")).T_world_camera)
    assert stops[0] == stops[2] != stops[1]
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
    scene = load_scene(SCENE)
    with pytest.raises(UnknownNameError, match="wide"):
        scene.randomised("wild")
    with pytest.raises(UnknownNameError, match="perfect"):
        scene.with_errors("none")
    with pytest.raises(InputError, match="tips: got 'eye'; allowed: robot, camera"):
        scene.randomised("lab", "eye")  # pyright: ignore[reportArgumentType]


def test_settings_of_a_scene_name_errors_randomisation_and_tips() -> None:
    found = load_scene(SCENE, {"randomise": "lab", "tips": "camera"})
    assert found.randomisation == read_randomisation("lab")
    assert found.tips == "camera" and found.rig.errors is not None and not found.welded
    assert load_scene(SCENE, {"errors": "wide"}).rig.errors == found.with_errors("wide").rig.errors
    for key, value in (("errors", "worn"), ("randomise", "labs"), ("tips", "eye")):
        with pytest.raises(DescriptionError, match=f"needle-pick.toml: {key}: .*{value}"):
            load_scene(SCENE, {key: value})


def test_the_expert_picks_on_a_lab_robot_that_a_camera_registers() -> None:
    task = randomised("lab", "camera")
    assert sum(run_episode(task, seed).success for seed in range(3)) == 3
