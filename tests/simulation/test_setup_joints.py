"""Setup joints: brakes, potentiometers, and everything that is mounted on them."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions.rig_frames import Places
from trocar.errors import InputError, UnknownNameError
from trocar.kinematics.forward import pose
from trocar.simulation import World

RIG = "suj_two_psm_ecm"


@pytest.fixture
def world() -> World:
    return World(RIG)


def carried_centre(world: World, name: str, q: np.ndarray) -> np.ndarray:
    """The remote centre of an arm by the analytic chain, at setup joints q, (3,) in the world."""
    arm = world.rig.arm(name)
    carrier = world.rig.arm(arm.on)
    at = carrier.pose @ pose(carrier.arm.mechanism, q, arm.frame, carrier.arm.root) @ arm.pose
    rest = np.zeros(len(arm.arm.joints))
    return (at @ pose(arm.arm.mechanism, rest, "rcm", arm.arm.root))[:3, 3]


def test_brakes_are_locked_and_hold_ten_newtons():
    """An arm that is pushed at its tip with 10 N moves its setup joints by less than 10 nm."""
    world = World(RIG, tip_load_n=10.0)
    setup = world.arm("SUJ_PSM1")
    assert setup.brakes == dict.fromkeys(setup.joints.names, True)
    before, centre = setup.measured_js().position, world.remote_centres()["PSM1"]
    world.step(1000)
    assert np.abs(setup.measured_js().position - before).max() < 1e-8
    assert np.linalg.norm(world.remote_centres()["PSM1"] - centre) < 1e-8


def test_a_loaded_column_stays_on_its_brake(world):
    """In an hour it sinks by less than the width of an atom: 2.8e-14 m/s."""
    setup = world.arm("SUJ_PSM1")
    before = setup.measured_js().position
    world.step(round(2.0 / world.timestep))
    assert np.abs(setup.measured_js().position - before).max() < 2.0 * 2.8e-14


def test_motors_behind_locked_brakes_exert_nothing(world):
    """The column's weight rests on its brake; released, it is carried."""
    setup = world.arm("SUJ_PSM1")
    world.step(100)
    assert not setup.measured_js().effort.any()
    setup.brakes.release()
    world.step(100)
    assert setup.measured_js().effort[0] > 100.0


def test_released_joints_move_and_what_hangs_on_them_follows(world):
    setup = world.arm("SUJ_PSM1")
    goal = setup.measured_js().position + np.array([0.05, 0.1, -0.1, 0.05, 0.1, -0.1])
    setup.brakes.release()
    assert not any(setup.brakes.values())
    assert setup.move_jp(goal).wait(20.0)
    world.step(1500)
    setup.brakes.lock()
    assert all(setup.brakes.values())
    reached = setup.measured_js().position
    np.testing.assert_allclose(reached, goal, atol=2e-3)  # dry friction over the servo's stiffness
    seen = world.snapshot().arms["PSM1"].remote_centre
    np.testing.assert_allclose(seen, carried_centre(world, "PSM1", reached), atol=1e-12)
    body = world.mj_model.body("PSM1/base").id
    root = world.snapshot().positions[body]
    np.testing.assert_allclose(
        root,
        Places(world.rig, lambda name: world.arm(name).joints.positions()).root_pose("PSM1")[:3, 3],
        atol=1e-9,
    )
    world.step(1000)
    np.testing.assert_allclose(setup.measured_js().position, reached, atol=1e-5)


def test_releasing_and_locking_do_not_move_anything(world):
    setup = world.arm("SUJ_PSM1")
    before = setup.measured_js().position
    for change in (setup.brakes.release, setup.brakes.lock, setup.brakes.release):
        change()
        world.step(200)
        assert np.abs(setup.measured_js().position - before).max() < 1e-4


def test_moves_are_rejected_while_every_brake_is_locked(world):
    setup = world.arm("SUJ_PSM1")
    before = setup.measured_js().position
    motion = setup.move_jp(before + 0.1)
    assert motion.done
    assert not motion.goal_reached
    assert not setup.servo_jp(before + 0.1)
    assert setup.rejections.count == 2
    assert "release them first" in setup.rejections.last
    np.testing.assert_array_equal(setup.setpoint_js().position, before)
    world.step(100)
    np.testing.assert_allclose(setup.measured_js().position, before, atol=1e-6)


def test_with_some_brakes_released_only_those_joints_move(world):
    setup = world.arm("SUJ_PSM1")
    before = setup.measured_js().position
    setup.brakes.release(["suj_2", "suj_4"])
    assert [name for name, locked in setup.brakes.items() if not locked] == ["suj_2", "suj_4"]
    goal = before + 0.1
    motion = setup.move_jp(goal)
    assert setup.rejections.count == 1
    assert setup.rejections.last == (
        "move_jp: suj_1, suj_3, suj_5, suj_6 stays: its brake is locked"
    )
    assert motion.wait(20.0)
    world.step(1000)
    reached = setup.measured_js().position
    free = [1, 3]
    np.testing.assert_allclose(reached[free], goal[free], atol=2e-3)
    held = [0, 2, 4, 5]
    np.testing.assert_allclose(reached[held], before[held], atol=1e-5)
    np.testing.assert_array_equal(motion.goal[held], before[held])
    np.testing.assert_array_equal(setup.setpoint_js().position[held], before[held])


def test_a_move_of_released_joints_alone_warns_of_nothing(world):
    """Locked joints may be sent back as they were read."""
    setup = world.arm("SUJ_PSM1")
    world.step(200)
    setup.brakes.release(["suj_2"])
    goal = setup.measured_js().position
    goal[1] += 0.05
    assert setup.servo_jp(goal)
    assert setup.rejections.count == 0


