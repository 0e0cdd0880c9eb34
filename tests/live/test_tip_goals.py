"""Tips that follow goals of people."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.geometry.se3 import pose_difference, transform, translation
from trocar.live import Loop
from trocar.live.tip_goals import (
    LEAD_M,
    PERIOD_S,
    SPEED_M_S,
    TURN_RAD_S,
    TipGoals,
    step_towards,
)
from trocar.simulation import World


def made() -> tuple[World, Loop, TipGoals]:
    world = World("psm")
    loop = Loop(world, speed="max")
    goals = TipGoals(loop)
    loop.watch(goals)
    return world, loop, goals


def set_points(loop: Loop, seconds: float) -> np.ndarray:
    """Run, and return the tip's set-points after each tick, (n, 4, 4)."""
    arm = loop.world.arm("PSM1")
    found = [arm.setpoint_cp("world").matrix]

    class Path:
        def ticked(self, elapsed: object) -> None:  # noqa: ARG002
            found.append(arm.setpoint_cp("world").matrix)

        def patience(self) -> int:
            return 1

        def refused(self, command: object, reason: str) -> None:  # noqa: ARG002
            raise AssertionError(reason)

    stop = loop.watch(Path())
    loop.run(seconds)
    stop()
    return np.array(found)


def test_a_tip_goes_to_its_goal_no_faster_than_a_hand() -> None:
    world, loop, goals = made()
    start = world.arm("PSM1").setpoint_cp("world").matrix
    goal = translation([0.02, 0.01, -0.03]) @ start
    goals.set("PSM1", goal)
    way = set_points(loop, 0.6)
    steps = np.linalg.norm(np.diff(way[:, :3, 3], axis=0), axis=1)
    assert steps.max() <= 1.01 * SPEED_M_S * PERIOD_S
    metres, radians = pose_difference(way[-1], goal)
    assert metres < 1e-6 and radians < 1e-6
    assert goals.missed == {}


def test_a_goal_that_is_reached_leaves_the_arm_to_others() -> None:
    world, loop, goals = made()
    arm = world.arm("PSM1")
    goals.set("PSM1", translation([0.01, 0.0, 0.0]) @ arm.setpoint_cp("world").matrix)
    loop.run(0.5)
    q = arm.setpoint_jp() + np.array([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])
    arm.servo_jp(q)
    loop.run(0.1)
    assert arm.setpoint_jp() == pytest.approx(q)


def test_a_goal_out_of_reach_is_named_with_its_distance_and_joint() -> None:
    world, loop, goals = made()
    arm = world.arm("PSM1")
    goals.set("PSM1", translation([0.5, 0.0, 0.0]) @ arm.setpoint_cp("world").matrix)
    loop.run(7.0)
    assert "mm" in goals.missed["PSM1"] and "insertion" in goals.missed["PSM1"]
    assert world.snapshot().arms["PSM1"].state == "ENABLED"
    goals.set("PSM1", arm.setpoint_cp("world").matrix)
    loop.run(0.2)
    assert goals.missed == {}


def test_a_goal_below_the_table_holds_the_tip_and_faults_nothing() -> None:
    world, loop, goals = made()
    arm = world.arm("PSM1")
    start = arm.setpoint_cp("world").matrix
    goals.set("PSM1", translation([0.1, 0.0, -0.3]) @ start)
    loop.run(6.0)
    assert arm.measured_cp("world").matrix[2, 3] > 0.0  # the table's top is at 0
    assert world.snapshot().arms["PSM1"].state == "ENABLED"
    lead = arm.setpoint_cp("world").matrix[:3, 3] - arm.measured_cp("world").matrix[:3, 3]
    assert np.linalg.norm(lead) < LEAD_M + 0.005


def test_stopping_leaves_the_tip_where_it_is() -> None:
    world, loop, goals = made()
    arm = world.arm("PSM1")
    goals.set("PSM1", translation([0.05, 0.0, 0.0]) @ arm.setpoint_cp("world").matrix)
    loop.run(0.2)
    goals.stop("PSM1")
    loop.run(0.02)
    held = arm.setpoint_jp()
    loop.run(0.5)
    assert arm.setpoint_jp().tolist() == held.tolist()


def test_a_step_keeps_line_and_axis_and_ends_at_the_goal() -> None:
    rng = np.random.default_rng(3)
    from trocar.geometry.rotations import matrix_from_rotation_vector

    for _ in range(50):
        a, b = (
            transform(matrix_from_rotation_vector(rng.normal(size=3)), rng.normal(size=3))
            for _ in range(2)
        )
        step = step_towards(a, b, SPEED_M_S, TURN_RAD_S)
        metres, radians = pose_difference(a, step)
        assert metres <= SPEED_M_S + 1e-12 and radians <= TURN_RAD_S + 1e-9
        before, after = pose_difference(a, b), pose_difference(step, b)
        assert after[0] + metres == pytest.approx(before[0])
        assert after[1] + radians == pytest.approx(before[1])
        assert step_towards(a, b, 100.0, 100.0) is b
