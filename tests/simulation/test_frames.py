"""What is computed of frames means one thing, in whatever order it is asked for."""

from __future__ import annotations

import numpy as np

from trocar.descriptions.rig_frames import Places
from trocar.simulation import World


def moving_world(skew_overlay, rng) -> World:
    """Return a world of a PSM with general loops, in motion, so that bodies lag behind tips."""
    world = World("psm", calibration=skew_overlay("psm", rng))
    world.arm("PSM1").move_jp([0.3, 0.2, 0.15, 0.5, 0.1, 0.1])
    world.step(60)
    return world


def test_bodies_stay_bodies_when_tips_are_read_after_them(skew_overlay, rng) -> None:
    world = moving_world(skew_overlay, rng)
    bodies = world.frames.bodies()
    before = bodies.xpos.copy()
    tips = world.frames.tips()
    world.frames.public_at("PSM1", world.arm("PSM1").joints.setpoints(), "")
    assert tips is not bodies
    np.testing.assert_array_equal(bodies.xpos, before)
    assert (world.frames.tips().xpos != before).any()


def test_jacobians_do_not_depend_on_what_was_asked_before(skew_overlay, rng) -> None:
    world = moving_world(skew_overlay, rng)
    arm = world.arm("PSM1")
    first = arm.body.jacobian(), arm.spatial.jacobian(), arm.measured_cp().matrix
    world.remote_centres()
    world.snapshot()
    arm.setpoint_cp()
    arm.inverse_kinematics(first[2])
    second = arm.body.jacobian(), arm.spatial.jacobian(), arm.measured_cp().matrix
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_base_frames_are_those_of_the_description_s_own_kinematics() -> None:
    for rig in ("full_cart_mtm", "two_psm_ecm", "psm"):
        world = World(rig, collisions=False)
        places = Places(world.rig, lambda name, w=world: w.arm(name).joints.positions())
        for name in world.arms:
            T, frame = places.base_pose(name, world.reference_arm)
            found, named = world.arm(name).local.base_frame()
            assert named == frame
            np.testing.assert_allclose(found, T, atol=1e-6)  # SUJs under load, loops closed


def test_tips_of_all_arms_at_once_are_those_of_each(skew_overlay, rng) -> None:
    for world in (World("full_cart"), moving_world(skew_overlay, rng)):
        arms = [a for a in world.arms.values() if world.frames.follows(a.name)]
        arms[-1].move_jp(arms[-1].joints.setpoints()[arms[-1].runtime.own] + 0.05)
        world.step(100)
        found = world.frames.tip_poses([arm.name for arm in arms])
        assert found is not None
        for arm in arms:
            np.testing.assert_array_equal(found[arm.name], arm.measured_cp("world").matrix)
