"""Masters under force control: the platform gives way, and the gimbal may hold an orientation."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.geometry.rotations import (
    angle_between,
    matrix_from_rotation_vector,
    quaternion_from_matrix,
)
from trocar.kinematics.forward import pose
from trocar.kinematics.inverse_gimbal_arm import gimbal_branches
from trocar.simulation import World
from trocar.simulation.masters import (
    PLATFORM_D,
    PLATFORM_EFFORT_MAX,
    PLATFORM_P,
    PLATFORM_STEP,
    PlatformEffort,
    check_orientation,
    platform_advance,
)

HANDS_OFF = np.zeros(6)
#: Dry friction over the gimbal's stiffness is up to 10 mrad a joint; what lags in motion, as much.
HELD_RAD = np.deg2rad(3.0)


@pytest.fixture
def world():
    return World("mtm")


@pytest.fixture
def arm(world):
    return world.arm("MTML")


def orientation(arm) -> np.ndarray:
    return arm.measured_cp().matrix[:3, :3]


def push_about(world, arm, seconds: float = 2.0) -> float:
    """Push the hand to and fro, and return the largest turn of it on the way [rad]."""
    start, worst, way = orientation(arm), 0.0, 0.0
    begin = arm.measured_cp().matrix[:3, 3]
    for k in range(round(seconds / 0.02)):
        angle = 2.0 * np.pi * k / 50.0
        force = 1.0 * np.array([np.cos(angle), np.sin(angle), np.cos(angle)])
        assert arm.body.servo_cf([*(orientation(arm).T @ force), 0, 0, 0])
        world.step(20)
        worst = max(worst, float(angle_between(start, orientation(arm))))
        way = max(way, float(np.linalg.norm(arm.measured_cp().matrix[:3, 3] - begin)))
    assert way > 0.03  # the first three joints are free
    return worst


def test_the_gimbal_holds_the_orientation_while_the_hand_is_moved(world, arm):
    arm.body.servo_cf(HANDS_OFF)
    assert arm.forces.lock_orientation()
    assert arm.forces.orientation_locked
    assert push_about(world, arm) < HELD_RAD


def test_unlocked_the_hand_turns_with_the_arm(world, arm):
    arm.body.servo_cf(HANDS_OFF)
    assert push_about(world, arm) > 2.0 * HELD_RAD


def test_a_quaternion_means_the_orientation_of_its_matrix(arm):
    R = orientation(arm) @ matrix_from_rotation_vector(np.array([0.3, -0.2, 0.4]))
    np.testing.assert_allclose(check_orientation(quaternion_from_matrix(R)), R, atol=1e-12)
    assert arm.forces.lock_orientation(quaternion_from_matrix(R))


def test_a_wanted_orientation_is_approached_and_held(world, arm):
    expected = orientation(arm) @ matrix_from_rotation_vector(np.array([0.3, -0.2, 0.4]))
    arm.body.servo_cf(HANDS_OFF)
    assert arm.forces.lock_orientation(expected)
    before = arm.measured_cp().matrix[:3, 3]
    world.step(3000)
    assert angle_between(orientation(arm), expected) < HELD_RAD
    assert np.linalg.norm(arm.measured_cp().matrix[:3, 3] - before) < 0.02


def test_a_lock_waits_for_force_control(world, arm):
    assert arm.forces.lock_orientation()
    world.step(100)
    assert arm.forces.orientation_locked and set(arm.runtime.snapshot(None).modes[:7]) == {
        "position"
    }
    arm.body.servo_cf(HANDS_OFF)
    assert arm.runtime.snapshot(None).modes[:7] == ("effort",) * 3 + ("position",) * 4


def test_unlocking_lets_the_gimbal_float(world, arm):
    arm.body.servo_cf(HANDS_OFF)
    arm.forces.lock_orientation()
    world.step(100)
    assert arm.forces.unlock_orientation()
    assert not arm.forces.orientation_locked
    assert set(arm.runtime.snapshot(None).modes[:7]) == {"effort"}
    world.step(500)
    assert np.abs(arm.measured_js().velocity).max() < 0.05


@pytest.mark.parametrize(
    "verb", ["hold", "free", "servo_jp", "servo_jf", "move_jp", "disable", "state_command", "reset"]
)
def test_every_other_command_ends_the_lock(world, arm, verb):
    arm.body.servo_cf(HANDS_OFF)
    arm.forces.lock_orientation()
    world.step(50)
    q = arm.measured_js().position
    given = {"servo_jp": (q,), "move_jp": (q,), "servo_jf": (np.zeros(7),)}
    given["state_command"] = ("pause",)
    getattr(world if verb == "reset" else arm, verb)(*given.get(verb, ()))
    assert not arm.forces.orientation_locked
    expected = "effort" if verb in ("free", "servo_jf") else "position"
    # servo_jf and free find the gimbal under position control, and take it along
    assert set(arm.runtime.snapshot(None).modes[:7]) == {expected}


def test_the_lock_is_told(world, arm):
    entries = []
    world.listen(lambda e: entries.append((e.kind, e.name, dict(e.values))))
    arm.forces.lock_orientation()
    arm.forces.unlock_orientation()
    arm.forces.unlock_orientation()
    assert [(k, n) for k, n, _ in entries] == [
        ("command", "lock_orientation"),
        ("event", "orientation_locked"),
        ("command", "unlock_orientation"),
        ("event", "orientation_locked"),
        ("command", "unlock_orientation"),
    ]
    assert [v["locked"] for k, _, v in entries if k == "event"] == [True, False]


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros(4),
        np.ones((3, 3)),
        np.diag([1, 1, -1.0]),
        [1, 0, 0],
        "up",
        [np.nan] * 4,
        [1e200] * 4,
    ],
)
def test_what_is_no_orientation_is_rejected_with_a_warning(arm, bad):
    assert not arm.forces.lock_orientation(bad)
    assert not arm.forces.orientation_locked
    assert "lock_orientation: orientation" in arm.rejections.last
    with pytest.raises(InputError):
        check_orientation(bad)


def test_only_masters_that_are_ready_lock(arm):
    psm = World("psm").arm("PSM1")
    assert not psm.forces.lock_orientation()
    assert "only masters can" in psm.rejections.last
    arm.disable()
    assert not arm.forces.lock_orientation()
    assert "lock_orientation" in arm.rejections.last


# ---------------------------------------------------------------- the platform


def test_the_platform_s_effort_is_the_dvrk_s():
    """Source: SAW control_servo_cf_preload: 0.5 (1 (goal - q4) - 0.1 v4), at most 0.4 N m."""
    controller = PlatformEffort(-1.658, 3.5779)
    q, qd = np.zeros(7), np.zeros(7)
    q[4], q[5] = 0.3, 0.1
    assert controller.effort(q, qd) == pytest.approx(0.5 * 0.1 * np.cos(0.3))
    qd[3] = 0.2
    assert controller.effort(q, qd) == pytest.approx(0.5 * (0.1 * np.cos(0.3) - 0.1 * 0.2))
    q[5] = 0.7
    qd[3] = 0.0
    assert controller.effort(q, qd) == pytest.approx(PLATFORM_P * PLATFORM_STEP)
    q[3] = 3.5779
    assert controller.effort(q, qd) == 0.0  # at its limit
    qd[3] = 100.0
    assert controller.effort(q, qd) == -PLATFORM_EFFORT_MAX
    assert pytest.approx(0.05) == PLATFORM_D


def test_the_platform_s_advance_brings_the_wrist_yaw_towards_its_middle(rng):
    """Turn the platform by a little of it, the hand's orientation kept: the yaw gets smaller."""
    mechanism = load_arm("mtmr").mechanism
    for _ in range(50):
        q = np.zeros(8)
        q[:7] = rng.uniform([-1, -0.3, -0.8, 0, -1.2, 0.1, -1], [0.6, 1.1, 0.6, 2, 1.2, 0.7, 1])
        q[5] *= rng.choice([-1.0, 1.0])
        R = pose(mechanism, q)[:3, :3]
        on = q[3] + 0.05 * platform_advance(q[:7])
        found, _ = gimbal_branches(R, q[None, :3], np.array([[on]]))
        apart = np.abs(found - q[:7])[:, 5]
        assert abs(found[apart.argmin(), 5]) < abs(q[5])


def test_under_force_control_the_platform_gives_way_and_the_hand_stays(world, arm):
    q = np.array([0.1, 0.3, 0.1, -0.5, 0.3, 0.6, 0.2, arm.joints.upper[-1]])
    world.set_state("MTML", q)
    arm.body.servo_cf(HANDS_OFF)
    before = arm.measured_cp().matrix[:3, 3]
    world.step(4000)
    now = arm.measured_js().position
    assert now[3] > q[3] + 0.2
    assert np.linalg.norm(arm.measured_cp().matrix[:3, 3] - before) < 1e-3
    for verb in ("free", "spatial"):
        world.reset()
        world.set_state("MTML", q)
        assert arm.free() if verb == "free" else arm.spatial.servo_cf(HANDS_OFF)
        world.step(1000)
        np.testing.assert_allclose(arm.measured_js().position, q[:7], atol=1e-3)
