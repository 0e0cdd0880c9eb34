"""Brakes of an Si arm: they hold up to an effort, give way beyond, and open as it goes home."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import DescriptionError
from trocar.simulation import Batch, World

BRAKED = ("yaw", "pitch", "insertion")


def pushed(world: World, joint: str, effort: float, steps: int) -> float:
    """Return how far a force on a joint moves it [rad or m]."""
    name = next(iter(world.arms))
    row = world.joints.names.index(f"{name}/{joint}")
    before = world.servos.read()[0][row]
    world.mj_data.qfrc_applied[:] += effort * world.joints.rate[row]
    world.step(steps)
    world.mj_data.qfrc_applied[:] -= effort * world.joints.rate[row]
    return float(world.servos.read()[0][row] - before)


@pytest.mark.parametrize("rig", ["psm_si", "ecm_si"])
def test_an_arm_without_power_stays_under_its_weight(rig):
    world = World(rig, homed=False)
    (arm,) = world.arms.values()
    assert arm.joints.engaged_brakes == BRAKED
    before = arm.joints.positions()
    world.step(2000)
    # dry friction creeps: 0.1 mrad or mm an hour allowed here
    assert np.abs(arm.joints.positions() - before).max() < 2.0 * 1e-4 / 3600.0
    np.testing.assert_array_equal(world.servos.read()[2], 0.0)


@pytest.mark.parametrize("joint", BRAKED)
def test_a_brake_gives_way_beyond_its_effort(joint):
    own = next(j for j in load_arm("psm_si").joints if j.name == joint)
    for sign in (1.0, -1.0):
        world = World("psm_si", homed=False)
        weight = world.servos.holding[world.joints.names.index(f"PSM1/{joint}")]
        dry = load_arm("psm_si").friction["identified"][joint].coulomb
        slips = sign * (own.brake + dry) + weight
        assert abs(pushed(world, joint, slips - 0.2 * sign, 200)) < 5e-5  # belts yield
        assert sign * pushed(world, joint, slips + sign, 200) > 1e-4


def test_brakes_open_half_a_second_after_homing_began_and_close_at_a_fault():
    world = World("psm_si", homed=False)
    arm = world.arm("PSM1")
    arm.enable()
    world.step(700)
    assert arm.joints.engaged_brakes == BRAKED
    before = arm.joints.setpoints()
    motion = arm.home()
    world.step(499)
    assert arm.joints.engaged_brakes == BRAKED
    np.testing.assert_array_equal(arm.joints.setpoints(), before)
    world.step(3)
    assert arm.joints.engaged_brakes == ()
    assert motion.wait(10.0)
    arm.servo_jp([3.0, 0.5, 0.2, 0.0, 0.0, 0.0])  # a step beyond the tracking tolerance
    world.step(100)
    assert arm.operating_state().state == "FAULT"
    assert arm.joints.engaged_brakes == BRAKED


def test_a_homing_goes_on_from_a_state_saved_while_brakes_open():
    world = World("psm_si", homed=False)
    world.arm("PSM1").enable()
    world.arm("PSM1").home()
    world.step(200)
    state = world.save()
    world.arm("PSM1").joints.set_trajectory_ratio(0.5)
    world.load(state)
    world.step(299)
    assert world.arm("PSM1").joints.engaged_brakes == BRAKED
    world.step(3)
    assert world.arm("PSM1").joints.engaged_brakes == ()


def test_slower_moves_do_not_open_brakes_early():
    world = World("psm_si", homed=False)
    world.arm("PSM1").enable()
    world.arm("PSM1").home()
    world.step(200)
    world.arm("PSM1").joints.set_trajectory_ratio(0.5)
    world.step(299)
    assert world.arm("PSM1").joints.engaged_brakes == BRAKED


def test_a_batch_begins_with_brakes_as_its_world_has_them():
    world = World("psm_si", homed=False)
    batch = Batch(world, 2, threads=1)
    batch.step(np.tile(world.servos.setpoint[:, 0] + 0.05, (2, 1)), 50)
    world.step(50)
    np.testing.assert_allclose(batch.read().q[0], world.servos.read()[0], atol=1e-6)


def test_a_classic_arm_has_no_brakes_of_its_own():
    world = World("psm", homed=False)
    assert world.arm("PSM1").joints.engaged_brakes == ()
    assert abs(pushed(world, "yaw", 50.0, 100)) < 1e-9


def test_a_brake_without_an_effort_is_an_error(tmp_path):
    file = tmp_path / "arm.toml"
    text = Path(load_arm("psm_si").file).read_text(encoding="utf-8")
    file.write_text(text.replace("brake_nm = 11.4", "brake_nm = 0.0"), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"brake.*got 0.*allowed: above 0"):
        load_arm(file)
