"""How a tool follows its master: scale, clutch, locks, lag, alignment, and what goes wrong."""

from __future__ import annotations

from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.teleoperation.console_rig import TICK_S, Bench, tip_in_image
from trocar.descriptions.teleops import TeleopDescription
from trocar.geometry import angle_between
from trocar.geometry.rotations import rotation_z
from trocar.recording import record
from trocar.robot.follow import repeat
from trocar.simulation import World
from trocar.teleoperation.psm import HandDetector, JawFollower, PsmTeleoperation

SHIFT = np.array([0.02, -0.015, 0.01])


def measured_tip(world: World) -> np.ndarray:
    return world.arm("PSM1").local.measured_cp().matrix[:3, 3]


def shifted(T: np.ndarray, by: np.ndarray = SHIFT) -> np.ndarray:
    goal = T.copy()
    goal[:3, 3] += by
    return goal


def following(bench: Bench) -> Any:
    one = bench.engine.components["MTMR_PSM1"]
    assert isinstance(one, PsmTeleoperation)
    return one


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.enable()
    return bench


@pytest.mark.parametrize("scale", [0.2, 1.0 / 3.0])
def test_the_scale_is_exact(bench: Bench, scale: float) -> None:
    one = following(bench)
    one.set_scale(scale)
    hand = bench.world.arm("MTMR").measured_cp().matrix
    bench.carry("MTMR", shifted(bench.world.arm("MTMR").measured_cp().matrix))
    now = bench.world.arm("MTMR").measured_cp().matrix
    told = tip_in_image(bench.world, "PSM1")[:3, 3] * [-1, -1, 1]  # x left, y up
    way = now[:3, 3] - hand[:3, 3]
    assert np.linalg.norm(way) > 0.02
    goal = one.goal(now)[:3, 3]
    np.testing.assert_allclose(goal - one.goal(hand)[:3, 3], scale * way, atol=1e-9)
    np.testing.assert_allclose(told, goal, atol=1e-5)  # the endoscope breathes


def test_the_tip_does_not_jump_when_the_clutch_closes_or_opens() -> None:
    """With friction of hinges: stop elements give back up to 0.1 mm of the tip in this time."""
    bench = Bench(dynamics="cad")
    bench.enable()
    one, world = bench.engine.components["MTMR_PSM1"], bench.world
    bench.carry("MTMR", shifted(world.arm("MTMR").measured_cp().matrix))
    bench.run(0.5)
    before = measured_tip(world)
    bench.console.press_clutch(True)
    assert not one.following
    bench.carry("MTMR", shifted(world.arm("MTMR").measured_cp().matrix, -2.0 * SHIFT))
    bench.run(0.2)
    steps = [np.linalg.norm(measured_tip(world) - before)]
    bench.console.press_clutch(False)
    while not one.following:
        bench.loop.tick()
        assert world.time < 20.0
    for _ in range(100):
        bench.loop.tick()
        steps.append(np.linalg.norm(measured_tip(world) - before))
    assert max(steps) < 5e-5
    assert bench.states("MTMR_PSM1")[-3:] == ["SETTING_ARMS_STATE", "ALIGNING_MTM", "ENABLED"]


def test_the_tool_follows_within_ten_milliseconds(bench: Bench) -> None:
    """The lag that explains the measured tip best, of a hand that goes to and fro at 1 Hz."""
    world = bench.world
    master, tool = [], []
    start = world.arm("MTMR").measured_js().position
    turn = np.array([0.05, 0.06, 0.04, 0.0, 0.0, 0.0, 0.0])
    for k in range(1500):
        t = k * TICK_S
        bend = 1.0 - np.cos(2 * np.pi * t)
        world.arm("MTMR").servo_jp(start + turn * bend, turn * 2 * np.pi * np.sin(2 * np.pi * t))
        bench.loop.tick()
        master.append(world.arm("MTMR").measured_cp().matrix[:3, 3])
        tool.append(world.arm("PSM1").measured_cp().matrix[:3, 3])
    far = np.array(tool)[300:] - tool[300]
    one = following(bench)
    goal = one.goal(world.arm("MTMR").measured_cp().matrix)
    R = world.arm("PSM1").measured_cp().matrix[:3, :3] @ goal[:3, :3].T
    lags = []
    for begin in range(0, 1100, 100):
        window = slice(begin, begin + 100)

        def miss(lag: int, window: slice = window) -> float:
            hand = np.array(master)[300 - lag : 1500 - lag]
            goal = 0.2 * (hand - master[300 - lag]) @ R.T
            return float(np.abs(np.diff(far[window] - goal[window], axis=0)).sum())

        lags.append(min(range(40), key=miss))
    assert np.median(lags) * TICK_S <= 0.010, lags


