"""A world of a batch is a World: the same motion to the last bit, the same readings."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import InputError, UnknownNameError
from trocar.simulation import Batch, World

N = 3
STEPS = 20


def swing(world: World, first: np.ndarray, k: int) -> np.ndarray:
    """Set-points (N, J) of a row of a sine, each world's with its own size; brakes hold."""
    table = world.joints
    slides = np.array([name.endswith("insertion") for name in table.names])
    size = np.where(table.braked, 0.0, np.where(slides, 0.004, 0.05))
    wave = np.sin(0.1 * k + np.arange(len(table)))
    return np.clip(first + np.arange(1, N + 1)[:, None] * size * wave, table.lower, table.upper)


def follow(world: World, q: np.ndarray) -> None:
    """Command a World's arms what a row of a batch follows."""
    for name, arm in world.arms.items():
        rows, own = world.joints.arms[name].rows, arm.description.own_joints
        if arm.description.type == "SUJ":
            continue
        arm.servo_jp(q[rows][:own])
        if arm.jaw is not None:
            arm.jaw.servo_jp(q[rows][own:])


@pytest.mark.parametrize(
    "rig", ["psm", "two_psm_ecm", "pegs", "full_cart", "psm_si", "full_cart_si"]
)
def test_every_world_of_a_batch_moves_as_a_world_does_to_the_last_bit(rig):
    world, batch = World(rig), Batch(rig, N, threads=2)
    first = world.servos.setpoint[:, 0].copy()
    found = batch.read()
    for k in range(25):
        q = swing(world, first, k)
        found = batch.step(q, STEPS)
        follow(world, q[1])
        world.step(STEPS)
    np.testing.assert_array_equal(world.save().row, batch.rows[1])
    assert world.time == found.time[1]
    measured = world.servos.read()
    np.testing.assert_allclose([found.q[1], found.qd[1], found.effort[1]], measured, atol=1e-12)
    assert np.abs(found.q[0] - found.q[2]).max() > 1e-3
    for name, tips in found.tips.items():
        np.testing.assert_allclose(tips[1], world.arm(name).measured_cp().matrix, atol=1e-12)
        local = world.arm(name).local.measured_cp().matrix
        np.testing.assert_allclose(found.local_tips[name][1], local, atol=1e-12)


def test_a_batch_begins_where_its_world_is():
    world = World("psm")
    world.arm("PSM1").servo_jp([0.2, 0.1, 0.15, 0.3, 0.2, 0.1])
    world.step(300)
    batch = Batch(world, N)
    np.testing.assert_array_equal(batch.rows, np.tile(world.save().row, (N, 1)))
    batch.step(n=STEPS)
    world.step(STEPS)
    np.testing.assert_array_equal(batch.rows[2], world.save().row)


def test_tips_and_jaws_are_set_by_name_and_the_rest_stays():
    batch = Batch(World("two_psm_ecm", dynamics="cad"), N)
    before = batch.read()
    goal = before.tips["PSM1"].copy()
    goal[:, 0, 3] += [0.0, 0.004, 0.008]
    jaw = np.array([0.1, 0.2, 0.3])
    batch.step({"PSM1/tip": goal, "PSM2/jaw": jaw}, 400)
    found = batch.step(n=400)
    np.testing.assert_allclose(found.tips["PSM1"], goal, atol=5e-4)
    column = batch.names.index("PSM2/jaw")
    np.testing.assert_allclose(batch.setpoints[:, column], jaw)
    others = [k for k, name in enumerate(batch.names) if name.startswith("ECM/")]
    np.testing.assert_allclose(found.q[:, others], before.q[:, others], atol=1e-3)


def test_a_tip_out_of_reach_leaves_that_world_where_it_is_told_to_be():
    batch = Batch("psm", N)
    goal = batch.read().tips["PSM1"].copy()
    goal[1, 2, 3] += 2.0
    setpoint = batch.setpoints[1].copy()
    found = batch.step({"PSM1/tip": goal}, STEPS)
    np.testing.assert_array_equal(found.rejected["PSM1"], [False, True, False])
    np.testing.assert_array_equal(batch.setpoints[1], setpoint)


