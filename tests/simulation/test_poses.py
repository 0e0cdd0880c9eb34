"""measured_cp and local/measured_cp: relative to what, and equal to where bodies are."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.errors import InputError
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import pose
from trocar.simulation import World


def body_pose(world: World, name: str) -> np.ndarray:
    """Pose of a body in the world, from the physics state."""
    mujoco.mj_kinematics(world.mj_model, world.mj_data)
    body = world.mj_data.body(name)
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = body.xmat.reshape(3, 3), body.xpos
    return found


def tip_of_psm(world: World, name: str) -> np.ndarray:
    """The tip by the bodies: the wrist's yaw link, and the fixed rotation of the tip on it."""
    tip = world.rig.arm(name).arm.mechanism.frame("tip")
    return body_pose(world, f"{name}/wrist_yaw") @ tip.before


@pytest.mark.parametrize("rig", ["two_psm_ecm", "suj_two_psm_ecm"])
def test_a_psm_is_seen_from_the_scope_as_the_bodies_stand(rig):
    world = World(rig, tip_load_n=3.0)
    world.arm("ECM").move_jp([0.2, -0.3, 0.05, 0.4])
    world.step(700)
    scope = body_pose(world, "ECM/roll")
    arm = world.rig.arm("ECM").arm.mechanism
    q = world.arm("ECM").joints.readings()[0]
    tip = scope @ pose(arm, q, arm.tip, "roll")
    for name in ("PSM1", "PSM2"):
        seen = world.arm(name).measured_cp()
        assert seen.frame_id == "ECM"
        # Loop errors reach 0.1 um at 0.5 m from the remote centre.
        np.testing.assert_allclose(seen.matrix, inverse(tip) @ tip_of_psm(world, name), atol=2e-6)


@pytest.mark.parametrize("mover", ["ECM", "SUJ_PSM1", "SUJ_ECM"])
def test_a_psm_seen_from_the_scope_moves_when_either_is_carried(mover):
    world = World("suj_two_psm_ecm", collisions=False)
    psm = world.arm("PSM1")
    seen, local = psm.measured_cp().matrix, psm.local.measured_cp().matrix
    if mover.startswith("SUJ"):
        world.arm(mover).brakes.release()
    q = world.arm(mover).measured_js().position
    q[1] += 0.1
    world.arm(mover).joints.set_mode("set")
    world.arm(mover).servo_jp(q)
    world.step(5)
    assert np.abs(psm.measured_cp().matrix - seen)[:3, 3].max() > 0.01
    np.testing.assert_allclose(psm.local.measured_cp().matrix, local, atol=1e-4)


def test_without_a_scope_a_psm_is_seen_from_its_own_remote_centre():
    world = World("psm")
    arm = world.arm("PSM1")
    arm.move_jp([0.3, 0.2, 0.15, 0.4, 0.2, 0.1])
    world.step(400)
    seen, local = arm.measured_cp(), arm.local.measured_cp()
    np.testing.assert_array_equal(seen.matrix, local.matrix)
    assert (seen.frame_id, local.frame_id) == ("PSM1_base", "rcm")
    assert seen.time == pytest.approx(0.4)
    mechanism = world.rig.arm("PSM1").arm.mechanism
    here = pose(mechanism, arm.joints.readings()[0])
    np.testing.assert_allclose(local.matrix, here, rtol=0.0, atol=1e-14)  # rounding


def test_the_cart_is_the_frame_of_setup_joints_and_of_the_scope_that_they_carry():
    """The cart's own frame, which stands 167 mm above the floor."""
    world = World("full_cart")
    setup, scope = world.arm("SUJ_ECM"), world.arm("ECM")
    assert setup.measured_cp().frame_id == scope.measured_cp().frame_id == "Cart"
    np.testing.assert_array_equal(setup.measured_cp().matrix, setup.local.measured_cp().matrix)
    cart = world.reference_pose("SUJ_ECM")
    assert cart[2, 3] == pytest.approx(0.167458)
    there = world.reference_pose("ECM") @ scope.local.measured_cp().matrix
    np.testing.assert_allclose(cart @ scope.measured_cp().matrix, there, atol=1e-12)
    lone = World("ecm").arm("ECM").measured_cp()
    assert lone.frame_id == "ECM_base"


