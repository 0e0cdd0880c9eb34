"""Scenes as tasks: episodes follow from seed and policy; bad input is one error."""

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.descriptions import load_rig, names
from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.inertial import STANDARD_GRAVITY
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.geometry.se3 import inverse, transform
from trocar.simulation import World
from trocar.tasks import Ending, Task, make_task, run_episode, task_names
from trocar.tasks.motions import Hand, together
from trocar.tasks.registry import task_class
from trocar.tasks.scenes.transfer import WallTransfer
from trocar.tasks.scenes.vision import VisualServoing


@pytest.fixture
def task(touch: Path) -> Task:
    return make_task(str(touch))


def test_a_scene_of_ones_own_succeeds_and_repeats_to_the_last_bit(touch: Path) -> None:
    first, again = (make_task(str(touch)) for _ in range(2))
    run_episode(again, 4)  # what came before does not count
    one, two = run_episode(first, 3), run_episode(again, 3)
    assert one.success
    assert (one.reason, one.met, one.drops, one.grasp) == ("done", 2, 0, "friction+stick")
    assert one == two


def test_the_kind_of_grasp_of_a_scene_stands_in_its_result(touch: Path) -> None:
    text = touch.read_text(encoding="utf-8").replace("task = ", 'grasp = "attach"\ntask = ', 1)
    touch.write_text(text, encoding="utf-8")
    assert run_episode(make_task(str(touch)), 3).grasp == "attach"


def test_seeds_draw_different_places(task: Task) -> None:
    a, b = task.reset(1)["cube"], task.reset(2)["cube"]
    assert np.linalg.norm(a - b) > 1e-3
    assert (task.reset(1)["cube"] == a).all()


