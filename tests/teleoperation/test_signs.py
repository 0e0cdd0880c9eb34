"""What a hand does is what the tool does, as the surgeon sees both: six directions, six tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.teleoperation.console_rig import Bench, tip_in_image
from trocar.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix
from trocar.simulation import World
from trocar.teleoperation.slave import view_in_world

#: A surgeon's right, up and away in the frame of the stereo display (x left, y up, z away), and in
#: an image (x right, y down, z away).
DISPLAY = {"right": (-1, 0, 0), "up": (0, 1, 0), "away": (0, 0, 1)}
IMAGE = {"right": (1, 0, 0), "up": (0, -1, 0), "away": (0, 0, 1)}
#: Both hands' ways: together, or as on a steering wheel that is turned clockwise.
BOTH = {where: (np.array(way), np.array(way)) for where, way in DISPLAY.items()}
BOTH["clockwise"] = np.array([0, 1, 0]), np.array([0, -1, 0])


@pytest.fixture(scope="module")
def bench() -> Bench:
    bench = Bench(pose="work")
    bench.enable()
    return bench


@pytest.mark.parametrize("rig", ["two_psm_ecm", "full_cart_mtm"])
def test_the_tip_of_the_endoscope_has_the_axes_of_the_stereo_display(rig: str) -> None:
    world = World(rig)
    tip = world.reference_pose("ECM") @ world.arm("ECM").local.measured_cp().matrix
    for where, way in DISPLAY.items():
        seen = world.cameras()["endoscope"].T_world_camera[:3, :3] @ IMAGE[where]
        np.testing.assert_allclose(tip[:3, :3] @ way, seen, atol=1e-9)
    np.testing.assert_allclose(view_in_world(world)[:3, :3], tip[:3, :3], atol=1e-9)
    blind = World(replace(world.rig, cameras=()))
    np.testing.assert_allclose(view_in_world(blind)[:3, :3], tip[:3, :3], atol=1e-9)


@pytest.mark.parametrize("where", DISPLAY)
def test_a_hand_that_moves_moves_the_tool_likewise_in_the_image(bench: Bench, where: str) -> None:
    before = tip_in_image(bench.world, "PSM1")
    hand = bench.world.arm("MTMR").measured_cp().matrix
    goal = hand.copy()
    goal[:3, 3] += 0.02 * np.array(DISPLAY[where])
    bench.carry("MTMR", goal)
    bench.run(0.2)
    moved = bench.world.arm("MTMR").measured_cp().matrix[:3, 3] - hand[:3, 3]
    tool = tip_in_image(bench.world, "PSM1")[:3, 3] - before[:3, 3]
    assert tool @ IMAGE[where] > 0.003
    assert tool @ IMAGE[where] == pytest.approx(0.2 * moved @ DISPLAY[where], abs=2e-5)
    bench.carry("MTMR", hand)


@pytest.mark.parametrize("where", DISPLAY)
def test_a_hand_that_turns_turns_the_tool_likewise_in_the_image(bench: Bench, where: str) -> None:
    before = tip_in_image(bench.world, "PSM1")
    hand = bench.world.arm("MTMR").measured_cp().matrix
    goal = hand.copy()
    goal[:3, :3] = matrix_from_rotation_vector(0.2 * np.array(DISPLAY[where])) @ hand[:3, :3]
    bench.carry("MTMR", goal)
    bench.run(0.2)
    now, after = bench.world.arm("MTMR").measured_cp().matrix, tip_in_image(bench.world, "PSM1")
    hand_turned = rotation_vector_from_matrix(now[:3, :3] @ hand[:3, :3].T)
    tool_turned = rotation_vector_from_matrix(after[:3, :3] @ before[:3, :3].T)
    assert tool_turned @ IMAGE[where] > 0.1
    for way in DISPLAY:
        same = pytest.approx(hand_turned @ DISPLAY[way], abs=1e-3)
        assert tool_turned @ IMAGE[way] == same
    bench.carry("MTMR", hand)


@pytest.mark.parametrize(("where", "roll"), [*((where, 0.6) for where in BOTH), ("right", 0.0)])
def test_both_hands_drag_what_the_endoscope_sees(where: str, roll: float) -> None:
    bench = Bench(pose="work")
    world = bench.world
    q = world.arm("ECM").joints.setpoints()
    q[3] = roll
    world.set_state("ECM", q)
    bench.enable("MTML_MTMR_ECM", hand=False, wait=0.05)
    camera = world.cameras()["endoscope"].T_world_camera
    point = camera @ [0.0, 0.0, 0.1, 1.0]
    hands = {name: world.arm(name).measured_cp().matrix for name in ("MTML", "MTMR")}
    for k in range(1, 151):
        for (name, T), way in zip(hands.items(), BOTH[where], strict=True):
            goal = T.copy()
            goal[:3, 3] += 0.03 * k / 150 * way
            world.arm(name).servo_cp(goal)
        bench.loop.tick()
    bench.run(0.15)
    back = np.linalg.inv(world.cameras()["endoscope"].T_world_camera)
    if where == "clockwise":
        assert rotation_vector_from_matrix(back[:3, :3] @ camera[:3, :3])[2] > 0.1
        return
    moved = (back @ point)[:3] - [0.0, 0.0, 0.1]
    assert moved @ IMAGE[where] > 0.003
    if where != "away":
        assert moved @ IMAGE[where] > 0.9 * np.linalg.norm(moved)
