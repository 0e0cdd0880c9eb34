"""Tips that follow goals of people."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.geometry.se3 import pose_difference, transform, translation
from trocar.live import Loop
from trocar.live.state import Elapsed
from trocar.live.tip_goals import (
    AHEAD_S,
    COAST,
    GAP_S,
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


class Mouse:
    """Moves the goal along x at a speed, 30 times a second, until it stops; watches the way."""

    def __init__(self, loop: Loop, goals: TipGoals, speed: float, stops_s: float) -> None:
        self.arm, self.goals = loop.world.arm("PSM1"), goals
        self.start, self.speed, self.stops_s = self.arm.setpoint_cp("world").matrix, speed, stops_s
        self.next_s = 0.0
        self.times: list[float] = []
        self.way: list[float] = []

    def ticked(self, elapsed: Elapsed) -> None:
        now = elapsed.simulated_s
        if self.next_s - 1e-9 <= now <= self.stops_s:
            self.next_s += 1 / 30
            self.goals.set("PSM1", translation([self.speed * now, 0.0, 0.0]) @ self.start)
        self.times.append(now)
        self.way.append(self.arm.setpoint_cp("world").matrix[0, 3] - self.start[0, 3])

    def patience(self) -> int:
        return 1

    def refused(self, command: object, reason: str) -> None:  # noqa: ARG002
        raise AssertionError(reason)


def test_set_points_keep_up_with_a_goal_that_moves_evenly() -> None:
    _, loop, goals = made()
    mouse = Mouse(loop, goals, 0.024, 2.0)
    loop.watch(mouse)
    loop.run(2.0)
    times, way = np.array(mouse.times), np.array(mouse.way)
    ahead = way - 0.024 * times
    late = times > 1.0
    # Goals come 33 ms apart; the set-point of a tick was computed a tick before.
    assert np.abs(ahead[late] - 0.024 * AHEAD_S).max() < 0.024 * PERIOD_S
    # The way has no corners: a step changes by less than a tenth from tick to tick.
    assert np.abs(np.diff(way[late], 2)).max() < 0.1 * 0.024 * PERIOD_S


def test_a_goal_that_stops_at_once_is_passed_by_no_more_than_it_coasts_and_then_kept() -> None:
    _, loop, goals = made()
    mouse = Mouse(loop, goals, 0.06, 0.4)
    loop.watch(mouse)
    loop.run(1.2)
    last = 0.06 * np.floor(0.4 * 30) / 30
    passed = max(mouse.way) - last
    assert 0.0 <= passed < 0.06 * (AHEAD_S + COAST / 30 + PERIOD_S)
    assert mouse.way[-1] == pytest.approx(last, abs=0.06 * PERIOD_S)
    assert goals.patience() > 1  # the way is over


def test_goals_far_apart_in_time_are_no_motion_and_are_not_passed() -> None:
    world, loop, goals = made()
    arm = world.arm("PSM1")
    start = arm.setpoint_cp("world").matrix
    for x in (0.004, 0.008):
        goals.set("PSM1", translation([x, 0.0, 0.0]) @ start)
        way = set_points(loop, GAP_S + 0.05)
        assert way[:, 0, 3].max() - start[0, 3] < x + 1e-6


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