#: Tests of these take more than a few seconds; needle-handover has a test of its own.
LONG = (
    "active-track",
    "augmented-reality",
    "bi-peg-transfer",
    "dynamic-push",
    "dynamic-stack",
    "fls-peg-transfer",
    "icra2026-peg-transfer",
    "match-board",
    "needle-handover",
    "needle-regrasp",
    "needle-through-phantom",
    "needle-tracking",
    "peg-board",
    "pick-place",
    "suturing",
    "thread-knot",
    "visual-servoing",
)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n in LONG)) for n in names("scenes")]
)
def test_the_scripted_policy_of_every_scene_succeeds_without_a_drop(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(VisualServoing, "WORK_S", 5.0)  # a minute, of which each second is alike
    found = run_episode(make_task(name), 1)
    assert found.success and found.met == found.goals and found.drops == 0
    if "peg" in name:
        assert found.time_s < found.goals * 8.1  # Hwang 2020, a transfer of the real dVRK


def test_a_needle_changes_hands_and_does_not_fall() -> None:
    task = make_task("needle-handover")
    task.reset(0)
    holders: list[tuple[str, ...]] = []
    for action in task.policy():
        task.command(action)
        now = tuple(arm for arm in task.arms if task.referee.held.get(arm) == "needle")
        if not holders or holders[-1] != now:
            holders.append(now)
        if ("PSM1", "PSM2") in holders:
            assert task.object_pose("needle")[2, 3] > 0.02
        if task.done:
            break
    assert holders[holders.index(("PSM1", "PSM2")) - 1] == ("PSM2",)
    assert holders[-1] == ("PSM1",)


def test_no_jaw_presses_a_needle_harder_than_its_motor_can_though_an_edge_digs_into_it() -> None:
    """0.16 N m at 4 mm from the jaw's axis, where the pads begin, are 40 N."""
    result = run_episode(make_task("needle-handover"), 7)
    assert result.success
    assert 10.0 < min(result.grip_n.values()) <= max(result.grip_n.values()) < 45.0


def test_both_arms_hold_a_bar_before_it_is_lifted_and_do_not_press_on_each_other() -> None:
    task = make_task("dynamic-bar")
    task.reset(23)  # one arm arrives long before the other
    rest = task.referee.position("bar")[2]
    for action in task.policy():
        task.command(action)
        if task.referee.position("bar")[2] > rest + 0.015:
            break
    assert task.referee.held == {"PSM1": "bar", "PSM2": "bar"}
    for _ in range(20):
        task.command(task.stay())
    forces = task.world.contact_forces()
    weight = STANDARD_GRAVITY * float(task.world.mj_model.body("bar").mass[0])
    assert forces["PSM1"][2] + forces["PSM2"][2] == pytest.approx(-weight, rel=1e-2)
    assert max(np.linalg.norm(force) for force in forces.values()) < 5.0


def test_rings_are_grasped_without_pressing_on_the_board() -> None:
    task = make_task("peg-transfer")
    run_episode(task, 1)
    weight = STANDARD_GRAVITY * float(task.world.mj_model.body("ring").mass[0])
    assert task.referee.force["PSM1"] < 10.0 * weight < 1.0


def test_goals_of_a_stage_count_once_those_before_were_met_and_then_stay(touch: Path) -> None:
    scene = load_scene(touch)
    away = replace(scene.goals[0], at=np.array([0.03, 0.012, 0.007]))
    back = replace(scene.goals[0], at=np.array([0.03, -0.03, 0.007]), stage=1)
    task = make_task(replace(scene, goals=(away, back), task="task"))
    task.reset(0)
    stages: list[tuple[int, int]] = []
    for y in (-0.03, 0.012, -0.03):
        task.world.objects["cube"].set_cp(transform(np.eye(3), [0.03, y, 0.00701]))
        for _ in range(15):
            if not task.done:
                task.command(task.stay())
        stages.append((task.referee.stage, task.state()["met"]))
    assert stages == [(0, 0), (1, 1), (1, 2)]
    assert task.referee.ending is Ending.SUCCESS


def test_arms_that_a_scene_does_not_drive_are_welded(touch: Path) -> None:
    scene = load_scene(touch)
    assert scene.welded == ("PSM2", "ECM")
    task = make_task(scene)
    task.reset(0)
    before = task.world.arms["ECM"].joints.positions()
    assert not task.world.arms["ECM"].servo_jp(before)
    assert make_task(replace(scene, welded=())).world.arms["ECM"].servo_jp(before)


def test_a_place_on_an_object_goes_with_it_and_what_is_hidden_is_not_observed() -> None:
    task = make_task("icra2026-peg-transfer")
    poses: list[np.ndarray] = []
    for seed in range(2):
        seen = task.reset(seed)
        assert (
            "board" not in seen and seen["goals"].shape == (0, 3) and {"red", "blue"} <= set(seen)
        )
        poses.append(task.object_pose("board"))
        for goal, at in task.goals:
            start = task.object_pose(goal.object)
            on = inverse(poses[-1]) @ start
            assert abs(on[0, 3] + at[0]) < 1e-3 and abs(on[1, 3] - at[1]) < 1e-3  # across the wall
            assert task.referee.place(goal, at) == pytest.approx((poses[-1] @ [*at, 1.0])[:3])
    assert np.abs(poses[0] - poses[1]).max() > 1e-3


def test_the_policy_of_the_wall_finds_the_board_by_the_rings() -> None:
    task = make_task("icra2026-peg-transfer")
    assert isinstance(task, WallTransfer)
    for seed in range(5):
        task.reset(seed)
        found = inverse(task.object_pose("board")) @ task.T_board
        assert np.linalg.norm(found[:2, 3]) < 1.5e-3


def test_a_hand_that_turns_on_and_on_turns_back_before_the_limit_of_its_roll(task: Task) -> None:
    task.reset(0)
    hand = Hand(task, "PSM1")
    for k in range(6):
        angle = np.radians(80.0 * k)
        for part in hand.over(np.array([0.03, 0.0, 0.03]), 0.0, angle):
            task.command(part)
        closing = task.world.arms["PSM1"].measured_cp("world").matrix[:3, 1]
        assert abs(closing[:2] @ [np.cos(angle), np.sin(angle)]) > np.cos(np.radians(2.0))
    assert task.controller.stalled == {"PSM1": 0.0}


def test_an_arm_that_stands_still_though_an_action_moves_it_stands_in_the_result(
    touch: Path,
) -> None:
    task = make_task(replace(load_scene(touch), time_limit=1.0))
    found = run_episode(task, 0, lambda _: np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.0]))
    assert found.reason.startswith("time; PSM1 stands still, ")
    assert 0.01 < found.stalled_s["PSM1"] < 0.9
    assert found.distance_m["PSM1"] > 0.06  # the pitch slows it before
    assert task.state()["stalled"]["PSM1"] in found.reason


