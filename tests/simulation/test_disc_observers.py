"""Disturbance observers of an instrument's discs, which drive several joints together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import load_rig
from trocar.descriptions.records import Observer, RigDescription
from trocar.simulation import World
from trocar.simulation.jaw import Jaw

#: Joints from discs of the Large Needle Driver. Source: sawIntuitiveResearchKit@9e535e6
#: share/tool/LARGE_NEEDLE_DRIVER_420006.json.
A = np.array(
    [
        [-1.5632, 0.0, 0.0, 0.0],
        [0.0, 1.0186, 0.0, 0.0],
        [0.0, -0.8306, 0.6089, 0.6089],
        [0.0, 0.0, -1.2177, 1.2177],
    ]
)
#: Largest torque of a disc. Source: dvrk-io-config-generator.py of the same commit, SiPSM. [N m]
MOST = 0.0385 * 13.813 * 1.1
#: Nominal mass and cut-off of the discs. Source: share/pid/sawControllersPID-PSM-Si.json, index 3
#: to 6. [kg m^2, rad/s]
MASS, CUTOFF = 0.0005, np.array([10.0, 10.0, 0.0, 10.0])
WRIST = slice(3, 7)


def jaw_of(world: World) -> Jaw:
    jaw = world.arm("PSM1").jaw
    assert jaw is not None
    return jaw


def observed(*discs: Observer, friction: bool = False) -> RigDescription:
    """Return `psm_si` with other observers of discs and, unless asked for, no friction."""
    rig = load_rig("psm_si")
    (place,) = rig.arms
    control = replace(place.arm.control["dvrk"], disc_observer=discs)
    arm = replace(place.arm, control={"dvrk": control})
    if not friction:
        arm = replace(arm, friction={"identified": {}})
    return replace(rig, arms=(replace(place, arm=arm),))


def built_in() -> tuple[Observer, ...]:
    """Return the discs' observers of the arm that trocar ships."""
    return load_rig("psm_si").arms[0].arm.control["dvrk"].disc_observer


def pushed(rig: RigDescription, efforts: NDArray[np.float64]) -> World:
    """Return a world in which constant efforts act on the wrist, (4,), after 3 s."""
    world = World(rig)
    q = world.arms["PSM1"].joints.positions()
    world.set_state("PSM1", np.append(q[:6], 0.5))  # away from the stop of the jaw
    world.mj_data.qfrc_applied[np.abs(world.joints.rate[WRIST]).argmax(axis=1)] = efforts
    world.step(1500)
    return world


def wrist_error(world: World) -> NDArray[np.float64]:
    """Return how far the wrist is from its set-point, (4,) [rad]."""
    joints = world.arms["PSM1"].joints
    return (joints.positions() - joints.setpoints())[WRIST]


def test_the_discs_of_the_built_in_arm_are_those_of_the_dvrk():
    np.testing.assert_array_equal([d.mass for d in built_in()], MASS)
    np.testing.assert_array_equal([d.cutoff for d in built_in()], CUTOFF)


@pytest.mark.parametrize("joint", [0, 1])
def test_discs_take_a_constant_disturbance_of_the_wrist(joint: int):
    """Roll and wrist pitch load discs 1 and 2 alone, which have observers."""
    efforts = 0.03 * np.eye(4)[joint]
    without, with_them = pushed(observed(), efforts), pushed(observed(*built_in()), efforts)
    assert abs(wrist_error(without)[joint]) > 4e-3
    assert np.abs(wrist_error(with_them)[:2]).max() < 1e-6


def test_the_estimate_is_the_disturbance():
    """Beside the weight of the wrist, which nothing compensates and both worlds have."""
    efforts, found = np.array([0.03, -0.02, 0.0, 0.0]), []
    for acting in (efforts, np.zeros(4)):
        world = pushed(observed(*built_in()), acting)
        found.append(np.linalg.inv(A).T @ world.servos.observations()[0, WRIST])
    np.testing.assert_allclose(found[0] - found[1], -efforts, atol=1e-5)


