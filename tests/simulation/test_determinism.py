"""Same rig, seed and commands: the same motion, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.simulation import World

GOAL = [0.4, -0.3, 0.16, 0.5, 0.2, -0.2]


def drive(world: World, chunks: list[int]) -> None:
    """Give the same commands at 0, 0.2 and 0.5 s, stepping in the given chunks in between."""
    arm = world.arm("PSM1")
    arm.move_jp(GOAL)
    advance(world, 200, chunks)
    arm.servo_jp(np.array(GOAL) * 0.5)
    advance(world, 300, chunks)
    assert arm.jaw is not None
    arm.jaw.move_jp([0.5])
    advance(world, 500, chunks)


def advance(world: World, periods: int, chunks: list[int]) -> None:
    turn = 0
    while periods > 0:
        count = min(chunks[turn % len(chunks)], periods)
        world.step(count)
        periods -= count
        turn += 1


def state(world: World) -> np.ndarray:
    return np.concatenate([world.mj_data.qpos, world.mj_data.qvel, world.mj_data.act])


@pytest.mark.parametrize("rig", ["psm", "two_psm_ecm"])
@pytest.mark.parametrize("load", [0.0, 5.0])
def test_two_worlds_move_alike_whatever_the_chunks(rig, load):
    """step(n) is n times step(1): gravity and load are renewed on a grid of their own."""
    found = []
    for chunks in ([1], [1000], [7, 1, 33], [20]):
        world = World(rig, tip_load_n=load)
        drive(world, chunks)
        assert world.time == pytest.approx(1.0)
        found.append(state(world))
    for other in found[1:]:
        np.testing.assert_array_equal(found[0], other)


def test_a_world_that_was_reset_moves_as_a_new_one():
    used, new = World("psm"), World("psm")
    drive(used, [1])
    arm = used.arm("PSM1")
    arm.joints.set_mode("effort")
    arm.servo_jf([0.5, 0, 0, 0, 0, 0])
    used.step(100)
    used.arm("PSM1").servo_jp([np.nan] * 6)
    used.reset()
    np.testing.assert_array_equal(state(used), state(new))
    assert used.time == 0.0
    drive(used, [50])
    drive(new, [50])
    np.testing.assert_array_equal(state(used), state(new))


def test_reset_locks_brakes_and_goes_back_to_position_with_the_rig_s_gains():
    world = World("suj_two_psm_ecm")
    arm, setup = world.arm("PSM1"), world.arm("SUJ_PSM1")
    setup.brakes.release()
    arm.joints.set_mode("set", ["yaw"])
    before = arm.joints.gains("yaw")
    arm.joints.set_gains("yaw", p=90.0)
    motion = arm.move_jp(GOAL)
    world.step(10)
    world.reset()
    assert all(setup.brakes.values())
    assert arm.joints.mode("yaw") == "position"
    assert arm.joints.gains("yaw") == before
    assert motion.done
    assert not motion.goal_reached
    assert not arm.operating_state().is_busy


def test_looking_changes_nothing():
    """Snapshots, health and readings after each step leave the motion as it is."""
    watched, alone = World("psm"), World("psm")
    for world in (watched, alone):
        world.arm("PSM1").move_jp(GOAL)
        for _ in range(300):
            world.step()
            if world is watched:
                world.snapshot()
                world.health()
                world.arm("PSM1").measured_cp()
                world.remote_centres()
    np.testing.assert_array_equal(state(watched), state(alone))


def test_a_snapshot_shows_bodies_where_the_joints_are_now():
    """After a step, and right after a pose is set with no step in between."""
    world = World("psm")
    world.arm("PSM1").joints.set_mode("set")
    world.arm("PSM1").servo_jp(GOAL)
    seen = world.snapshot()
    finger = world.mj_model.body("PSM1/finger_left").id
    tip = world.reference_pose("PSM1") @ world.arm("PSM1").local.measured_cp().matrix
    np.testing.assert_allclose(seen.positions[finger], tip[:3, 3], atol=1e-9)


def test_what_a_snapshot_holds_does_not_change_later():
    world = World("psm")
    seen = world.snapshot()
    positions, q = seen.positions.copy(), seen.arms["PSM1"].q.copy()
    world.arm("PSM1").move_jp(GOAL)
    world.step(100)
    np.testing.assert_array_equal(seen.positions, positions)
    np.testing.assert_array_equal(seen.arms["PSM1"].q, q)


def test_random_numbers_come_from_the_seed():
    one, other = World("psm", seed=3), World("psm", seed=4)
    first = one.rng.standard_normal(3)
    assert (first != other.rng.standard_normal(3)).all()
    one.reset()
    np.testing.assert_array_equal(one.rng.standard_normal(3), first)
    other.reset(seed=3)
    np.testing.assert_array_equal(other.rng.standard_normal(3), first)
    other.reset()
    np.testing.assert_array_equal(other.rng.standard_normal(3), first)