def test_an_object_that_no_jaw_can_hold_is_one_error(touch: Path) -> None:
    scene = load_scene(touch)
    task = make_task(replace(scene, task="retrieve", goals=scene.goals[:1]))
    with pytest.raises(InputError, match=r"cube is 14.0 mm wide .* allowed: up to .* of PSM1"):
        run_episode(task, 0)


def test_what_the_jaw_missed_stands_in_the_result() -> None:
    task = make_task(replace(load_scene("gauze-retrieve"), time_limit=7.0))
    task.reset(0)
    beside = task.object_pose("gauze")[:3, 3] + [0.0, 0.03, 0.0]
    for action in together(
        task, PSM1=Hand(task, "PSM1").take("gauze", lambda: (beside, 0.0), 0.02)
    ):
        task.command(action)
    while not task.done:
        task.command(task.stay())
    missed = "PSM1 missed gauze 3 times, which rolled or slid by 0.0 mm"
    assert task.result(0).reason == f"time; {missed}"


def test_a_policy_that_takes_too_long_is_one_error(
    task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules[run_episode.__module__], "PATIENCE_S", 0.01)

    def slow(_: dict[str, Any]) -> np.ndarray:
        time.sleep(0.02)
        return np.zeros(7)

    with pytest.raises(InputError, match=r"the policy took .* s for an action; allowed"):
        run_episode(task, 0, slow)


def test_net_forces_of_contacts_are_those_of_the_contact_table(task: Task) -> None:
    task.reset(0)
    for _ in range(60):
        task.command([0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 0.0])  # onto the table
    table, total = task.world.contact_table(), np.zeros(3)
    for (one, two), force in zip(table.bodies, table.forces, strict=True):
        total += force * (table.names[one].startswith("PSM1/"))
        total -= force * (table.names[two].startswith("PSM1/"))
    found = task.world.contact_forces()
    # the table works out what sleeps by a step of its own
    assert found["PSM1"] == pytest.approx(total, rel=1e-4) and total[2] > 1.0
    assert not found["PSM2"].any()


def test_a_dropped_object_is_counted_once() -> None:
    task = make_task("gauze-retrieve")
    task.reset(0)
    for action in task.policy():
        task.command(action)
        if task.object_pose("gauze")[2, 3] > 0.02:
            break
    open_jaw = np.append(np.zeros(6), 0.9)
    for _ in range(30):
        task.command(open_jaw)
    assert (task.referee.drops, task.done) == (1, False)
    assert task.object_pose("gauze")[2, 3] < 0.01


def test_the_endoscope_loses_an_active_target_that_it_does_not_follow() -> None:
    task = make_task(replace(load_scene("active-track"), time_limit=4.0))
    found = run_episode(task, 0, lambda _: np.zeros(4))
    assert (found.success, found.reason) == (False, "time")