def test_locking_during_a_move_stops_it(world):
    setup = world.arm("SUJ_PSM1")
    setup.brakes.release()
    motion = setup.move_jp(setup.measured_js().position + 0.1)
    world.step(200)
    setup.brakes.lock()
    assert motion.done
    assert not motion.goal_reached
    stopped = setup.measured_js().position
    world.step(500)
    np.testing.assert_allclose(setup.measured_js().position, stopped, atol=1e-5)


def test_potentiometers_read_positions_with_offset_and_seeded_noise(world):
    setup = world.arm("SUJ_PSM1")
    clean = setup.measured_js().position
    np.testing.assert_array_equal(setup.joints.potentiometers(), clean)
    offset = np.linspace(-0.01, 0.01, 6)
    np.testing.assert_array_equal(setup.joints.potentiometers(offset=offset), clean + offset)
    one = setup.joints.potentiometers(0.002, rng=np.random.default_rng(5))
    np.testing.assert_array_equal(
        one, setup.joints.potentiometers(0.002, rng=np.random.default_rng(5))
    )
    assert (one != setup.joints.potentiometers(0.002, rng=np.random.default_rng(6))).all()
    rng = np.random.default_rng(7)
    many = np.array([setup.joints.potentiometers(0.002, rng=rng) for _ in range(2000)]) - clean
    assert many.std() == pytest.approx(0.002, rel=0.05)
    assert abs(many.mean()) < 1e-4
    np.testing.assert_array_equal(setup.measured_js().position, clean)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"noise": 0.01}, "random generator"),
        ({"noise": -0.01, "rng": np.random.default_rng(0)}, "0 or more"),
        ({"noise": np.nan, "rng": np.random.default_rng(0)}, "0 or more"),
        ({"offset": [0.1, 0.2]}, r"shape \(2,\)"),
    ],
)
def test_impossible_potentiometers_are_rejected(world, arguments, message):
    with pytest.raises(InputError, match=message):
        world.arm("SUJ_PSM1").joints.potentiometers(**arguments)


def test_only_setup_joints_have_brakes(world):
    psm = world.arm("PSM1")
    assert psm.brakes == {}
    with pytest.raises(InputError, match="PSM1: has no brakes"):
        psm.brakes.release()
    with pytest.raises(UnknownNameError, match="suj_1, suj_2"):
        world.arm("SUJ_PSM1").brakes.release(["yaw"])


def test_welded_setup_joints_stand_where_braked_ones_start(world):
    """Every body of the rig is at the same pose in both models."""
    welded = World(RIG, setup_joints="locked")
    assert welded.mj_model.nv < world.mj_model.nv
    one, other = world.snapshot(), welded.snapshot()
    bodies = [{w.mj_model.body(k).name for k in range(w.mj_model.nbody)} for w in (world, welded)]
    common = bodies[0] & bodies[1]
    assert common > {"PSM1/finger_left", "ECM/roll", "table"}
    for name in common:
        a = world.mj_model.body(name).id
        b = welded.mj_model.body(name).id
        np.testing.assert_allclose(one.positions[a], other.positions[b], atol=1e-12)
        same = np.abs(one.quaternions[a] @ other.quaternions[b])
        assert same == pytest.approx(1.0, abs=1e-12)
    for name in world.arms:
        here, there = (w.arm(name).measured_cp() for w in (world, welded))
        np.testing.assert_allclose(here.matrix, there.matrix, atol=1e-12)
        assert here.frame_id == there.frame_id


def test_welded_setup_joints_neither_move_nor_change():
    world = World(RIG, setup_joints="locked")
    setup = world.arm("SUJ_PSM1")
    before = setup.measured_js().position
    assert not setup.servo_jp(before + 0.1)
    assert setup.move_jp(before + 0.1).done
    assert setup.rejections.count == 2
    assert "welded" in setup.rejections.last
    for change in (
        lambda: setup.joints.set_mode("effort"),
        setup.brakes.release,
        setup.brakes.lock,
        lambda: world.set_state("SUJ_PSM1", before),
    ):
        with pytest.raises(InputError, match="welded into the model"):
            change()
    setup.hold()
    world.step(10)
    np.testing.assert_array_equal(setup.measured_js().position, before)
    assert all(setup.brakes.values())


def test_welded_arms_move_as_braked_ones():
    """The weld is no approximation: a PSM's motion differs by what brakes give, a few um."""
    goal = [0.2, -0.2, 0.14, 0.2, 0.1, 0.1]
    ends = []
    for setup_joints in ("braked", "locked"):
        world = World(RIG, setup_joints=setup_joints)
        world.arm("PSM1").move_jp(goal)
        world.step(800)
        ends.append(world.arm("PSM1").joints.readings()[0])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-5)


def test_other_arms_are_welded_by_name_where_they_start() -> None:
    world = World("training", welded=["ECM"])
    free, ecm = World("training"), world.arm("ECM")
    assert world.mj_model.nv < free.mj_model.nv
    assert not ecm.servo_jp(ecm.measured_js().position + 0.1)
    assert "welded" in ecm.rejections.last
    world.step(100)
    np.testing.assert_array_equal(ecm.measured_js().position, free.rig.poses["start"]["ECM"])
    seen, there = (w.camera("endoscope").T_world_camera for w in (world, free))
    np.testing.assert_allclose(seen, there, atol=1e-12)
    assert World(world.model).arguments["welded"] == ("ECM",)  # as a recording keeps it
    with pytest.raises(UnknownNameError, match=r"welded: unknown arm 'EMC'.*did you mean 'ECM'"):
        World("training", welded=["EMC"])
