"""Readings of a rig agree with those of each arm and object."""

from __future__ import annotations

import numpy as np
import pytest

from trocar import load_scene
from trocar.simulation import World
from trocar.simulation.objects import Objects
from trocar.simulation.rig_readings import RigReadings
from trocar.tasks import make_task


def check(readings: RigReadings, world: World) -> None:
    """Compare readings with the readings of each arm and object, to the last bit."""
    expected = world.part(Objects).states()
    assert readings.objects.names == expected.names
    for mine, its in zip(readings.objects[1:], expected[1:], strict=True):
        np.testing.assert_array_equal(mine, its)
    assert set(readings.tips) == set(readings.joints)
    for name, tip in readings.tips.items():
        arm = world.arms[name]
        np.testing.assert_array_equal(tip, arm.measured_cp("world").matrix)
        np.testing.assert_array_equal(readings.joints[name], arm.joints.positions())


def moved(world: World, arm: str) -> None:
    q = world.arms[arm].joints.setpoints()[world.arms[arm].runtime.own]
    world.arms[arm].move_jp(q + 0.03)
    world.step(100)


@pytest.mark.parametrize("kind", ["scene", "jointed objects", "errors", "skew", "welded"])
def test_readings_are_what_arms_and_objects_report(kind: str, skew_overlay, rng) -> None:
    made = {
        "scene": lambda: World(load_scene("needle-pick").rig),
        "jointed objects": lambda: World(load_scene("dynamic-pendulum").rig),
        "errors": lambda: World(load_scene("needle-pick").rig, errors="lab", seed=1),
        "skew": lambda: World("psm", calibration=skew_overlay("psm", rng)),
        "welded": lambda: World("two_psm_ecm", welded=("PSM2",)),
    }
    world = made[kind]()
    readings = RigReadings(world, [name for name in world.arms if name.startswith("PSM")])
    moved(world, "PSM1")
    readings.read()
    check(readings, world)


def test_readings_are_renewed_when_something_moved_and_only_then() -> None:
    world = World(load_scene("needle-pick").rig)
    readings, arm = RigReadings(world, ["PSM1"]), world.arms["PSM1"]
    readings.renew()
    first = readings.objects
    q = arm.joints.setpoints()
    arm.servo_jp(q[:6])
    readings.renew()  # a verb may have moved something
    second = readings.objects
    assert second is not first
    assert arm.runtime.control.stream(q.tolist(), [0.0] * 7)
    readings.renew()
    assert readings.objects is second
    world.step()
    readings.renew()
    check(readings, world)
    world.objects["needle"].set_cp(world.objects["needle"].measured_cp().matrix)
    readings.renew()
    check(readings, world)


def test_readings_go_on_in_the_model_of_another_tool() -> None:
    world = World(load_scene("needle-pick").rig)
    readings = RigReadings(world, ["PSM1"])
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    moved(world, "PSM1")
    readings.renew()
    check(readings, world)


@pytest.mark.parametrize("scene", ["needle-pick", "bi-peg-transfer"])
def test_no_force_acts_on_arms_that_touch_nothing(scene: str) -> None:
    task = make_task(scene)
    readings, touched = RigReadings(task.world, task.arms), []
    readings.read()
    for action in task.policy():
        if task.done or len(touched) >= 150:
            break
        task.command(action)
        readings.renew()
        touched.append(readings.touching())
        if not touched[-1]:
            forces = task.world.contact_forces()
            assert not any(forces[name].any() for name in task.arms)
    assert True in touched
    assert False in touched