def test_disc_3_has_no_observer_so_the_wrist_yaw_gives_way():
    """At rest the PID of discs 1, 2 and 4 is idle, and that of disc 3 holds its part."""
    efforts = np.array([0.0, 0.0, 0.03, 0.0])
    loaded, idle = (
        pushed(observed(*built_in()), efforts),
        pushed(observed(*built_in()), 0 * efforts),
    )
    gains = loaded.servos.gains[WRIST, 0]
    pid = A.T @ (gains * (wrist_error(idle) - wrist_error(loaded)))
    np.testing.assert_allclose(pid, [0.0, 0.0, -0.03 * A[2, 2], 0.0], atol=1e-5)
    assert abs(wrist_error(loaded)[2]) > 1e-3


@pytest.mark.parametrize(
    "cutoff", [CUTOFF, np.full(4, 30.0)], ids=["as in the dVRK", "the same of all discs"]
)
def test_efforts_of_joints_are_those_of_the_dvrks_law_at_the_discs(cutoff: NDArray[np.float64]):
    """mtsPID.cpp:571-597 on the same readings, through SAW's coupling; jaw and wrist saturate."""
    rig = observed(*(Observer(MASS, g) for g in cutoff.tolist()), friction=True)
    world = World(rig)
    servos, joints = world.servos, world.arm("PSM1").joints
    state, effort, alike = np.zeros(4), np.zeros(4), np.zeros(4)
    rng, largest, full = np.random.default_rng(4), 0.0, 0
    spread = np.linalg.inv(A).T
    for k in range(300):
        if k % 60 == 0:
            step = np.append(np.zeros(3), rng.uniform(-0.05, 0.05, 3))
            world.arm("PSM1").servo_jp(joints.setpoints()[:6] + step)
            jaw_of(world).servo_jp([rng.uniform(0.0, 0.8)])
        q, qd, _ = servos.true()
        q, qd = q[WRIST].copy(), qd[WRIST].copy()
        discs = np.linalg.solve(A, qd)
        state += (A.T @ effort + MASS * cutoff * discs - state) * cutoff * world.timestep
        found = np.where(cutoff > 0.0, state - MASS * cutoff * discs, 0.0)
        if np.ptp(cutoff) == 0.0:  # one cut-off: the law may as well be written in joints
            damping = spread @ (MASS * cutoff * discs)
            alike += (effort + damping - alike) * cutoff[0] * world.timestep
            np.testing.assert_allclose(alike - damping, spread @ found, atol=1e-12)
        p, d = servos.gains[WRIST, 0], servos.gains[WRIST, 2]
        setpoint = servos.setpoint[WRIST]
        pid = p * (setpoint[:, 0] - q) + d * (setpoint[:, 1] - qd)
        at_discs = A.T @ pid
        added = spread @ (np.clip(at_discs + found, -MOST, MOST) - np.clip(at_discs, -MOST, MOST))
        effort, full = pid + added, full + int((np.abs(at_discs) > MOST).any())
        largest = max(largest, float((np.abs(effort) / servos.limit[WRIST]).max()))
        effort = np.clip(effort, -servos.limit[WRIST], servos.limit[WRIST])
        world.step(1)
        np.testing.assert_allclose(servos.setpoint[WRIST, 2], added, atol=1e-10)
    assert largest > 1.0
    assert 0 < full < 300


def test_discs_that_drive_a_joint_without_a_pid_observe_nothing():
    world = World("psm_si")
    arm = world.arm("PSM1")
    arm.servo_jp(arm.joints.setpoints()[:6] + np.array([0.0, 0.0, 0.0, 0.05, 0.05, 0.05]))
    jaw_of(world).servo_jf([-0.05])
    world.step(100)
    state = world.servos.observations()[0, WRIST]
    assert (state[[2, 3]] == 0.0).all()
    assert (np.abs(state[:2]) > 0.0).all()
    assert world.servos.setpoint[6, 2] == -0.05


def test_an_instrument_of_the_si_has_no_observers_on_a_classic_arm():
    world = World("psm")
    world.exchange_tool("PSM1", "LARGE_NEEDLE_DRIVER:420006")
    assert world.servos.disturbance is None


def test_a_gripping_jaw_has_its_discs_at_their_limit_and_turns_no_wrist():
    """Disc 4 has an observer and disc 3 none: together they would turn the wrist yaw."""
    world = World("psm_si")
    world.arm("PSM1")
    jaw_of(world).servo_jp([-0.34])  # the fingers meet at 0
    world.step(1000)
    assert world.servos.read()[2, 6] == pytest.approx(-0.16)
    assert np.abs(wrist_error(world)[:3]).max() < 1e-3