def test_the_tip_follows_the_velocity_of_an_action(task: Task) -> None:
    task.reset(0)
    start = task.world.arms["PSM1"].measured_cp("world").matrix
    for _ in range(50):
        task.command([0.02, -0.01, 0.005, 0.0, 0.0, 0.3, 0.5])
    for _ in range(10):
        task.command([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5])
    end = task.world.arms["PSM1"].measured_cp("world").matrix
    assert end[:3, 3] - start[:3, 3] == pytest.approx([0.02, -0.01, 0.005], abs=5e-4)
    turn = end[:3, :3] @ start[:3, :3].T
    assert np.arctan2(turn[1, 0], turn[0, 0]) == pytest.approx(0.3, abs=0.01)


def test_the_largest_actions_keep_an_arm_out_of_fault(task: Task) -> None:
    task.reset(0)
    down = [0.0, 0.0, -1e3, 0.0, 0.0, 0.0, -1e3]  # onto the table
    rng = np.random.default_rng(0)
    for k in range(100):
        if task.done:
            break
        task.command(down if k < 50 else rng.choice([-1e3, 1e3], 7))
    assert task.world.arms["PSM1"].operating_state().state == "ENABLED"
    assert task.referee.force["PSM1"] > 1.0


@pytest.mark.parametrize("action", [[0.0] * 6, [np.nan] * 7, [[0.0] * 7], ["a"] * 7, None, np.inf])
def test_bad_actions_are_rejected_and_nothing_moves(task: Task, action: Any) -> None:
    task.reset(0)
    with pytest.raises(InputError, match="allowed: 7 finite numbers"):
        task.command(action)
    assert task.world.time == 0.0


def test_a_policy_that_returns_nan_ends_with_an_error(task: Task) -> None:
    with pytest.raises(InputError, match="allowed: 7 finite numbers"):
        run_episode(task, 0, lambda _: np.full(7, np.nan))


def test_a_policy_of_ones_own_sees_observations(touch: Path) -> None:
    shapes: list[tuple[int, ...]] = []

    def still(seen: dict[str, Any]) -> np.ndarray:
        shapes.append(tuple(len(seen[name]) for name in ("PSM1", "cube", "goals", "time")))
        return np.zeros(7)

    found = run_episode(make_task(replace(load_scene(touch), time_limit=0.1)), 0, still)
    assert set(shapes) == {(8, 7, 2, 1)}
    assert (found.success, found.reason, found.time_s) == (False, "time", pytest.approx(0.1))


def test_an_object_that_leaves_the_table_ends_the_episode(task: Task) -> None:
    task.reset(0)
    task.world.objects["cube"].set_cp(transform(np.eye(3), [0.3, 0.0, 0.0]))
    for _ in range(50):
        if task.done:
            break
        task.command(np.zeros(7))
    assert task.reason == "cube: out of play"
    assert task.referee.drops == 1


