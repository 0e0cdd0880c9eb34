"""A part that is added to a world: a suction cup that pulls what lies ahead of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.se3 import transform
from trocar.recording import record
from trocar.simulation import World
from trocar.simulation.journal import Entry, apply_command
from trocar.simulation.suction import Suction

#: Radius of the ball; the fingers of the large needle driver end a little before the opening [m].
RADIUS, AHEAD = 0.005, 0.0107
BALL = """
[[prop]]
name = "ball"
movable = true
mass_g = 5.0
xyz_m = [0.0, 0.0, 1.0]
shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 5 }]
"""


@pytest.fixture
def world(tmp_path: Path) -> World:
    file = tmp_path / "mine.toml"
    file.write_text(Path(load_rig("psm").file).read_text(encoding="utf-8") + BALL)
    return World(file)


def with_cup(world: World) -> Suction:
    """Give a world a cup, with the ball 0.3 mm ahead of its opening."""
    arm = world.arm("PSM1")
    arm.move_jp([0.0, 0.0, 0.12, 0.0, 0.0, 0.0]).wait()
    tip, cup = arm.measured_cp("world").matrix, Suction("PSM1", AHEAD)
    world.add("suction", cup)
    at = tip[:3, 3] + (AHEAD + RADIUS + 3e-4) * tip[:3, 2]
    world.object("ball").set_cp(transform(np.eye(3), at))
    return cup


def distance(world: World) -> float:
    """Give the distance from the tip to the ball's centre [m]."""
    ball, tip = (
        world.object("ball").measured_cp().matrix,
        world.arm("PSM1").measured_cp("world").matrix,
    )
    return float(np.linalg.norm(ball[:3, 3] - tip[:3, 3]))


def test_a_ball_is_carried_until_the_pump_stops(world: World) -> None:
    cup = with_cup(world)
    cup.start()
    world.arm("PSM1").move_jp([0.2, 0.1, 0.14, 0.0, 0.0, 0.0]).wait()
    assert cup.held == "ball" and distance(world) == pytest.approx(AHEAD + RADIUS, abs=4e-4)
    cup.stop()
    world.step(100)
    assert cup.held == "" and distance(world) > 0.05


def test_the_pull_on_the_ball_is_that_on_the_tip_and_no_more_than_the_pump_exerts(
    world: World,
) -> None:
    cup = with_cup(world)
    cup.start()
    applied = np.zeros((1, 3))
    for _ in range(50):
        world.step(1)
        applied = world.mj_data.xfrc_applied[:, :3]
        assert np.allclose(applied.sum(axis=0), 0.0, atol=1e-12)
        assert np.linalg.norm(applied, axis=1).max() <= cup.force + 1e-12
    assert np.linalg.norm(applied, axis=1).max() > 0.9 * cup.force


def test_motion_is_the_same_however_steps_are_grouped_and_from_a_saved_state(
    world: World, tmp_path: Path
) -> None:
    other = World(tmp_path / "mine.toml")
    with_cup(world).start()
    with_cup(other).start()
    world.step(60)
    saved = world.save()
    world.step(40)
    for run in (7, 13, 80):
        other.step(run)
    expected = world.save().row
    assert np.array_equal(other.save().row, expected)
    world.load(saved)
    world.step(40)
    assert np.array_equal(world.save().row, expected)


def test_a_force_of_somebody_else_stays(world: World) -> None:
    cup, ball = with_cup(world), world.object("ball")
    push = np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])
    ball.servo_cf(push)
    cup.start()
    world.step(20)
    body = world.mj_model.body("ball").id
    assert not np.array_equal(world.mj_data.xfrc_applied[body], push)
    cup.stop()
    assert np.array_equal(world.mj_data.xfrc_applied[body], push)
    cup.start()
    world.step(20)
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    cup.stop()
    body = world.mj_model.body("ball").id
    assert np.array_equal(world.mj_data.xfrc_applied[body], push)


def test_a_reset_stops_the_pump(world: World) -> None:
    cup = with_cup(world)
    cup.start()
    world.step(20)
    world.reset()
    world.step(1)
    assert cup.held == "" and not world.mj_data.xfrc_applied.any()
    assert "suction" in world.past.incomplete


def test_a_part_has_a_name_of_its_own_and_can_be_removed(world: World) -> None:
    remove = world.add("suction", Suction("PSM1"))
    for name in ("suction", "PSM1", "ball", "world", "grasps"):
        with pytest.raises(InputError, match=f"add: got '{name}'"):
            world.add(name, Suction("PSM1"))
    assert world.part(Suction) is world.parts["suction"]
    saved = world.save()
    remove()
    with pytest.raises(UnknownNameError, match="Suction"):
        world.part(Suction)
    with pytest.raises(InputError, match="load: got a state with suction"):
        world.load(saved)
    world.reset()
    assert not world.past.incomplete


def test_commands_of_a_part_move_a_twin_alike(world: World, tmp_path: Path) -> None:
    other = World(tmp_path / "mine.toml")
    cup, _ = with_cup(world), with_cup(other)

    def repeat(entry: Entry) -> None:
        if entry.kind == "command":
            apply_command(other, entry)

    world.listen(repeat)
    cup.start()
    for each in (world, other):
        each.step(50)
    assert cup.held == other.part(Suction).held == "ball"
    assert np.array_equal(world.save().row, other.save().row)


def test_no_part_is_added_to_a_world_that_is_recorded(world: World, tmp_path: Path) -> None:
    with (
        record(world, tmp_path / "run.mcap"),
        pytest.raises(InputError, match="while the world is recorded"),
    ):
        world.add("suction", Suction("PSM1"))
    assert "suction" not in world.parts


def test_a_cup_needs_an_arm_and_numbers(world: World) -> None:
    with pytest.raises(UnknownNameError, match="PSM9"):
        world.add("suction", Suction("PSM9"))
    assert "suction" not in world.parts
    with pytest.raises(InputError, match="Suction: got"):
        Suction("PSM1", radius_m=-1.0)
    with pytest.raises(InputError, match=r"Suction: gap_m: got 0.0; allowed: a finite number from"):
        Suction("PSM1", gap_m=0.0)
