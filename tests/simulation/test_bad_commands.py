"""What cannot be used is rejected with a reason, and nothing moves."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
import pytest

from trocar.errors import DescriptionError, DivergedError, InputError, UnknownNameError
from trocar.simulation import World

GOOD = [0.1, -0.1, 0.13, 0.1, 0.1, 0.1]
UNUSABLE = [
    [np.nan, *GOOD[1:]],
    [np.inf, *GOOD[1:]],
    [*GOOD[:5], -np.inf],
    GOOD[:5],
    [*GOOD, 0.0],
    [GOOD],
    [],
    0.3,
    "home",
    ["0.1"] * 6,
    None,
    [None, *GOOD[1:]],
    [GOOD, GOOD[:3]],
    {"yaw": 0.1},
    [1j, *GOOD[1:]],
    [True] * 6,
]


def qpos_after(commands) -> np.ndarray:
    world = World("psm")
    arm = world.arm("PSM1")
    arm.move_jp(GOOD)
    world.step(50)
    commands(arm)
    world.step(100)
    return np.concatenate([world.mj_data.qpos, world.mj_data.qvel])


UNDISTURBED = qpos_after(lambda _arm: None)


@pytest.mark.parametrize("verb", ["servo_jp", "servo_jf", "move_jp", "velocity", "jaw"])
def test_unusable_commands_are_rejected_and_nothing_moves(verb, caplog):
    # No velocities: they are zero.
    unusable = [bad for bad in UNUSABLE if bad is not None or verb != "velocity"]

    def command(arm) -> None:
        for count, bad in enumerate(unusable, 1):
            if verb == "velocity":
                accepted = arm.servo_jp(GOOD, bad)
            elif verb == "jaw":
                accepted = arm.jaw.move_jp(bad).goal_reached
            elif verb == "move_jp":
                motion = arm.move_jp(bad)
                assert motion.done
                accepted = motion.goal_reached
            else:
                accepted = getattr(arm, verb)(bad)
            assert not accepted, bad
            assert arm.rejections.count == count, bad
            assert "allowed" in arm.rejections.last or "effort" in arm.rejections.last

    with caplog.at_level(logging.WARNING, "trocar"):
        np.testing.assert_array_equal(qpos_after(command), UNDISTURBED)
    assert {record.name for record in caplog.records} == {"trocar"}
    assert all(record.getMessage().startswith("PSM1: ") for record in caplog.records)


def test_a_flood_of_bad_commands_is_counted_and_logged_twice_a_second(caplog):
    world = World("psm")
    arm = world.arm("PSM1")
    with caplog.at_level(logging.WARNING, "trocar"):
        for k in range(500):
            arm.servo_jp([np.nan, *(np.array(GOOD[1:]) + 1e-4 * k)])  # never the same text
            world.step(5)
    assert arm.rejections.count == 500
    assert len(caplog.records) == 5  # at 0, 0.5, 1, 1.5 and 2 s
    with caplog.at_level(logging.WARNING, "trocar"):
        arm.servo_jp([0.1])  # another reason is said at once
    assert len(caplog.records) == 6


def test_targets_beyond_a_limit_are_clipped_with_a_warning(caplog):
    world = World("psm")
    arm = world.arm("PSM1")
    with caplog.at_level(logging.WARNING, "trocar"):
        assert arm.servo_jp([9.0, -9.0, 0.1, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(
        arm.setpoint_js().position[:2], [arm.joints.upper[0], arm.joints.lower[1]]
    )
    assert caplog.messages == ["PSM1: servo_jp: yaw, pitch clipped to the limit"]
    assert arm.rejections.count == 1
    motion = arm.move_jp([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    assert motion.goal[2] == arm.joints.upper[2] == 0.24
    assert not motion.done
    assert arm.rejections.count == 2


def test_efforts_beyond_a_limit_are_clipped_with_a_warning():
    arm = World("psm").arm("PSM1")
    arm.joints.set_mode("effort", ["yaw"])
    assert arm.servo_jf([50.0, 0, 0, 0, 0, 0])
    assert arm.setpoint_js().effort[0] == arm.joints.effort_limit[0]
    assert "clipped" in arm.rejections.last


def test_commands_are_not_written_to_and_not_kept():
    world = World("psm")
    arm = world.arm("PSM1")
    target = np.array(GOOD)
    arm.servo_jp(target)
    target[:] = 9.0
    np.testing.assert_array_equal(arm.setpoint_js().position, GOOD)
    given = arm.setpoint_js().position
    given[:] = 9.0
    np.testing.assert_array_equal(arm.setpoint_js().position, GOOD)


def test_unknown_names_list_the_known():
    with pytest.raises(
        UnknownNameError,
        match="known: ecm, ecm_si, full_cart, full_cart_mtm, full_cart_mtm_si, full_cart_si, mtm,",
    ):
        World("robot")
    world = World("psm")
    with pytest.raises(UnknownNameError, match=r"unknown arm 'PSM2'.*known: PSM1"):
        world.arm("PSM2")
    with pytest.raises(UnknownNameError, match=r"unknown pose 'hme'.*did you mean 'home'"):
        world.arm("PSM1").move_to("hme")
    with pytest.raises(UnknownNameError, match=r"unknown pose 'nowhere'.*start"):
        world.reset(pose="nowhere")
    with pytest.raises(DescriptionError, match="no such file"):
        World("robot.toml")


@pytest.mark.parametrize("count", [0, -1, 1.5, True, "2", None, np.nan])
def test_step_wants_a_whole_number_above_zero(count):
    world = World("psm")
    with pytest.raises(InputError, match="a whole number above 0"):
        world.step(count)
    assert world.time == 0.0


@pytest.mark.parametrize(
    ("argument", "value", "allowed"),
    [
        ("timestep_s", 0.0, "above 0"),
        ("timestep_s", -0.001, "above 0"),
        ("timestep_s", 0.02, "0.01 s"),
        ("timestep_s", np.nan, "above 0"),
        ("timestep_s", "fast", "above 0"),
        ("control", "ros", "dvrk, paper"),
        ("friction", "none", "identified, paper"),
        ("setup_joints", "free", "braked, locked"),
        ("tip_load_n", np.nan, "0 N or more"),
        ("tip_load_n", -1.0, "0 N or more"),
        ("seed", -1, "a whole number from 0 on"),
        ("seed", "dice", "a whole number from 0 on"),
    ],
)
def test_each_argument_of_a_world_says_what_is_allowed(argument, value, allowed):
    with pytest.raises(InputError, match=allowed):
        World("psm", **{argument: value})


@pytest.mark.parametrize("bad", [[0.0] * 6, [np.nan] * 7, "here", None])
def test_a_state_that_cannot_be_is_rejected(bad):
    world = World("psm")
    before = world.mj_data.qpos.copy()
    with pytest.raises(InputError, match="allowed: 7 finite numbers"):
        world.set_state("PSM1", bad)
    np.testing.assert_array_equal(world.mj_data.qpos, before)


def test_a_diverged_simulation_says_when_where_and_what_it_was_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log of its own where it runs
    world = World("psm")
    arm = world.arm("PSM1")
    arm.servo_jp(GOOD)
    world.step(100)
    hinge = int(world.mj_model.joint("PSM1/pitch_back").dofadr[0])
    world.mj_data.qvel[hinge] = np.nan
    with pytest.raises(DivergedError) as caught:
        world.step(50)
    error = caught.value
    assert 0.1 <= error.time <= 0.15 + 1e-9
    assert error.joint == "PSM1/pitch"
    assert error.target == GOOD[1]
    for part in ("t = 0.1", "PSM1/pitch", "-0.1", "not finite"):
        assert part in str(error)
    with pytest.raises(DivergedError):  # and it stays so
        world.step()


def test_reset_recovers_from_a_divergence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    broken, new = World("psm"), World("psm")
    broken.mj_data.qpos[0] = np.nan
    for _ in range(3):  # until gravity compensation has seen it too
        with pytest.raises(DivergedError):
            broken.step(20)
    broken.reset()
    assert not broken.mj_data.warning.number.any()
    for world in (broken, new):
        world.arm("PSM1").move_jp(GOOD)
        world.step(200)
    np.testing.assert_array_equal(broken.mj_data.qpos, new.mj_data.qpos)
    assert broken.health().branch_ok


def test_a_divergence_in_a_played_table_names_the_row_it_was_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = World("psm")
    q = np.zeros((20, 7))
    q[:, 0] = np.linspace(0, 0.19, 20)
    q[:, 2] = 0.12
    world.mj_data.qvel[int(world.mj_model.joint("PSM1/yaw").dofadr[0])] = np.nan
    with pytest.raises(DivergedError) as caught:
        world.play({"PSM1": q}, every=5)
    assert caught.value.target == q[0, 0]


def test_no_numbers_that_are_no_longer_finite_pass_unnoticed():
    """MuJoCo's own reset of a bad state is off: it would hide the divergence."""
    world = World("psm")
    off = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    assert world.mj_model.opt.disableflags & off
