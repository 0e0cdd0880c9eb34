"""A world's cameras are where its arms carry them, and see what a surgeon sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.cameras import MonoCalibration
from trocar.cameras.lens import project
from trocar.descriptions import load_rig
from trocar.descriptions.cameras import load_camera, load_stereo_camera
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.se3 import inverse, transform_points
from trocar.recording.metadata import rig_fingerprint
from trocar.simulation import World


@pytest.fixture(scope="module")
def cart() -> World:
    return World("full_cart", setup_joints="locked")


def scope_tip(world: World) -> np.ndarray:
    """The end of the scope in the world, by the kinematics, which know nothing of the model."""
    return world.reference_pose("ECM") @ world.arm("ECM").local.measured_cp().matrix


def test_a_world_has_the_cameras_of_its_rig(cart: World) -> None:
    found = cart.cameras()
    assert list(found) == [camera.name for camera in load_rig("full_cart").cameras]
    assert found["endoscope"].stereo and not found["room"].stereo
    assert World("psm").cameras() == {}


def test_the_eyes_are_beside_the_end_of_the_scope_and_look_along_it(cart: World) -> None:
    for pose in ("start", "work", "apart"):
        cart.reset(pose=pose)
        scope, tip = cart.camera("endoscope"), scope_tip(cart)
        np.testing.assert_allclose(scope.T_world_camera[:3, 3], tip[:3, 3], atol=1e-9)
        np.testing.assert_allclose(scope.T_world_camera[:3, 2], tip[:3, 2], atol=1e-9)
        left, right = scope.T_world_left, scope.T_world_right
        np.testing.assert_allclose(0.5 * (left + right)[:3, 3], tip[:3, 3], atol=1e-9)
        np.testing.assert_allclose(
            right[:3, 3] - left[:3, 3], 6e-3 * scope.T_world_camera[:3, 0], atol=1e-9
        )


def test_the_surgeons_right_hand_is_on_the_right_and_up_is_up(cart: World) -> None:
    """PSM1 is the right hand's, PSM2 the left's: so they come into the picture."""
    cart.reset(pose="work")
    scope = cart.camera("endoscope")
    T_camera_world = inverse(scope.T_world_camera)
    centres = cart.remote_centres()
    assert (T_camera_world @ [*centres["PSM1"], 1.0])[0] > 0.05
    assert (T_camera_world @ [*centres["PSM2"], 1.0])[0] < -0.05
    up = T_camera_world[:3, 2]
    assert up[1] < 0.0 and abs(up[0]) < abs(up[1])


def test_the_tips_at_work_are_in_the_picture_of_either_eye(cart: World) -> None:
    cart.reset(pose="work")
    scope = cart.camera("endoscope")
    seen: dict[str, list[float]] = {}
    for T_world_eye, eye in zip(scope.T_world_eyes, scope.calibration.eyes, strict=True):
        for name in ("PSM1", "PSM2"):
            tip = cart.reference_pose(name) @ cart.arm(name).local.measured_cp().matrix
            u, v = project(transform_points(inverse(T_world_eye), tip[:3, 3]), eye.K)
            assert 0.0 < u < eye.width and 0.0 < v < eye.height
            seen.setdefault(name, []).append(float(u))
    for left, right in seen.values():
        assert left > right  # what is near lies farther right for the left eye
    assert seen["PSM1"][0] > seen["PSM2"][0]


def test_a_bent_scope_looks_up_or_down(cart: World) -> None:
    cart.reset(pose="work")
    scope = cart.camera("endoscope")
    ahead, down = scope.T_world_camera[:3, 2], scope.T_world_camera[:3, 1]
    for angle, sign in ((np.pi / 6, 1.0), (-np.pi / 6, -1.0)):
        bent = scope.bent(angle).T_world_camera
        assert bent[:3, 2] @ ahead == pytest.approx(np.cos(np.pi / 6))
        assert bent[:3, 2] @ down == pytest.approx(sign * 0.5)
        np.testing.assert_allclose(bent[:3, 0], scope.T_world_camera[:3, 0], atol=1e-12)
        np.testing.assert_allclose(bent[:3, 3], scope.T_world_camera[:3, 3], atol=1e-12)
    with pytest.raises(InputError, match="angle: got 45 deg; allowed: -30, 0, 30 deg"):
        scope.bent(np.pi / 4)
    with pytest.raises(InputError, match="camera room: is no endoscope; only a scope is bent"):
        cart.camera("room").bent(np.pi / 6)


def test_a_camera_is_where_a_snapshot_has_it() -> None:
    world = World("two_psm_ecm")
    first = world.camera("endoscope")
    before = world.snapshot()
    world.arm("ECM").move_jp([0.2, -0.3, 0.1, 0.4])
    world.step(400)
    now = world.camera("endoscope")
    assert now.time == world.time > first.time
    assert np.abs(now.T_world_left - first.T_world_left).max() > 1e-3
    np.testing.assert_allclose(now.at(before).T_world_left, first.T_world_left, atol=1e-12)
    here = first.at(world.snapshot())
    assert here.time == world.time
    np.testing.assert_allclose(here.T_world_right, now.T_world_right, atol=1e-12)


def test_a_camera_of_an_older_build_says_so() -> None:
    world = World("two_psm_ecm")
    camera = world.camera("endoscope")
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:400093")
    with pytest.raises(InputError, match="is of build 1 of the world, the snapshot of 2"):
        camera.at(world.snapshot())
    again = world.camera("endoscope")
    np.testing.assert_allclose(again.T_world_left, camera.T_world_left, atol=1e-9)


def test_other_eyes_take_the_same_place(cart: World) -> None:
    cart.reset(pose="work")
    scope = cart.camera("endoscope")
    wide = scope.seeing(load_stereo_camera("icra2026_1280x800"))
    np.testing.assert_array_equal(wide.T_world_camera, scope.T_world_camera)
    apart = np.linalg.norm(wide.T_world_right[:3, 3] - wide.T_world_left[:3, 3])
    assert apart == pytest.approx(0.02)
    with pytest.raises(InputError, match="camera endoscope: an endoscope has two eyes, not one"):
        scope.seeing(MonoCalibration(load_camera("hd_1280x720").eyes[0]))


def test_an_unknown_camera_lists_the_known_ones(cart: World) -> None:
    with pytest.raises(UnknownNameError, match="unknown camera 'endscope'") as caught:
        cart.camera("endscope")
    assert caught.value.known == ("endoscope", "room")


def test_cameras_change_no_motion_and_no_fingerprint() -> None:
    def end(look: bool) -> np.ndarray:
        world = World("two_psm_ecm")
        world.arm("ECM").move_jp([0.2, -0.3, 0.1, 0.4])
        for _ in range(20):
            world.step(5)
            if look:
                world.cameras()
        return world.arm("ECM").measured_js().position

    np.testing.assert_array_equal(end(look=True), end(look=False))
    rig = load_rig("two_psm_ecm")
    assert rig_fingerprint(rig) == rig_fingerprint(replace(rig, cameras=()))