def test_the_tool_follows_once_the_master_has_turned_all_the_way_in_one_move() -> None:
    """As sawIntuitiveResearchKit after 2.4.0; 2.4.0 itself begins within 5 degrees."""
    bench = Bench()
    world, one = bench.world, following(bench)
    moves: list[np.ndarray] = []
    world.listen(lambda e: moves.append(e.values["q"]) if e.name == "move_jp" else None)
    q = world.arm("MTMR").joints.setpoints()
    q[6] += 0.6
    world.set_state("MTMR", q)
    one.command("enable")
    bench.run(0.05)
    bench.pinch("MTMR")  # the hand is there at once
    commanded = np.zeros(7)
    while not one.following:
        assert world.time < 10.0
        commanded = world.arm("MTMR").joints.setpoints()[:7]
        bench.loop.tick()
    assert len(moves) == 1
    np.testing.assert_allclose(commanded, moves[0], atol=1e-5)  # its last tick
    assert np.degrees(angle_between(np.eye(3), one.offset)) < 2.0  # friction of the gimbal


@pytest.mark.parametrize(("gripper", "jaw"), [(40.0, 53.33), (10.0, 13.33), (50.0, 66.67)])
def test_the_widest_gripper_opens_the_jaw_to_its_limit(gripper: float, jaw: float) -> None:
    """As recorded of sawIntuitiveResearchKit 9e535e6 with a KINEMATIC PSM and a needle driver."""
    description = TeleopDescription("MTMR_PSM1", "psm", ("MTMR",), "PSM1")
    follower = JawFollower(description, radians(-40.0), radians(80.0), radians(20.0))
    for _ in range(5000):
        follower.follow(radians(gripper), 0.001)
    assert np.degrees(follower.jaw) == pytest.approx(jaw, abs=0.01)


def test_gripper_and_roll_together_show_a_hand_by_less_than_each_alone() -> None:
    for gripper, present in ((30.0, False), (33.0, True)):  # with 3: 0.8 of 40 + 4 is 35.2
        hand = HandDetector(radians(40.0), radians(4.0))
        hand.update(0.0, rotation_z(0.0))
        assert hand.update(radians(gripper), rotation_z(radians(3.0))) is present


@pytest.mark.slow
def test_alignment_is_reached_from_twenty_random_places() -> None:
    # without collisions, or the other master would be in the way
    bench = Bench(collisions=False, tick_s=0.005)
    world, one = bench.world, following(bench)
    arm, rng = world.arm("MTMR"), np.random.default_rng(7)
    places = arm.joints.lower + rng.uniform(0.1, 0.9, (60, 8)) * (
        arm.joints.upper - arm.joints.lower
    )
    for place in places[arm.description.mechanism.within(places)][:20]:
        q = arm.joints.setpoints()
        q[:7] = place[:7]
        world.set_state("MTMR", q)
        one.command("enable")
        bench.run(0.01)
        while angle_between(np.eye(3), one.offset) > one.description.orientation_tolerance:
            bench.run(0.1)
            assert world.time < 100.0, q
        assert one.current == "ALIGNING_MTM"  # until a hand is there
        one.command("disable")
        bench.run(0.01)
        assert one.current == "DISABLED"


def test_a_recording_of_teleoperation_repeats_to_the_last_bit(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    bench = Bench()
    with record(bench.world, tmp_path / "hands.mcap"):
        bench.enable()
        bench.carry("MTMR", shifted(bench.world.arm("MTMR").measured_cp().matrix), seconds=0.2)
        bench.console.press_clutch(True)
        bench.run(0.05)
    report = repeat(str(tmp_path / "hands.mcap"))
    assert report.identical, report
