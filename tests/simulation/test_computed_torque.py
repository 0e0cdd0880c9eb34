"""Computed torque: joints follow their set-points, and their errors decay apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar import Batch, World

Array = NDArray[np.float64]
MIDDLE = np.array([0.1, -0.1, 0.12, 0.2, 0.1, 0.1])
SIZE = np.array([0.3, 0.3, 0.03, 0.4, 0.4, 0.4])
RATE = np.array([4.0, 5.0, 4.5, 6.0, 5.5, 4.2])


def tracking(computed: bool) -> Array:
    """Return the RMS errors of the joints along sines, (6,) [rad or m]."""
    world = World("psm", calibration="psm", collisions=False)
    arm = world.arm("PSM1")
    world.set_state("PSM1", np.append(MIDDLE, 0.5), np.append(SIZE * RATE, 0.0))
    arm.joints.use_computed_torque(computed)
    errors: list[Array] = []
    for _ in range(1500):
        at = RATE * (world.time + world.timestep)
        arm.servo_jp(MIDDLE + SIZE * np.sin(at), SIZE * RATE * np.cos(at))
        world.step()
        errors.append(arm.joints.positions()[:6] - MIDDLE - SIZE * np.sin(at))
    return np.sqrt(np.mean(np.square(errors[500:]), axis=0))


def test_joints_follow_their_set_points_better_than_by_their_servos_alone() -> None:
    computed, plain = tracking(True), tracking(False)
    assert (computed < 0.25 * plain).all()
    assert computed[2] < 2e-4  # the slide [m]


def test_an_error_of_one_joint_moves_no_other() -> None:
    moved: dict[bool, float] = {}
    for computed in (True, False):
        world = World("psm", friction="paper", collisions=False)
        arm = world.arm("PSM1")
        world.set_state("PSM1", np.array([0.0, -0.3, 0.12, 0.3, 0.5, 0.4, 0.5]))
        arm.joints.use_computed_torque(computed)
        world.step(300)
        before = arm.joints.positions()
        arm.servo_jp(before[:6] + 0.05 * np.eye(6)[1])
        most = np.zeros(7)
        for _ in range(100):
            world.step(2)
            most = np.maximum(most, np.abs(arm.joints.positions() - before))
        moved[computed] = float(most[2])
        assert most[1] > 0.045
    assert moved[True] < 0.3 * moved[False]


def test_saved_states_and_batches_have_computed_torque() -> None:
    first, second = World("psm", calibration="psm"), World("psm", calibration="psm")
    first.arm("PSM1").joints.use_computed_torque(True)
    goal = np.array([0.1, 0.2, 0.12, 0.0, 0.3, 0.1, 0.2])
    first.arm("PSM1").servo_jp(goal[:6])
    first.step(33)
    second.load(first.save())
    assert second.arm("PSM1").joints.computed_torque
    batch = Batch(first, 2, threads=1)
    for world in (first, second):
        arm = world.arm("PSM1")
        arm.servo_jp(-goal[:6])
        assert arm.jaw is not None
        arm.jaw.servo_jp(goal[6:])
        world.step(47)
    assert np.array_equal(first.save().row, second.save().row)
    fresh = World("psm", calibration="psm")
    fresh.arm("PSM1").joints.use_computed_torque(True)
    batch = Batch(fresh, 2, threads=1)
    batch.step(np.stack([goal, 0.5 * goal]), n=47)
    arm = fresh.arm("PSM1")
    arm.servo_jp(goal[:6])
    assert arm.jaw is not None
    arm.jaw.servo_jp(goal[6:])
    fresh.step(47)
    assert np.array_equal(batch.rows[0], fresh.save().row)


def test_switched_off_the_servos_are_alone_again() -> None:
    world = World("psm", calibration="psm")
    arm = world.arm("PSM1")
    rest = world.save()
    arm.joints.use_computed_torque(True)
    arm.joints.use_computed_torque(False)
    world.step(50)
    other = World("psm", calibration="psm")
    other.load(rest)
    other.step(50)
    assert np.array_equal(world.save().row, other.save().row)


def test_free_objects_in_the_rig_leave_the_arms_computed_torque_alone() -> None:
    world = World("pegs")
    arm = world.arm("PSM1")
    arm.joints.use_computed_torque(True)
    before = arm.measured_js().position
    world.step(200)
    assert np.abs(arm.measured_js().position - before).max() < 1e-3