@pytest.mark.parametrize(
    ("line", "put", "message"),
    [
        ("xyz_mm = [30, -10, 7.01]", "xyz_mm = [300, -10, 7.01]", r"cube at .* is out of reach"),
        ('object = "cube"\nspr', 'object = "cone"\nspr', r"place\[0\].object: got 'cone'"),
        ("schema = 1", "schema = 1\nspeed = 3", "speed"),
        ("time_limit_s = 10", "time_limit_s = 0", "time_limit: got 0; allowed: above 0"),
        ('task = "touch.py"', 'task = "tuch"', "unknown task 'tuch'"),
        ('arms = ["PSM1"]', 'arms = ["PSM7"]', "allowed: some of PSM1, PSM2, ECM"),
        ("schema = 1", 'schema = 1\nwithout = ["ECM"]', r"nothing stands on \(PSM2\)"),
        ("schema = 1", 'schema = 1\nhidden = ["table"]', r"hidden: got \['table'\]; allowed"),
        ("schema = 1", 'schema = 1\ncamera = "hd"', "unknown camera preset 'hd'"),
        (
            'object = "cube"\nat',
            'object = "cube"\nstage = 0.5\nat',
            "stage: got 0.5; allowed: 0, 1",
        ),
        ('name = "cube"\nmov', 'name = "table"\nmov', "table, which the rig has already"),
        ("at_mm = [30, -30, 30]", "at_mm = [300, -30, 30]", r"PSM1 at .* is out of reach"),
    ],
)
def test_a_broken_scene_is_one_error(touch: Path, line: str, put: str, message: str) -> None:
    text = touch.read_text(encoding="utf-8")
    assert line in text
    touch.write_text(text.replace(line, put), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        make_task(str(touch))


def test_objects_that_cannot_lie_apart_are_rejected_by_name(touch: Path) -> None:
    scene = load_scene(touch)
    row = replace(scene.placements[0], radius=0.5)
    other = replace(row, object="cube")
    crowded = replace(scene, placements=(row, other))
    with pytest.raises(InputError, match="no free place for cube after 100 draws"):
        crowded.placed(np.random.default_rng(0))


def test_an_unknown_scene_is_an_error_with_the_nearest_name() -> None:
    with pytest.raises(UnknownNameError, match=r"did you mean 'peg-board'\?"):
        load_scene("peg-bord")


def test_every_name_of_a_class_of_tasks_leads_to_that_class() -> None:
    scene = load_scene("peg-board")
    for name in task_names():
        found = task_class(replace(scene, task=name))
        assert found.task == name and found.__module__ == task_names()[name]
    assert {load_scene(name).task for name in names("scenes")} < set(task_names())


def test_a_task_steps_as_environments_of_gymnasium_do(touch: Path) -> None:
    task = make_task(replace(load_scene(touch), time_limit=0.1))
    seen, reward, terminated, truncated, info = task.step(task.stay())
    assert seen["time"] == pytest.approx([0.02])
    assert (reward, terminated, truncated, info["done"]) == (0.0, False, False, False)
    endings: list[tuple[bool, bool]] = []
    while not task.done:
        endings.append(task.step(task.stay())[2:4])
    assert endings == [(False, False)] * 3 + [(False, True)]
    task.reset(0)
    task.world.objects["cube"].set_cp(transform(np.eye(3), [0.3, 0.0, -1.0]))
    assert task.step(task.stay())[2:4] == (True, False)
    assert task.result(0).ending is Ending.FAILURE


def test_a_class_may_replace_the_reward(touch: Path) -> None:
    class Shaped(Task):
        def reward(self) -> float:
            return 7.0

    task = Shaped(replace(load_scene(touch), task="task"))
    assert task.command(task.stay()) == 7.0


def test_a_class_that_is_no_task_is_rejected(touch: Path) -> None:
    (touch.parent / "touch.py").write_text("SceneTask = dict\n", encoding="utf-8")
    with pytest.raises(InputError, match="allowed: a class that extends Task"):
        make_task(str(touch))
    (touch.parent / "touch.py").write_text("other = 1\n", encoding="utf-8")
    with pytest.raises(DescriptionError, match="allowed: with SceneTask"):
        make_task(str(touch))


#: These render the endoscope's images.
SEEN = ("augmented-reality", "needle-tracking", "visual-servoing")


def test_an_observation_is_of_now_whoever_moved_something_since_the_last_look() -> None:
    task = make_task("needle-pick")
    world = task.world

    def seen_now() -> dict[str, Any]:
        found = task.observation()
        tip = world.arms["PSM1"].measured_cp("world").matrix[:3, 3]
        np.testing.assert_array_equal(found["PSM1"][:3], tip)
        np.testing.assert_array_equal(found["needle"][:3], task.object_pose("needle")[:3, 3])
        return found

    first = seen_now()
    at = task.object_pose("needle")
    at[0, 3] += 0.01
    world.objects["needle"].set_cp(at)  # nobody steps
    assert seen_now()["needle"][0] == pytest.approx(first["needle"][0] + 0.01, abs=1e-9)
    task.command(task.stay())
    first = seen_now()
    world.arms["PSM1"].move_jp(world.arms["PSM1"].joints.setpoints()[:6] + 0.05)
    world.step(100)  # somebody else steps
    assert np.abs(seen_now()["PSM1"] - first["PSM1"]).max() > 1e-3


def test_a_pose_out_of_reach_is_refused_anew_where_anything_differs() -> None:
    task = make_task("needle-pick")
    controller, T = task.controller, task.controller.target("PSM1")
    far = T.copy()
    far[0, 3] += 0.5
    refused = [controller.farthest("PSM1", far) for _ in range(3)]
    assert refused == [np.inf] * 3
    assert controller.farthest("PSM1", T) < 1e-9
    far[0, 3] -= 0.499
    assert controller.farthest("PSM1", far) < 0.1
    # pushing against a limit gives the same reason as long as it lasts
    push = np.zeros(7)
    push[2] = 0.2
    reasons: list[str] = []
    for _ in range(150):
        task.command(push)
        reasons.append(controller.stalls()["PSM1"])
    assert "out of reach" in reasons[-1]
    assert reasons[-1] == reasons[-5]


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SEEN)) for n in names("scenes")]
)
def test_scenes_begin_at_rest_with_nothing_done(name: str) -> None:
    task = make_task(name)
    most = 5e-3 if name == "thread-knot" else 1e-3  # a laid knot is springy
    for seed in range(3):
        task.reset(seed)
        before = task.observation()
        # The balls begin on the tray, where they are to stay.
        assert task.state()["met"] == (3 if name == "dynamic-tray" else 0)
        for _ in range(5):
            task.command(task.stay())
        after = task.observation()
        for goal, _ in task.goals:
            if goal.object:
                assert np.abs(after[goal.object][:3] - before[goal.object][:3]).max() < most