def test_worlds_are_put_back_one_by_one_with_their_seeds():
    batch, lone = Batch("psm", N, seed=4), Batch("psm", N, seed=4)
    q = batch.setpoints + 0.1
    batch.step(q, 200)
    kept = batch.rows[[0, 2]].copy()
    found = batch.reset(np.array([False, True, False]), seeds=[9])
    np.testing.assert_array_equal(batch.rows[[0, 2]], kept)
    np.testing.assert_array_equal(batch.rows[1], lone.rows[1])
    assert found.time[1] == 0.0
    drawn = [rng.normal() for rng in batch.rngs]
    expected = [rng.normal() for rng in lone.rngs]
    assert drawn[0] == expected[0] and drawn[2] == expected[2]
    assert drawn[1] == np.random.default_rng(9).normal()
    for each in (batch, lone):
        each.step(np.tile(lone.setpoints[1] + 0.02, (N, 1)), 60)
    np.testing.assert_array_equal(batch.rows[1], lone.rows[1])


def test_objects_that_slept_are_awake_after_a_reset():
    batch, fresh = Batch("pegs", 2), Batch("pegs", 2)
    batch.step(n=1200)
    batch.reset(np.array([True, False]))
    fresh.step(n=300)
    batch.step(n=300)
    np.testing.assert_array_equal(batch.rows[0], fresh.rows[0])


def test_gains_of_one_world_are_those_of_a_world_with_these_gains():
    batch, world = Batch("psm", N), World("psm")
    gains = world.servos.gains
    p = np.tile(gains[:, 0], (N, 1))
    p[1, 0] *= 0.5
    batch.set_gains(p, gains[:, 1], gains[:, 2])
    world.arm("PSM1").joints.set_gains("yaw", p=float(p[1, 0]))
    q = batch.setpoints.copy()
    q[:, 0] += 0.1
    found = batch.step(q, 100)
    follow(world, q[1])
    world.step(100)
    np.testing.assert_array_equal(batch.rows[1], world.save().row)
    np.testing.assert_allclose(found.effort[1], world.servos.read()[2], atol=1e-12)
    assert np.abs(found.q[0] - found.q[1]).max() > 1e-4


def test_friction_of_one_world_holds_it_and_no_other():
    batch = Batch("psm", N)
    batch.expand("dof_damping")[2] = 1e12
    found = batch.step(batch.setpoints + 0.05, 100)
    assert np.abs(found.qd[2]).max() < 1e-9
    np.testing.assert_array_equal(found.q[0], found.q[1])
    assert np.abs(found.q[0] - found.q[2]).max() > 0.01


@pytest.mark.parametrize(
    ("setpoints", "why"),
    [
        (np.zeros((N, 6)), r"setpoints: got shape \(3, 6\); allowed: finite numbers, \(3, 7\)"),
        (np.full((N, 7), np.nan), "not finite"),
        ({"PSM1/jaw": np.zeros(2)}, r"PSM1/jaw: got shape \(2,\)"),
        ({"PSM1": "home"}, "PSM1: got"),
    ],
)
def test_set_points_that_cannot_be_used_are_rejected_and_nothing_moves(setpoints, why):
    batch = Batch("psm", N)
    before = batch.rows.copy()
    with pytest.raises(InputError, match=why):
        batch.step(setpoints, STEPS)
    np.testing.assert_array_equal(batch.rows, before)


def test_unknown_names_and_counts_are_rejected():
    batch = Batch("psm", N)
    with pytest.raises(UnknownNameError, match=r"PSM9.*known: PSM1, PSM1/jaw, PSM1/tip"):
        batch.step({"PSM9": np.zeros((N, 6))})
    for n in (0, 1.5, True):
        with pytest.raises(InputError, match="whole number above 0"):
            batch.step(n=n)  # type: ignore[arg-type]
        with pytest.raises(InputError, match="whole number above 0"):
            Batch("psm", n)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="3 of True and False"):
        batch.reset(np.zeros(2, bool))
    with pytest.raises(InputError, match="use set_gains"):
        batch.expand("actuator_biasprm")
