"""A saved world goes on to the last bit, wherever it is loaded; a reset depends on nothing else."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.modeling.build import build
from trocar.modeling.options import ModelOptions
from trocar.simulation import State, World

GOAL = [0.4, -0.3, 0.16, 0.8, 0.3, -0.2]


def idle(world: World) -> None:
    del world


def moving(world: World) -> None:
    arm = world.arm("PSM1")
    arm.joints.set_trajectory_ratio(0.5)
    arm.move_jp(GOAL)
    assert arm.jaw is not None
    arm.jaw.move_jp([0.5])


def drifting(world: World) -> None:
    world.arm("PSM1").servo_jv([0.1, 0.0, -0.01, 0.3, 0.0, 0.0])


def pushing(world: World) -> None:
    world.arm("PSM1").body.servo_cf([0.3, 0.0, -0.2, 0.0, 0.0, 0.0])


def homing(world: World) -> None:
    world.arm("PSM1").servo_jp(GOAL)
    world.step(200)
    world.arm("PSM1").home()


def modes(world: World) -> None:
    arm = world.arm("PSM1")
    arm.joints.set_mode("effort", ["yaw"])
    arm.joints.set_gains("pitch", p=60.0)
    arm.joints.use_gravity_compensation(False)
    arm.servo_jf([0.2, 0, 0, 0, 0, 0])


def paused(world: World) -> None:
    world.arm("PSM1").state_command("pause")
    if "ECM" in world.arms:
        world.arm("ECM").disable()


def locked(world: World) -> None:
    master = world.arm("MTML")
    master.forces.lock_orientation()
    master.body.servo_cf([0.1, 0.2, 0.0, 0.0, 0.0, 0.0])
    assert master.gripper is not None
    master.gripper.squeeze_to(0.0)


CASES: list[tuple[str, Callable[[World], None]]] = [
    ("psm", idle),
    ("psm", moving),
    ("psm", drifting),
    ("psm", pushing),
    ("psm", homing),
    ("psm", modes),
    ("two_psm_ecm", paused),
    ("full_cart", moving),
    ("mtm", locked),
]


def numbers(world: World) -> np.ndarray:
    return world.save().row


def same(one: World, other: World, steps: int) -> None:
    """Step both and compare every number of the physics and of what arms say."""
    for world in (one, other):
        world.step(steps)
    np.testing.assert_array_equal(numbers(one), numbers(other))
    for name, arm in one.arms.items():
        twin = other.arm(name)
        np.testing.assert_array_equal(arm.joints.readings(), twin.joints.readings())
        assert arm.runtime.snapshot(None).modes == twin.runtime.snapshot(None).modes
        now, then = arm.operating_state(), twin.operating_state()
        assert (now.state, now.is_homed, now.is_busy) == (then.state, then.is_homed, then.is_busy)


@pytest.mark.parametrize(("rig", "act"), CASES)
def test_a_loaded_world_goes_on_to_the_last_bit(rig, act):
    world = World(rig)
    world.step(37)
    act(world)
    world.step(60)
    state: State = pickle.loads(pickle.dumps(world.save()))
    fresh, used = World(rig), World(rig, seed=5)
    used.arms[next(iter(used.arms))].disable()
    used.step(41)
    fresh.load(state)
    used.load(state)
    assert fresh.time == world.time
    assert fresh.periods == world.periods
    world.step(300)
    for other in (fresh, used):
        other.step(300)
        same(world, other, 100)
        world.load(state)
        world.step(300)


@pytest.mark.parametrize("periods", [5, 400, 900, 1240, 1262])
def test_sleeping_objects_stay_asleep_and_wake_alike(periods):
    """Blocks fall, come to rest, sleep; one is lifted at 1240 and falls again."""
    world, others = World("pegs"), [World("pegs"), World("pegs")]
    others[1].step(700)
    first = next(iter(world.objects))

    def step_to(one: World, last: int) -> None:
        while one.periods < last:
            if one.periods == 1240:
                T = one.object(first).measured_cp().matrix.copy()
                T[:3, 3] += [0.001, 0.0005, 0.02]
                one.object(first).set_cp(T)
            one.step()

    step_to(world, periods)
    state = world.save()
    for other in others:
        other.load(state)
    for one in (world, *others):
        step_to(one, periods + 400)
    for other in others:
        np.testing.assert_array_equal(numbers(world), numbers(other))


def test_loading_into_the_same_world_ends_its_moves_and_begins_those_of_the_state():
    world = World("psm")
    arm = world.arm("PSM1")
    first = arm.move_jp(GOAL)
    world.step(50)
    state = world.save()
    world.step(50)
    world.load(state)
    assert first.done and not first.goal_reached
    assert arm.operating_state().is_busy
    world.step(3000)
    np.testing.assert_array_equal(arm.setpoint_js().position, GOAL)


def test_random_numbers_go_on_where_they_were():
    world, other = World("psm", seed=3), World("psm")
    world.rng.normal(size=5)
    other.load(world.save())
    np.testing.assert_array_equal(world.rng.normal(size=4), other.rng.normal(size=4))


@pytest.mark.parametrize("build", [lambda: World("ecm"), lambda: World("psm", friction="paper")])
def test_a_state_of_another_model_is_rejected_and_nothing_changes(build):
    world, other = World("psm"), build()
    before = numbers(other)
    with pytest.raises(InputError, match=r"load: got a state of psm .*; allowed: one of"):
        other.load(world.save())
    np.testing.assert_array_equal(numbers(other), before)


@pytest.mark.parametrize(("rig", "act"), CASES)
def test_reset_is_a_function_of_seed_and_pose_alone(rig, act):
    used, new = World(rig), World(rig, seed=11)
    act(used)
    used.step(83)
    pose = sorted(used.rig.poses)[0]
    used.reset(7, pose)
    new.reset(7, pose)
    first, second = used.save(), new.save()
    np.testing.assert_array_equal(first.row, second.row)
    for name, array in first.servos.items():
        np.testing.assert_array_equal(array, second.servos[name], name)
    assert first.random == second.random
    for name, arm in first.arms.items():
        other = second.arms[name]
        assert (arm.phase, arm.desired, arm.known, arm.homed, arm.laws, arm.homing) == (
            other.phase,
            other.desired,
            other.known,
            other.homed,
            other.laws,
            other.homing,
        )
        assert arm.control.ratios == other.control.ratios
        assert arm.control.lent == other.control.lent == frozenset()
    same(used, new, 200)


def test_many_worlds_share_one_model_and_none_writes_to_it():
    model = build("psm", ModelOptions(friction="paper"))
    one, two = World(model), World(model)
    before = model.mj.actuator_biasprm.copy()
    one.arm("PSM1").joints.set_gains("yaw", p=5.0)
    one.arm("PSM1").disable()
    one.step(50)
    two.step(50)
    np.testing.assert_array_equal(model.mj.actuator_biasprm, before)
    lone = World("psm", friction="paper")
    lone.step(50)
    np.testing.assert_array_equal(numbers(two), numbers(lone))
    two.load(lone.save())


def test_a_model_says_what_it_is_built_with():
    with pytest.raises(InputError, match="got a model and friction; allowed: options of build"):
        World(build("psm"), friction="paper")
    with pytest.raises(InputError, match="servo 'position'; allowed: 'pid'"):
        World(build("psm", ModelOptions(servo="position")))


def test_a_saved_row_is_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        World("psm").save().row[0] = 1.0


def test_what_is_no_state_is_not_loaded() -> None:
    with pytest.raises(InputError, match="load: got 'state'; allowed: a State"):
        World("psm").load("state")  # type: ignore[arg-type]