def test_both_instruments_of_the_training_rig_reach_the_whole_board() -> None:
    world = World(load_rig("training"))
    for name in ("PSM1", "PSM2"):
        arm, own = world.arms[name], inverse(world.reference_pose(name))
        for x in np.linspace(-0.06, 0.06, 5):
            for y in np.linspace(-0.05, 0.05, 5):
                for z in (0.01, 0.045):
                    at = transform(np.diag([1.0, -1.0, -1.0]), [x, y, z])
                    arm.local.inverse_kinematics(own @ at, arm.setpoint_jp())


def test_the_pose_training_of_the_cart_does_the_same_on_its_table() -> None:
    world = World(load_rig("full_cart"))
    world.reset(pose="training")
    middle = transform(np.diag([-1.0, -1.0, 1.0]), [0.06, 1.0, 0.8])
    parked = world.arms["PSM1"].joints.setpoints()
    parked[2] = 0.05
    for name, other in (("PSM1", "PSM2"), ("PSM2", "PSM1")):
        own = inverse(world.reference_pose(name)) @ middle
        world.set_state(other, parked)
        for x in np.linspace(-0.06, 0.06, 4):
            for y in np.linspace(-0.05, 0.05, 4):
                at = own @ transform(np.diag([1.0, -1.0, -1.0]), [x, y, 0.012])
                q = world.arms[name].local.inverse_kinematics(at, parked[:-1])
                world.set_state(name, np.append(q, 0.3))
                assert len(world.contact_table().depths) == 0
    camera = world.camera("endoscope")
    seen = inverse(camera.T_world_camera) @ middle
    assert np.abs(seen[:2, 3]).max() < 0.01 and seen[2, 3] > 0.1


def test_the_endoscope_of_the_training_rig_sees_the_whole_board() -> None:
    camera = World("training").camera("endoscope")
    half = np.tan(np.array(camera.calibration.eyes[0].fov) / 2.0)
    seen = inverse(camera.T_world_camera)
    for x in (-0.06, 0.06):
        for y in (-0.05, 0.05):
            p = seen @ [x, y, 0.0, 1.0]
            assert abs(p[0] / p[2]) < half[0] and abs(p[1] / p[2]) < half[1]
