from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import InputError, UnknownNameError
from trocar.geometry.rotations import rotation_vector_from_matrix
from trocar.learning.actions import KINDS, REACH_M, make_actions
from trocar.learning.observations import scene_centre
from trocar.learning.readings import read_task
from trocar.tasks import Task, make_task


def drive(
    task: Task, kind: str, action: np.ndarray, actions: int = 1, seconds: float = 0.2
) -> None:
    """Execute an action several times."""
    made = make_actions(kind, task, seconds)
    for _ in range(actions):
        for period in range(made.periods):
            row = made.velocities(made.check([action], 1), read_task(task), period)
            task.command(row[0])


def test_joint_velocities_move_the_set_points_of_joints() -> None:
    task = make_task("needle-reach")
    joints = task.world.arms["PSM1"].joints
    before = joints.setpoints()
    fastest = np.array([j.velocity_max for j in task.world.arms["PSM1"].description.joints[:-1]])
    action = np.array([0.1, -0.05, 0.2, 0.05, -0.04, 0.03, 0.0])
    drive(task, "joint", action)
    moved = joints.setpoints()[:6] - before[:6]
    assert moved == pytest.approx(0.2 * action[:6] * fastest, abs=1e-7)


def test_joints_stop_at_their_limits() -> None:
    task = make_task("needle-reach")
    joints = task.world.arms["PSM1"].joints
    drive(task, "joint", np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3, 0.0]), actions=8)
    assert joints.setpoints()[5] == pytest.approx(joints.upper[5], abs=1e-6)


def test_joints_slow_in_proportion_where_the_tip_would_be_too_fast() -> None:
    task = make_task("needle-reach")
    joints = task.world.arms["PSM1"].joints
    before = joints.setpoints()
    drive(task, "joint", np.array([0.0, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0]), seconds=0.02)
    moved = joints.setpoints()[:6] - before[:6]
    assert 0.0 < moved[3] < 0.02 * 18.8
    assert moved[4] == pytest.approx(moved[3] / 2.0, rel=0.05)  # the joint's path is bent


def test_a_tip_set_point_is_where_the_action_has_it() -> None:
    task = make_task("needle-reach")
    start = task.controller.target("PSM1")
    action = np.array([0.1, 0.05, 0.25, 0.0, 0.0, 0.1, -0.5])
    drive(task, "tip-setpoint", action, actions=4)
    T = task.controller.target("PSM1")
    assert T[:3, 3] == pytest.approx(scene_centre(task) + REACH_M * action[:3], abs=1e-9)
    turn = rotation_vector_from_matrix(T[:3, :3] @ start[:3, :3].T)
    assert turn == pytest.approx(np.pi * action[3:6], abs=1e-9)


def test_a_step_of_surrol_moves_the_tip_by_10_mm_and_30_degrees() -> None:
    task = make_task("needle-pick")
    before = task.controller.target("PSM1")
    drive(task, "surrol", np.array([1.0, -1.0, 0.0, 1.0, 1.0]))
    after = task.controller.target("PSM1")
    assert after[:3, 3] - before[:3, 3] == pytest.approx([0.01, -0.01, 0.0], abs=1e-9)
    turn = rotation_vector_from_matrix(after[:3, :3] @ before[:3, :3].T)
    assert np.degrees(turn) == pytest.approx([0.0, 0.0, 30.0], abs=1e-6)
    assert np.degrees(task.world.arms["PSM1"].joints.setpoints()[6]) == pytest.approx(40.0)


def test_the_jaw_rests_in_surrol_where_the_scene_asks_for_a_place_of_the_tip() -> None:
    task = make_task("needle-reach")
    before = task.world.arms["PSM1"].joints.setpoints()[6]
    drive(task, "surrol", np.array([0.0, 0.0, 0.0, 0.0, -1.0]))
    assert task.world.arms["PSM1"].joints.setpoints()[6] == before


