"""The servos' controller: proportional, integral, and a derivative that acts on the error."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.descriptions.inertial import holding_efforts
from trocar.modeling import naming
from trocar.simulation import World

YAW = 0


def lag_at_constant_speed(velocities: bool) -> float:
    """Yaw error behind a set-point that turns at 0.5 rad/s, after transients [rad]."""
    world = World("psm", control="paper", friction="paper", gravity_compensation=True)
    arm = world.arm("PSM1")
    speed = 0.5
    q = np.array([-0.5, 0.0, 0.12, 0.0, 0.0, 0.0])
    v = np.zeros(6)
    world.set_state("PSM1", np.append(q, 0.0), np.array([speed, 0, 0, 0, 0, 0, 0.0]))
    v[YAW] = speed if velocities else 0.0
    for _ in range(1500):
        q[YAW] += speed * world.timestep
        arm.servo_jp(q, v)
        world.step()
    return q[YAW] - arm.measured_js().position[YAW]


def test_a_velocity_set_point_leaves_no_lag_from_the_derivative():
    """What is left is the drag of the paper's damping: 0.1 N m s x 0.5 rad/s / 70 N m = 0.7 mrad.

    The servo is written once a period, so up to half a period's travel may be missing too.
    """
    damping, p, speed = 0.1, 70.0, 0.5
    lag = lag_at_constant_speed(velocities=True)
    assert lag == pytest.approx(damping * speed / p, abs=0.5 * speed * 1e-3)


def test_without_it_the_arm_lags_by_the_derivative_over_the_proportional_gain():
    """D v / P, 45 mrad at the paper's largest speed (0.63 rad/s)."""
    damping, d, p, speed = 0.1, 5.0, 70.0, 0.5
    lag = lag_at_constant_speed(velocities=False)
    assert lag == pytest.approx((d + damping) * speed / p, abs=0.5 * speed * 1e-3)


@pytest.mark.parametrize("control", ["dvrk", "paper"])
@pytest.mark.parametrize("rig", ["psm", "ecm"])
def test_compiled_gains_are_the_descriptions(rig, control):
    world = World(rig, control=control)
    for rig_arm in world.rig.arms:
        for joint, expected in rig_arm.arm.control[control].pid.items():
            assert world.arm(rig_arm.name).joints.gains(joint) == (
                expected.p,
                expected.i,
                expected.d,
            )
            assert compiled_gains(world, rig_arm.name, joint) == (
                expected.p,
                expected.i,
                expected.d,
            )


def compiled_gains(world: World, arm: str, joint: str) -> tuple[float, float, float]:
    servo = world.mj_model.actuator(naming.scoped(arm, joint))
    return -servo.biasprm[1], servo.gainprm[0], -servo.biasprm[2]


def test_changed_gains_reach_the_model_and_the_others_stay():
    world = World("psm")
    arm = world.arm("PSM1")
    before = arm.joints.gains("pitch")
    arm.joints.set_gains("yaw", p=50.0, d=2.0)
    assert compiled_gains(world, "PSM1", "yaw") == (50.0, 0.0, 2.0) == arm.joints.gains("yaw")
    arm.joints.set_gains("yaw", i=3.0)
    assert compiled_gains(world, "PSM1", "yaw") == (50.0, 3.0, 2.0)
    assert compiled_gains(world, "PSM1", "pitch") == before


def test_a_load_leaves_load_over_stiffness():
    """The weight of the leaning arm, with no compensation and no dry friction, bends the servo."""
    world = World("psm", friction="paper", gravity_compensation=False)
    arm = world.arm("PSM1")
    q = np.array([0.4, 0.3, 0.12, 0.0, 0.0, 0.0])
    world.set_state("PSM1", np.append(q, 0.0))
    arm.servo_jp(q)
    world.step(3000)
    sag = q - arm.measured_js().position
    load = holding_efforts(world.rig.arm("PSM1").arm, arm.joints.readings()[0])
    stiffness = [arm.joints.gains(name)[0] for name in arm.measured_js().name]
    np.testing.assert_allclose(sag, load[:6] / stiffness, atol=2e-7)  # still settling
    assert np.abs(sag[:2]).max() > 1e-3  # there is something to see


def test_the_integral_takes_a_lasting_error_away():
    world = World("psm", friction="paper", gravity_compensation=False)
    arm = world.arm("PSM1")
    q = np.array([0.4, 0.3, 0.12, 0.0, 0.0, 0.0])
    arm.joints.set_gains("yaw", i=200.0)
    arm.joints.set_gains("pitch", i=200.0)
    world.set_state("PSM1", np.append(q, 0.0))
    world.step(8000)
    assert np.abs(q - arm.measured_js().position)[:2].max() < 1e-6


@pytest.mark.parametrize("control", ["dvrk", "paper"])
def test_the_motors_limits_are_as_the_control_set_has_them(control):
    """The dVRK limits efforts, the paper does not; a jaw's grip is limited under both."""
    world = World("psm", control=control)
    described = load_rig("psm").arms[0].arm.joints
    limits = world.arm("PSM1").joints.effort_limit
    assert limits[-1] == described[-1].effort_max == 0.16
    if control == "dvrk":
        np.testing.assert_array_equal(limits, [j.effort_max for j in described])
    else:
        assert (limits[:-1] > 1e3).all()
    for joint, limit in zip(described, limits, strict=True):
        servo = world.mj_model.actuator(naming.scoped("PSM1", joint.name))
        np.testing.assert_array_equal(servo.forcerange, [-limit, limit])
