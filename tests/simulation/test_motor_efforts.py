"""What the motors are said to exert is what moves the arm."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.simulation import Batch, World
from trocar.simulation.records import Recording

Array = NDArray[np.floating[Any]]

INSERTION = 2
# Moves on the insertion while everything else rests. Friction bends the loops by less.
BALANCE_N = 0.01


def slide(world: World, depth: Array, speed: Array) -> Recording:
    q = np.zeros((len(depth), 7))
    q[:, INSERTION] = depth
    q[:, -1] = 0.5
    v = np.zeros_like(q)
    v[:, INSERTION] = speed
    world.set_state("PSM1", q[0], v[0])
    return world.play({"PSM1": q[1:]}, {"PSM1": v[1:]}, every=1)


@pytest.mark.parametrize("speed", [0.02, 0.1, -0.2])
def test_the_motor_balances_friction_when_the_insertion_slides_evenly(speed: float) -> None:
    world = World("psm", dynamics="cad")
    time = world.timestep * np.arange(500)
    played = slide(world, 0.12 + speed * (time - 0.25), np.full(500, speed))
    friction = world.arm("PSM1").description.friction["identified"]["insertion"]
    expected = friction.coulomb * np.sign(speed) + friction.viscous * speed
    assert played.efforts["PSM1"][-1, INSERTION] == pytest.approx(expected, abs=BALANCE_N)


def test_the_motor_accelerates_what_rides_on_the_insertion() -> None:
    world = World("psm", friction="paper")
    time = world.timestep * np.arange(300)
    acceleration = 3.0
    played = slide(world, 0.05 + 0.5 * acceleration * time**2, acceleration * time)
    arm = world.arm("PSM1").description
    riders = ("insertion", "roll", "wrist_pitch", "finger_left", "finger_right")
    riding = sum(b.mass for b in arm.bodies if b.frame in riders)
    counterweight = sum(b.mass for b in arm.bodies if b.frame == "counterweight")
    felt = riding + 0.6025**2 * counterweight + arm.rotor["insertion"]
    drag = arm.friction["paper"]["insertion"].viscous * acceleration * time[-1]
    expected = felt * acceleration + drag
    assert played.efforts["PSM1"][-1, INSERTION] == pytest.approx(expected, abs=BALANCE_N)


@pytest.mark.parametrize("control", ["dvrk", "paper"])
def test_a_played_row_reads_as_the_arm_does(control: Literal["dvrk", "paper"]) -> None:
    world = World("psm", control=control)
    q = np.tile([0.1, -0.1, 0.13, 0.05, 0.1, 0.1, 0.4], (40, 1))
    played = world.play({"PSM1": q})
    read = world.arm("PSM1").joints.readings()[2]
    np.testing.assert_allclose(played.efforts["PSM1"][-1], read, rtol=0, atol=1e-12)  # rounding


def test_an_effort_beyond_the_motor_reads_as_its_limit() -> None:
    world = World("psm")
    q = np.tile([0.3, 0.0, 0.12, 0.0, 0.0, 0.0, 0.4], (2, 1))
    played = world.play({"PSM1": q}, every=1)
    arm = world.arm("PSM1")
    assert played.efforts["PSM1"][-1, 0] == pytest.approx(arm.joints.effort_limit[0])


def test_a_motor_at_its_limit_is_as_fast_as_its_supply_allows() -> None:
    """Friction is left of stall (1 - speed / no load), whichever way it turns."""
    world = World("psm", dynamics="cad")
    arm = world.arm("PSM1")
    joint, friction = arm.description.joints[3], arm.description.friction["identified"]["roll"]
    for sign in (1.0, -1.0):
        world.reset()
        arm.servo_jf([0.0, 0.0, 0.0, sign * joint.effort_max, 0.0, 0.0])
        world.step(45)
        read = arm.measured_js()
        speed, effort = sign * read.velocity[3], sign * read.effort[3]
        assert effort == pytest.approx(joint.stall * (1.0 - speed / joint.no_load), abs=1e-12)
        assert effort == pytest.approx(friction.coulomb + friction.viscous * speed, abs=1e-3)


def test_a_batch_reads_what_the_supply_leaves_of_efforts() -> None:
    world = World("psm", dynamics="cad")
    batch = Batch(world, 2)
    goal = np.zeros((2, 7))
    goal[:, 2], goal[:, 3], goal[1, 3] = 0.12, 4.0, -4.0
    batch.step(goal, 20)
    read, joint = batch.step(n=1), world.arm("PSM1").description.joints[3]
    speed = np.abs(read.qd[:, 3])
    assert (speed > 55.0).all()
    left = joint.stall * (1.0 - speed / joint.no_load)
    np.testing.assert_allclose(read.effort[:, 3] * np.sign(read.qd[:, 3]), left, atol=1e-12)