def test_an_endoscope_moves_along_its_own_axes() -> None:
    task = make_task("ecm-reach")
    T = task.world.arms["ECM"].measured_cp("world").matrix
    drive(task, "surrol", np.array([0.0, 0.0, 0.5]))
    moved = task.world.arms["ECM"].measured_cp("world").matrix[:3, 3] - T[:3, 3]
    assert T[:3, :3].T @ moved == pytest.approx([0.0, 0.0, 0.005], abs=5e-4)  # it lags


def test_surrol_rolls_an_endoscope_by_3_degrees_in_a_step() -> None:
    task = make_task("misorient")
    before = task.world.arms["ECM"].joints.setpoints()
    drive(task, "surrol-roll", np.array([1.0]), seconds=0.1)
    moved = np.degrees(task.world.arms["ECM"].joints.setpoints() - before)
    assert moved == pytest.approx([0.0, 0.0, 0.0, 3.0], abs=1e-6)


def test_orbit_joints_are_offsets_from_the_start() -> None:
    task = make_task("needle-pick")
    start = task.world.arms["PSM1"].joints.setpoints()
    action = np.array([0.1, 0.1, -0.02, 0.2, 0.2, 0.1, 1.0])
    drive(task, "orbit-joint", action, actions=50, seconds=0.02)
    moved = task.world.arms["PSM1"].joints.setpoints() - start
    assert moved[:6] == pytest.approx(0.5 * action[:6], abs=1e-6)


@pytest.mark.parametrize(
    ("scene", "size"),
    [("needle-reach", 7), ("bi-peg-transfer", 14), ("ecm-reach", 4), ("augmented-reality", 11)],
)
def test_numbers_are_those_of_the_arms(scene: str, size: int) -> None:
    task = make_task(scene)
    for kind in ("tip", "tip-setpoint", "joint"):
        made = make_actions(kind, task, 0.1)
        assert len(made.names) == len(made.high) == size
        zero = made.check(np.zeros((1, size)), 1)
        assert made.velocities(zero, read_task(task), 0).shape == (1, len(task.limits[0]))


@pytest.mark.parametrize(
    ("kind", "size"), [("orbit-joint", 6), ("orbit-ik-abs", 7), ("orbit-ik-rel", 6)]
)
def test_reach_of_orbit_has_no_jaw(kind: str, size: int) -> None:
    assert len(make_actions(kind, make_task("needle-reach"), 0.02).names) == size
    assert len(make_actions(kind, make_task("needle-pick"), 0.02).names) == size + 1


@pytest.mark.parametrize(
    ("action", "says"),
    [
        (np.zeros((2, 6)), r"got the shape \(2, 6\); allowed: \(2, 7\)"),
        (np.zeros((2, 7), bool), "got bool as dtype"),
        ([["a"] * 7] * 2, "as dtype; allowed: float32 or float64"),
        ([[0.0] * 7, [0.0] * 3 + [np.nan] * 4], "world 1: got nan as PSM1.about_x"),
        ([[0.0], [0.0, 1.0]], "allowed: "),
    ],
)
def test_a_wrong_action_is_named(action: object, says: str) -> None:
    made = make_actions("tip", make_task("needle-reach"), 0.1)
    with pytest.raises(InputError, match=says):
        made.check(action, 2)  # pyright: ignore[reportArgumentType]  what the test is about


def test_unknown_kinds_and_periods_are_named() -> None:
    task = make_task("needle-reach")
    with pytest.raises(UnknownNameError, match="did you mean 'surrol'"):
        make_actions("surol", task, 0.1)
    with pytest.raises(InputError, match=r"action_period: got 0.05; allowed: 0.02, 0.1, 0.2"):
        make_actions("tip", task, 0.05)
    with pytest.raises(InputError, match="has no numbers for ECM; allowed: tip, "):
        make_actions("orbit-joint", make_task("ecm-reach"), 0.02)
    with pytest.raises(InputError, match="has no numbers for PSM1; allowed: tip, "):
        make_actions("surrol-roll", task, 0.1)
    assert set(KINDS) >= {"tip", "tip-setpoint", "joint", "surrol"}
