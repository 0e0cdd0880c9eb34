"""A played table is what servo_jp would have done, row by row."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import InputError, UnknownNameError
from trocar.simulation import World


def table(rows: int) -> tuple[np.ndarray, np.ndarray]:
    time = 5e-3 * np.arange(rows)[:, None]
    swing = np.array([0.3, 0.2, 0.03, 0.5, 0.3, 0.2, 0.2])
    q = np.array([0, 0, 0.12, 0, 0, 0, 0.4]) + swing * np.sin(2 * time)
    return q, 2 * swing * np.cos(2 * time)


@pytest.mark.parametrize("rig", ["psm", "two_psm_ecm"])
def test_playing_is_servoing_at_the_same_ticks_bit_for_bit(rig):
    q, v = table(200)
    played, served = World(rig), World(rig)
    recording = played.play({"PSM1": q}, {"PSM1": v}, every=5)
    arm = served.arm("PSM1")
    assert arm.jaw is not None
    for row in range(200):
        arm.servo_jp(q[row, :6], v[row, :6])
        arm.jaw.servo_jp(q[row, 6:], v[row, 6:])
        served.step(5)
        np.testing.assert_array_equal(recording.positions["PSM1"][row], arm.joints.readings()[0])
        np.testing.assert_allclose(
            recording.efforts["PSM1"][row], arm.joints.readings()[2], atol=1e-12
        )
    for one, other in (
        (played.mj_data.qpos, served.mj_data.qpos),
        (played.mj_data.qvel, served.mj_data.qvel),
        (played.arm("PSM1").setpoint_js().position, arm.setpoint_js().position),
        (played.arm("PSM1").setpoint_js().velocity, arm.setpoint_js().velocity),
    ):
        np.testing.assert_array_equal(one, other)


def test_playing_in_pieces_is_playing_at_once():
    q, v = table(60)
    whole, pieces = World("psm"), World("psm")
    whole.play({"PSM1": q}, {"PSM1": v})
    for part in (slice(0, 7), slice(7, 40), slice(40, 60)):
        pieces.play({"PSM1": q[part]}, {"PSM1": v[part]}, record=False)
    np.testing.assert_array_equal(whole.mj_data.qpos, pieces.mj_data.qpos)


def test_samples_beyond_a_limit_are_clipped_and_counted():
    q, _ = table(50)
    q[10:14, 0] = 9.0
    q[12, 1] = -9.0
    q[20, 6] = 1.4005
    world = World("psm")
    recording = world.play({"PSM1": q})
    assert recording.clipped == {"PSM1": 5}
    inside = np.clip(q, world.arm("PSM1").joints.lower, world.arm("PSM1").joints.upper)
    other = World("psm")
    assert other.play({"PSM1": inside}).clipped == {"PSM1": 0}
    np.testing.assert_array_equal(world.mj_data.qpos, other.mj_data.qpos)


def test_a_recording_has_a_row_for_each_and_none_when_not_wanted():
    q, _ = table(30)
    world = World("psm")
    recording = world.play({"PSM1": q}, every=4)
    np.testing.assert_allclose(recording.time, 4e-3 * np.arange(1, 31), atol=1e-12)
    assert recording.positions["PSM1"].shape == (30, 7)
    assert len(world.play({"PSM1": q}, every=4, record=False).time) == 0
    assert world.time == pytest.approx(0.24)


def test_played_efforts_drive_joints_in_effort_mode_and_persist():
    world = World("psm", friction="paper")
    arm = world.arm("PSM1")
    arm.joints.set_mode("effort", ["yaw"])
    q, _ = table(10)
    effort = np.zeros_like(q)
    effort[:, :2] = 0.3
    world.play({"PSM1": q}, efforts={"PSM1": effort})
    assert arm.measured_js().velocity[0] > 0.05
    np.testing.assert_array_equal(arm.setpoint_js().effort, [0.3, 0, 0, 0, 0, 0])
    assert arm.jaw is not None
    arm.joints.set_mode("effort", ["jaw"])
    arm.jaw.servo_jf([0.0])  # a command for the jaw leaves the arm's efforts alone
    assert world.servos.commanded[0] == 0.3


def test_moves_of_other_arms_end_where_they_are():
    """They must not leap to where they would have been when the table is over."""
    world = World("two_psm_ecm")
    other = world.arm("PSM2")
    motion = other.move_jp(other.measured_js().position + 0.1)
    world.step(300)
    here = other.setpoint_js().position
    q, _ = table(100)
    world.play({"PSM1": q})
    assert motion.done
    assert not motion.goal_reached
    world.step(10)
    np.testing.assert_array_equal(other.setpoint_js().position, here)


BAD = np.zeros((4, 7))
BAD[2, 3] = np.nan


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"positions": {"PSM1": BAD}}, "PSM1: positions must be finite, got .* in row 2"),
        ({"positions": {"PSM1": BAD * 0 + np.inf}}, "finite"),
        ({"positions": {"PSM1": np.zeros((4, 6))}}, r"shape \(4, 6\); allowed: \(4, 7\)"),
        ({"positions": {"PSM1": np.zeros(7)}}, "allowed"),
        ({"positions": {"PSM1": np.zeros((0, 7))}}, "above 0"),
        ({"positions": {"PSM1": [["a"] * 7]}}, "no numbers"),
        ({"positions": {}}, "above 0"),
        (
            {"positions": {"PSM1": np.zeros((4, 7))}, "velocities": {"PSM1": BAD}},
            "velocities must be finite",
        ),
        (
            {"positions": {"PSM1": np.zeros((4, 7))}, "efforts": {"PSM1": BAD}},
            "efforts must be finite",
        ),
        (
            {"positions": {"PSM1": np.zeros((4, 7))}, "efforts": {"PSM2": np.zeros((4, 7))}},
            "PSM2: got no positions",
        ),
        ({"positions": {"PSM1": np.zeros((4, 7))}, "every": 0}, "whole number above 0"),
        ({"positions": {"PSM1": np.zeros((4, 7))}, "every": 1.5}, "whole number above 0"),
    ],
)
def test_a_table_that_cannot_be_played_is_rejected_and_nothing_moves(arguments, message):
    world = World("psm")
    before = world.mj_data.qpos.copy(), world.mj_data.ctrl.copy()
    with pytest.raises(InputError, match=message):
        world.play(**arguments)
    assert world.time == 0.0
    np.testing.assert_array_equal(world.mj_data.qpos, before[0])
    np.testing.assert_array_equal(world.mj_data.ctrl, before[1])


def test_arms_that_cannot_follow_a_table_are_told():
    world = World("suj_two_psm_ecm")
    with pytest.raises(UnknownNameError, match="unknown arm 'PSM9'"):
        world.play({"PSM9": np.zeros((2, 7))})
    with pytest.raises(InputError, match="SUJ_PSM1: the brakes are locked"):
        world.play({"SUJ_PSM1": np.zeros((2, 6))})
    world.arm("PSM1").joints.set_mode("set", ["yaw"])
    with pytest.raises(InputError, match='joints in mode "set" follow servo_jp only'):
        world.play({"PSM1": np.zeros((2, 7))})
