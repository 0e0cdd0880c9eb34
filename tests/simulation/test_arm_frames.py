"""Poses in frames by name, and the one way in which commands are rejected."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import InputError, RejectedError, UnknownNameError
from trocar.geometry.se3 import inverse
from trocar.simulation import World
from trocar.simulation.journal import Entry, apply_command

FRAMES = ["world", "camera", "ECM", "PSM2", ""]
#: Closing the loops in the physics and setup joints under their brakes leave less. [m, rad]
SETTLED = 1e-6


@pytest.fixture
def world() -> World:
    return World("full_cart", collisions=False)


def frame_in_world(world: World, frame: str) -> np.ndarray:
    """Return the pose of a frame in the world (4, 4), by other ways than the arm's."""
    if frame == "world":
        return np.eye(4)
    if frame == "camera":
        return next(c for c in world.cameras().values() if c.arm == "ECM").T_world_camera
    arm = world.arm(frame)
    return world.reference_pose(frame) @ arm.local.measured_cp().matrix


@pytest.mark.parametrize("frame", FRAMES[:-1])
def test_a_pose_in_a_named_frame_is_the_one_in_the_world_seen_from_there(world, frame):
    arm = world.arm("PSM1")
    T = world.reference_pose("PSM1") @ arm.local.measured_cp().matrix
    expected = inverse(frame_in_world(world, frame)) @ T
    assert arm.measured_cp(frame).frame_id == frame
    np.testing.assert_allclose(arm.measured_cp(frame).matrix, expected, atol=1e-12)
    world.step(100)
    goal = world.reference_pose("PSM1") @ arm.local.setpoint_cp().matrix
    expected = inverse(frame_in_world(world, frame)) @ goal
    np.testing.assert_allclose(arm.setpoint_cp(frame).matrix, expected, atol=1e-12)


def test_the_frame_of_the_ecm_is_that_of_the_dvrk_s_poses(world):
    arm = world.arm("PSM1")
    assert arm.measured_cp().frame_id == "ECM"
    np.testing.assert_allclose(arm.measured_cp("ECM").matrix, arm.measured_cp().matrix, atol=1e-12)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("verb", ["servo_cp", "move_cp"])
def test_a_commanded_pose_is_measured_in_its_frame_when_the_arm_has_settled(world, frame, verb):
    for name in ("PSM1", "PSM2", "ECM"):  # exactly at their set-points, without friction
        world.arm(name).joints.set_mode("set")
    world.step(1)
    arm = world.arm("PSM1")
    goal = arm.setpoint_cp(frame).matrix.copy()
    goal[:3, 3] += [0.003, -0.002, 0.001]
    assert getattr(arm, verb)(goal, frame=frame)
    world.step(5 if verb == "servo_cp" else 1500)
    np.testing.assert_allclose(arm.setpoint_cp(frame).matrix, goal, atol=SETTLED)
    np.testing.assert_allclose(arm.measured_cp(frame).matrix, goal, atol=SETTLED)


def test_a_frame_that_was_set_for_the_arm_changes_no_named_frame(world):
    arm = world.arm("PSM1")
    before = arm.measured_cp("world").matrix
    arm.local.set_base_frame(np.eye(4), "table")
    np.testing.assert_array_equal(arm.measured_cp("world").matrix, before)


def test_an_unknown_frame_is_named_with_the_known_ones(world):
    arm = world.arm("PSM1")
    for call in (arm.measured_cp, arm.setpoint_cp, lambda f: arm.servo_cp(np.eye(4), frame=f)):
        with pytest.raises(UnknownNameError, match=r"unknown frame 'table'.*world, camera,.*PSM1"):
            call("table")
    alone = World("psm").arm("PSM1")
    with pytest.raises(UnknownNameError, match=r"'camera'; known: world, PSM1"):
        alone.measured_cp("camera")


def test_a_command_is_repeated_in_its_frame(world):
    entries: list[Entry] = []
    world.listen(entries.append)
    arm = world.arm("PSM1")
    goal = arm.setpoint_cp("camera").matrix.copy()
    goal[0, 3] += 0.002
    arm.servo_cp(goal, frame="camera")
    arm.servo_cp(arm.setpoint_cp().matrix)
    commands = [e for e in entries if e.kind == "command"]
    assert [set(e.values) for e in commands] == [{"T", "frame"}, {"T"}]
    twin = World("full_cart", collisions=False)
    apply_command(twin, commands[0])
    arm.servo_cp(goal, frame="camera")
    np.testing.assert_allclose(twin.arm("PSM1").setpoint_jp(), arm.setpoint_jp(), atol=1e-9)


@pytest.mark.parametrize(
    ("call", "verb", "reason"),
    [
        (lambda a: a.servo_jp([np.nan] * 6), "servo_jp", "finite numbers"),
        (lambda a: a.servo_jr([1.0]), "servo_jr", "of shape"),
        (lambda a: a.servo_jv([0.0] * 6, timeout_s=-1.0), "servo_jv", "timeout_s"),
        (lambda a: a.move_jp("abc"), "move_jp", "allowed: 6 numbers"),
        (lambda a: a.servo_cp(np.zeros((4, 4))), "servo_cp", "pose"),
        (lambda a: a.body.servo_cf([0.0] * 5), "servo_cf", "forces"),
        (lambda a: a.forces.servo_ci(None), "servo_ci", "CartesianImpedance"),
        (lambda a: a.forces.lock_orientation(), "lock_orientation", "only masters"),
        (lambda a: a.jaw.move_jp([np.inf]), "jaw.move_jp", "finite"),
        (lambda a: a.state_command("resume"), "resume", "not supported in state ENABLED"),
        (lambda a: a.state_command("dance"), "state_command", "allowed: enable"),
    ],
)
def test_a_rejected_command_raises_where_the_world_says_so(call, verb, reason, caplog):
    world = World("psm", on_reject="raise")
    arm = world.arm("PSM1")
    before = world.save().row
    with pytest.raises(RejectedError, match=reason) as caught:
        call(arm)
    assert (caught.value.arm, caught.value.verb) == ("PSM1", verb)
    assert caught.value.reason and str(caught.value) == f"PSM1: {arm.rejections.last}"
    assert arm.rejections.count == 1
    assert not caplog.records
    np.testing.assert_array_equal(world.save().row, before)
    world.on_reject = "warn"
    assert not getattr(call(arm), "goal_reached", False)
    assert arm.rejections.count == 2


def test_a_clipped_target_warns_and_moves_whatever_rejections_do(caplog):
    world = World("psm", on_reject="raise")
    assert world.arm("PSM1").servo_jp([9.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    assert "clipped" in caplog.text


def test_rejections_warn_or_raise():
    assert World("psm").on_reject == "warn"
    with pytest.raises(InputError, match="allowed: warn, raise"):
        World("psm", on_reject="quietly")  # type: ignore[arg-type]