def test_set_points_are_seen_in_the_same_frame():
    world = World("two_psm_ecm")
    arm = world.arm("PSM1")
    goal = np.array([0.2, 0.1, 0.15, 0.3, 0.1, -0.1])
    arm.servo_jp(goal)
    expected = arm.setpoint_cp()
    assert expected.frame_id == arm.measured_cp().frame_id == "ECM"
    world.step(3000)
    np.testing.assert_allclose(arm.measured_cp().matrix, expected.matrix, atol=5e-3)
    base, _ = world.base_pose("PSM1")
    mechanism = world.rig.arm("PSM1").arm.mechanism
    np.testing.assert_allclose(
        expected.matrix, base @ pose(mechanism, np.append(goal, 0.0)), atol=1e-4
    )


def test_lone_arms_have_their_remote_centre_where_the_rig_says():
    for rig, name in (("psm", "PSM1"), ("ecm", "ECM")):
        np.testing.assert_allclose(World(rig).remote_centres()[name], [0.0, 0.0, 0.3], atol=1e-12)


def test_a_reference_arm_that_no_setup_joints_are_made_for_is_rejected():
    for rig, allowed in (("full_cart", "PSM1, PSM2, PSM3, ECM"), ("psm", "none, for the rig has")):
        with pytest.raises(InputError, match=f"reference arm: got 'PSM4'; allowed: {allowed}"):
            World(rig).set_reference_arm("PSM4")


def test_a_tip_s_place_in_the_world_is_where_its_body_is() -> None:
    world = World("suj_two_psm_ecm")
    for name in ("PSM1", "PSM2"):
        T = world.arm(name).measured_cp("world")
        assert T.frame_id == "world" and T.time == world.time
        assert np.abs(T.matrix - tip_of_psm(world, name)).max() < 1e-6


def test_the_tool_of_the_lone_psm_reaches_its_table() -> None:
    world = World("psm")
    arm = world.arm("PSM1")
    (top,) = (prop.pose[2, 3] for prop in world.rig.props if prop.name == "table")
    T = arm.measured_cp().matrix
    for x in (-0.03, 0.0, 0.03):
        T[:3, 3] = [x, 0.0, top - world.remote_centres()["PSM1"][2]]
        q = arm.inverse_kinematics(T)
        assert (arm.joints.lower[:6] <= q).all() and (q <= arm.joints.upper[:6]).all()
        world.set_state("PSM1", np.append(q, 0.0))
        assert arm.measured_cp("world").matrix[:3, 3] == pytest.approx([x, 0.0, top], abs=1e-6)


def test_worlds_arms_jaws_and_moves_have_readable_representations() -> None:
    world = World("psm")
    arm = world.arm("PSM1")
    assert repr(world) == "<World 'psm' at 0.000 s: PSM1>"
    assert repr(arm).startswith(
        "<Arm 'PSM1': PSM with LARGE_NEEDLE_DRIVER:400006, ENABLED; yaw 0, "
    )
    assert "insertion 0.12" in repr(arm)
    assert repr(arm.jaw) == "<Jaw of 'PSM1': 0.0000 rad, set-point 0.0000 rad>"
    motion = arm.move_jp([0.1, 0.0, 0.12, 0.0, 0.0, 0.0])
    assert repr(motion) == "<Motion to (0.1, 0, 0.12, 0, 0, 0): under way>"
    motion.wait()
    assert repr(motion).endswith("goal reached>") and "not" not in repr(motion)
    assert repr(arm.move_jp([0.1])).startswith("<Motion rejected: move_jp: got positions of shape")
    world.exchange_tool("PSM1", "none")
    assert "with" not in repr(arm) and arm.jaw is None
