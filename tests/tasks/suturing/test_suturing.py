"""Suturing: plans, scores, the scene's variants, and a whole stitch."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.suturing_scenes import suturing_scene
from trocar.cli import main
from trocar.descriptions.needles import needle_sizes
from trocar.errors import InputError, UnknownNameError, UnreachableError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import transform
from trocar.simulation.journal import Entry
from trocar.tasks import run_episode, scene_with
from trocar.tasks.scenes.suturing import Suturing
from trocar.tasks.suturing.planning import (
    APART_M,
    STEP,
    Grip,
    Plan,
    TipWorkspace,
    circle_height,
    clearance,
    load_plan,
    make_plan,
    needle_on_circle,
    wound_frame,
)
from trocar.tasks.suturing.scores import pose_score, score_pass


@pytest.fixture(scope="module")
def task() -> Suturing:
    """The scene with one stitch."""
    return Suturing(suturing_scene())


def plan_at(task: Suturing, yaw_deg: float, place: float = 0.0) -> Plan:
    """Return a plan of a stitch across a wound that is turned by an angle."""
    wound = transform(rotation_z(np.radians(yaw_deg)), [0.0, 0.0, 0.01])
    needle = task.object_pose("needle")
    return make_plan(task.world, task.tissue.tissue, wound, [place], needle)


def test_the_tip_of_a_needle_on_a_stitchs_circle_goes_through_entry_and_exit(
    task: Suturing,
) -> None:
    plan = plan_at(task, 15.0)
    (stitch,) = plan.stitches
    needle, wound = plan.needle, stitch.wound
    for angle, point in (
        (stitch.surface, stitch.points[0]),
        (np.pi - stitch.surface, stitch.points[3]),
    ):
        T = needle_on_circle(wound, 0.0, stitch.height, stitch.side, angle - needle.arc)
        tip = T @ [*needle.tip[:3, 3], 1.0]
        assert tip[:3] == pytest.approx((wound @ [*point, 1.0])[:3], abs=1e-9)
        assert stitch.angle_of(needle, T) == pytest.approx(angle)


def test_jaws_close_across_the_wire_and_lie_along_the_needles_axis() -> None:
    needle = needle_sizes()["half_26"]
    T = Grip(1.0, -1, 1).pose(needle)
    wire = needle.pose(1.0)
    assert T[:3, 2] == pytest.approx(-wire[:3, 2])
    assert abs(T[:3, 1] @ wire[:3, 0]) == pytest.approx(1.0)
    assert (T @ [0.0, 0.0, 0.0085, 1.0])[:3] == pytest.approx(wire[:3, 3])


@pytest.mark.parametrize(
    ("yaw", "least"), [(-45, 4.0), (-30, 9.0), (0, 13.0), (30, 9.0), (45, 4.0)]
)
def test_wounds_up_to_45_deg_are_planned_with_room_in_every_joint(
    task: Suturing, yaw: float, least: float
) -> None:
    task.reset(0)
    (stitch,) = plan_at(task, yaw).stitches
    assert np.degrees(min(stitch.margins)) > least


@pytest.mark.parametrize("size", ["half_17", "half_26", "half_36", "three_eighths_24"])
def test_both_jaws_hold_any_needle_clear_of_the_surface(task: Suturing, size: str) -> None:
    needle = needle_sizes()[size]
    tissue, wound = replace(task.tissue.tissue, wire=needle), transform(np.eye(3), [0, 0, 0.01])
    pose = task.object_pose("needle")
    (stitch,) = make_plan(task.world, tissue, wound, [0.0], pose).stitches
    handed = stitch.needle_pose(needle, stitch.out)
    heights = [(handed @ needle.pose(grip.angle))[2, 3] - wound[2, 3] for grip in stitch.grips]
    assert min(heights) > 2.4e-3
    assert heights[0] == pytest.approx(heights[1])
    assert 3.5e-3 < abs(stitch.points[0, 1]) < 0.4 * tissue.width


@pytest.mark.parametrize("yaw", [-20, 0, 20])
def test_an_si_takes_the_needle_with_the_grip_that_leaves_its_roll_room_for_the_pull(
    yaw: float,
) -> None:
    """Half a turn of the roll away, the wrist has as much room, and the roll none."""
    task = Suturing(scene_with("suturing", {"generation": "Si"}))
    task.reset(0)
    (stitch,) = plan_at(task, yaw).stitches
    tissue, taker = task.tissue.tissue, TipWorkspace(task.world, stitch.taker)

    def room(grip: Grip) -> tuple[float, float]:
        held = grip.pose(tissue.wire)
        angles = np.arange(stitch.out, stitch.end, STEP)
        poses = [stitch.needle_pose(tissue.wire, angle) @ held for angle in angles]
        way = taker.along(poses)
        assert way is not None
        last = taker.through(way[2], poses[1:])[2]
        pull = next(stitch.pulls(taker, tissue, poses[-1], held))
        return way[0], taker.through(last, pull.poses())[0]

    grip = stitch.grips[1]
    chosen, other = room(grip), room(replace(grip, across=-grip.across))
    assert other[0] == pytest.approx(chosen[0])
    assert other[1] == -np.inf
    assert np.degrees(chosen[1]) > 5.0


def test_a_way_past_the_end_of_the_roll_is_none_though_a_turn_back_has_room(
    task: Suturing,
) -> None:
    taker = TipWorkspace(task.world, "PSM2")
    q = np.array([0.0, 0.0, 0.12, np.radians(250.0), 0.3, 0.0])
    for step, reached in ((4.0, False), (-4.0, True)):  # the stop is at 260 deg
        rolls = np.radians(step * np.arange(1, 5))
        poses = [taker.pose(q + roll * np.eye(6)[3]) for roll in rolls]
        assert len(taker.all(poses[-1])) > 0
        assert np.isfinite(taker.through(q, poses)[0]) == reached


def test_a_wound_across_the_line_between_the_ports_is_refused_with_the_reason(
    task: Suturing,
) -> None:
    with pytest.raises(UnreachableError, match=r"wound at 90 deg.*PSM\d's \w+ would be"):
        plan_at(task, 90.0)


def test_a_stitch_that_the_endoscope_does_not_see_is_refused(task: Suturing) -> None:
    wound, needle = transform(np.eye(3), [0.08, 0.03, 0.01]), task.object_pose("needle")
    with pytest.raises(UnreachableError, match=r"endoscope's left eye does not see all of it: got"):
        make_plan(task.world, task.tissue.tissue, wound, [0.0], needle)


def test_shafts_that_would_meet_are_near_and_those_of_plans_are_not(task: Suturing) -> None:
    plan = plan_at(task, 0.0)
    (stitch,) = plan.stitches
    reaches = {name: TipWorkspace(task.world, name) for name in ("PSM1", "PSM2")}
    assert clearance(stitch, plan.needle, reaches, []) > APART_M
    tip = stitch.needle_pose(plan.needle, stitch.start) @ stitch.grips[0].pose(plan.needle)
    scope = tip[:3, 3], tip[:3, 3] + [0.0, 0.0, 0.1]  # one that stands on the instrument's tip
    assert clearance(stitch, plan.needle, reaches, [scope]) < APART_M


def test_pictures_have_rings_about_planned_punctures_and_the_banner(task: Suturing) -> None:
    task.reset(1)
    task.make_plan()
    task.announce("stitch 1: approach")
    seen: list[str] = []

    def capture() -> NDArray[np.uint8]:
        seen.extend(one.name for one in task.world.snapshot(arms=False).drawings)
        return np.full((120, 160, 3), 90, np.uint8)

    image = task.picture(capture)
    assert {"plan_1_in", "plan_1_out"} <= set(seen)
    names = {one.name for one in task.world.snapshot(arms=False).drawings}
    assert not any(name.startswith("plan_") for name in names)
    assert (image[8:] == 90).all()
    assert image[:7].max() > 100 > 31 > image[:7].min()


def test_a_plan_comes_back_from_its_file(task: Suturing, tmp_path: Path) -> None:
    plan = plan_at(task, 10.0)
    plan.save(tmp_path / "plan.toml")
    back = load_plan(tmp_path / "plan.toml")
    assert back.document() == plan.document()
    plan.save(tmp_path / "plan.png")
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_the_frame_of_a_wound_is_that_of_its_points() -> None:
    rng = np.random.default_rng(0)
    T = transform(rotation_z(0.4), [0.01, 0.02, 0.03])
    line = np.zeros((20, 3))
    line[:, 0] = np.linspace(-0.01, 0.01, 20)
    found, length = wound_frame(line @ T[:3, :3].T + T[:3, 3] + 1e-5 * rng.normal(size=(20, 3)))
    assert found == pytest.approx(T, abs=2e-3)
    assert length == pytest.approx(0.02, abs=1e-4)
    with pytest.raises(InputError, match="allowed: 1 mm or more"):
        wound_frame(np.zeros((5, 3)))


def test_stitches_are_planned_where_the_wound_is_found(task: Suturing) -> None:
    task.reset(2)
    pose, rough = task.tissue.pose, []
    line = np.array([[x, 5e-4, 0.0] for x in np.linspace(-0.01, 0.01, 9)])

    def find(guess: NDArray[np.float64]) -> NDArray[np.float64]:
        rough.append((guess - pose[:3, 3]) @ pose[:3, :3])
        return line @ pose[:3, :3].T + pose[:3, 3]

    task.find_wound = find
    try:
        task.make_plan()
    finally:
        task.find_wound = None
    assert rough[0][[0, -1]] == pytest.approx(
        np.array([[-0.0126, 0.0, 0.0], [0.0126, 0.0, 0.0]]), abs=4.0 * task.noise.wound
    )
    assert task.tissue.plan[0].mean(axis=0)[:2] == pytest.approx([0.0, 5e-4], abs=1e-9)


def test_needles_that_do_not_fit_are_refused() -> None:
    scene = suturing_scene(needle="17mm-half")
    tissue = next(prop.tissue for prop in scene.rig.props if prop.tissue is not None)
    circle_height(tissue)
    with pytest.raises(InputError, match="mm deep; allowed"):
        circle_height(replace(tissue, wire=replace(tissue.wire, radius=0.02)))
    with pytest.raises(InputError, match="needed"):
        circle_height(replace(tissue, wire=replace(tissue.wire, radius=0.004)))
    with pytest.raises(InputError, match="for the jaws"):
        circle_height(replace(tissue, wire=replace(tissue.wire, wire=0.0025)))


def test_scenes_have_the_stitches_needles_and_tissues_that_are_asked_for() -> None:
    scene = suturing_scene(4, "36mm-half", "skin")
    props = {prop.name: prop for prop in scene.rig.props}
    needle, tissue = props["needle"].needle, props["pad"].tissue
    assert needle is not None
    assert tissue is not None
    assert needle.length == pytest.approx(0.036)
    assert (tissue.stitches, tissue.wire, tissue.puncture) == (4, needle, 1.0)
    for bad, kind in (({"stitches": 0}, InputError), ({"needle": "9mm"}, UnknownNameError)):
        with pytest.raises(kind, match=r"9mm|stitches"):
            suturing_scene(**bad)  # type: ignore[arg-type]


def test_a_set_number_of_stitches_has_the_thread_and_the_time_of_the_scene_with_as_many() -> None:
    found, made = scene_with("suturing", {"tissue.stitches": 4}), suturing_scene(4)
    tissues = [next(p.tissue for p in one.rig.props if p.tissue) for one in (found, made)]
    assert tissues[0].stitches == tissues[1].stitches == 4
    assert tissues[0].thread.length == pytest.approx(tissues[1].thread.length)
    assert found.time_limit == made.time_limit == 195.0
    kept = scene_with("suturing", {"pad.stitches": 4, "time_limit_s": 70.0})
    assert kept.time_limit == 70.0


def test_options_of_suturing_are_refused_where_they_do_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["play", "suturing", "--headless", "--plan", "plan.txt"]) == 2
    assert "allowed: a file that ends in .toml or .png" in capsys.readouterr().err
    assert main(["play", "suturing", "--register", "image"]) == 2
    assert "--register image: allowed with --headless only" in capsys.readouterr().err
    assert main(["play", "peg-transfer", "--headless", "--register", "image"]) == 2
    assert "got the scene peg-transfer; allowed: suturing" in capsys.readouterr().err


def test_the_challenges_score_of_a_pose_sums_base_middle_and_tip() -> None:
    needle = needle_sizes()["half_26"]
    assert pose_score(needle, transform(np.eye(3), [0.0, 0.0, 1e-3]), np.eye(4)) == pytest.approx(
        3e-3
    )


def test_the_challenges_pass_is_the_last_crossing_of_entry_then_exit() -> None:
    entry, out = np.eye(4), transform(np.eye(3), [0.01, 0.0, 0.0])
    angles = np.linspace(0.2, -1.2 * np.pi, 200)
    path = np.column_stack(
        [0.005 - 0.0051 * np.cos(angles), np.full(200, 3e-4), 0.0051 * np.sin(angles)]
    )
    made = score_pass(path, entry, out)
    assert made.complete
    assert made.entry_m == pytest.approx(np.hypot(1e-4, 3e-4), abs=2e-5)  # of one sample
    assert made.exit_m == pytest.approx(np.hypot(1e-4, 3e-4), abs=2e-5)
    assert made.axial_m == pytest.approx(0.0051 * np.sin(0.2 * np.pi))
    assert not score_pass(path[::-1], entry, out).complete
    assert not score_pass(path[:120], entry, out).complete  # it has not come out
    again = score_pass(
        np.concatenate([path, [[0.01, 4e-3, -1e-3], [0.01, 4e-3, 1e-3]]]), entry, out
    )
    assert again.exit_m == pytest.approx(4e-3)
    wide = path + np.array([0.0, 6e-3, 0.0])
    assert np.isnan(score_pass(wide, entry, out).entry_m)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 11])  # pads of two arms twisted the needle in the second
def test_a_whole_stitch_closes_the_wound(task: Suturing, seed: int) -> None:
    passed: list[object] = []

    def hear(entry: Entry) -> None:
        if entry.name == "channel":
            passed.append(entry.values["place"])

    stop = task.world.listen(hear)
    episode = run_episode(task, seed)
    stop()
    assert episode.success, episode.reason
    assert passed == ["entry", "inner_in", "inner_out", "exit"]
    score = task.watch.scores[0]
    assert max(score.entry_mm, score.exit_mm, score.depth_mm) < 0.6
    assert score.gap_mm < 0.3 < score.gap_before_mm
    assert score.tension_n <= 2.0
    assert score.slip_um < 10.0
    assert score.friction < 0.8
    assert score.excess_mm < 0.5
    json.dumps(episode.figures)


@pytest.mark.slow
@pytest.mark.parametrize(("needle", "tissue"), [("36mm-half", "skin"), ("24mm-3/8", "phantom")])
def test_a_tip_goes_in_where_it_dents_soft_tissue_at_a_slant(needle: str, tissue: str) -> None:
    """With the tissue at 0.54 of its stiffness; a tip that slides would enter 2 mm away."""
    task = Suturing(suturing_scene(1, needle, tissue))
    episode = run_episode(task, 4)
    assert episode.success, episode.reason
    assert task.watch.scores[0].entry_mm < 0.6
