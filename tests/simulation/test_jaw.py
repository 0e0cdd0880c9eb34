"""The jaw: opening, grip, and the two fingers that make it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.geometry.dh import modified_dh
from trocar.geometry.rotations import rotation_vector_from_matrix
from trocar.modeling.build import lone_rig
from trocar.simulation import World


@pytest.fixture
def world() -> World:
    return World("psm")


def jaw_of(world: World):
    jaw = world.arm("PSM1").jaw
    assert jaw is not None
    return jaw


def turns(world: World) -> np.ndarray:
    """How far each finger's body is turned from the wrist's, (2,) [rad]; both are 0 when shut."""
    mujoco.mj_kinematics(world.mj_model, world.mj_data)
    wrist = world.mj_data.body("PSM1/wrist_pitch").xmat.reshape(3, 3)
    return np.array(
        [
            rotation_vector_from_matrix(
                FROM_WRIST.T
                @ wrist.T
                @ world.mj_data.body(f"PSM1/finger_{side}").xmat.reshape(3, 3)
            )[2]
            for side in ("left", "right")
        ]
    )


#: Table 4 rows 14 and 15 at zero: alpha = 90, theta = -90 deg.
FROM_WRIST = modified_dh(-0.0091, np.pi / 2, 0.0, -np.pi / 2)[:3, :3]


def test_the_jaw_is_no_joint_of_the_arm_but_has_its_own_readings(world):
    arm = world.arm("PSM1")
    assert arm.joints.names[-1] == "jaw"
    assert arm.measured_js().name == arm.joints.names[:-1]
    assert jaw_of(world).measured_js().name == ("jaw",)
    assert jaw_of(world).measured_js().position.shape == (1,)
    assert world.snapshot().arms["PSM1"].q.shape == (7,)


@pytest.mark.parametrize("yaw", [-0.6, 0.0, 0.5])
def test_fingers_stand_at_the_wrist_yaw_plus_and_minus_half_the_opening(world, yaw):
    arm = world.arm("PSM1")
    arm.servo_jp([0, 0, 0.12, 0, 0, yaw])
    world.step(500)  # both at once are more than the discs' tracking error allows
    jaw_of(world).servo_jp([0.8])
    world.step(1500)
    q = arm.joints.readings()[0]
    # The right finger follows the left by a stiff constraint: to a microradian.
    np.testing.assert_allclose(turns(world), [q[5] + q[6] / 2, q[5] - q[6] / 2], atol=1e-6)
    assert q[5] == pytest.approx(yaw, abs=5e-3)  # dry friction over stiffness: 0.013 / 6
    assert q[6] == pytest.approx(0.8, abs=5e-3)


def test_closing_grips_with_at_most_the_jaws_effort_and_stays_shut(world):
    """Below 0 is grip, at most 0.16 N m, and the measured opening stays near 0.

    The motor can turn the light fingers by 5 mrad in one period before the stop is felt, so that
    much is lost when they meet; at rest the stop gives by less than 0.1 mrad.
    """
    jaw = jaw_of(world)
    jaw.servo_jp([0.5])
    world.step(500)
    closing = jaw.close()
    seen = []
    for _ in range(600):
        world.step()
        now = jaw.measured_js()
        seen.append([now.position[0], now.effort[0]])
    position, effort = np.array(seen).T
    assert closing.goal_reached
    assert jaw.setpoint_js().position[0] == pytest.approx(-np.deg2rad(20.0))
    assert position.min() >= -5e-3
    assert np.abs(effort).max() <= 0.16 + 1e-12
    shut = slice(450, None)
    assert np.ptp(position[:360]) > 0.4
    assert position[shut].min() >= -1e-4
    assert position[shut].max() <= 0.0
    np.testing.assert_allclose(effort[shut], -0.16)


def test_a_light_command_below_zero_grips_lightly():
    """The grip is the servo's: P times what the jaw lacks."""
    world = World("psm", dynamics="cad")
    jaw = jaw_of(world)
    jaw.servo_jp([-0.01])
    world.step(1000)
    p = world.arm("PSM1").joints.gains("jaw")[0]
    assert jaw.measured_js().effort[0] == pytest.approx(-0.01 * p, abs=1e-3)
    assert -1e-4 <= jaw.measured_js().position[0] <= 0.0


def test_opening_opens_to_sixty_degrees(world):
    jaw = jaw_of(world)
    assert jaw.open().wait(3.0)
    world.step(500)
    assert jaw.measured_js().position[0] == pytest.approx(np.deg2rad(60.0), abs=5e-3)


def test_an_effort_opens_and_closes_the_jaw():
    world = World("psm", friction="paper")
    arm, jaw = world.arm("PSM1"), jaw_of(world)
    arm.joints.set_mode("effort", ["jaw"])
    assert jaw.servo_jf([0.05])
    world.step(300)
    opened = jaw.measured_js().position[0]
    assert opened > 0.05
    assert jaw.servo_jf([-9.0])
    assert jaw.setpoint_js().effort[0] == -0.16
    world.step(1000)
    assert jaw.measured_js().position[0] == pytest.approx(0.0, abs=1e-3)


def test_in_set_mode_fingers_may_pass_each_other(world):
    """There, the fingers are where they are told, whatever is in between."""
    world.arm("PSM1").joints.set_mode("set")
    jaw_of(world).servo_jp([-0.3])
    left, right = turns(world)
    assert left - right == pytest.approx(-0.3)


@pytest.mark.parametrize(
    ("tool", "lower"),
    [("LARGE_NEEDLE_DRIVER:400006", -40.0), ("LARGE_NEEDLE_DRIVER:420006", -20.0)],
)
def test_each_instrument_closes_within_its_limits(tool, lower):
    world = World(lone_rig(load_arm("psm", tool)))
    arm = world.arm("arm")
    assert arm.jaw is not None
    assert arm.joints.lower[-1] == pytest.approx(np.deg2rad(lower), abs=1e-5)
    arm.jaw.close()
    arm.jaw.open()
    assert arm.rejections.count == 0


def test_an_arm_without_an_instrument_has_no_jaw():
    assert World("ecm").arm("ECM").jaw is None
    bare = World(lone_rig(load_arm("psm", "none"))).arm("arm")
    assert bare.jaw is None
    assert bare.joints.names == ("yaw", "pitch", "insertion")
