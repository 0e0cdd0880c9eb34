"""The model of a scene for GPUs: weightless, awake, with a sensor for each finger and object."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError
from trocar.modeling.build import WARP_IMPRATIO, build, position_inputs
from trocar.modeling.gpu_scene import GpuScene, gpu_scene
from trocar.modeling.options import ModelOptions
from trocar.simulation import World

#: Loops at rest and in motion gape by 0.02 um with MuJoCo in double precision. [m]
GAP = 2e-7
#: The servos' springs under a weight would let the tip sink by millimetres. [m]
SUNK = 1e-6


def made(name: str) -> GpuScene:
    scene = load_scene(name)
    locked = {arm: scene.rig.poses["start"][arm] for arm in scene.welded}
    return gpu_scene(build(scene.rig, ModelOptions(servo="position", locked=locked)))


def test_nothing_sleeps_and_friction_yields_as_single_precision_needs_it():
    found = made("needle-pick").mj
    assert found.opt.impratio == WARP_IMPRATIO
    assert not found.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP)


def test_weightless_arms_stay_where_their_set_points_are_with_loops_closed():
    found, scene = made("bi-peg-transfer"), load_scene("bi-peg-transfer")
    world = World(scene.rig, welded=scene.welded)
    data = mujoco.MjData(found.mj)
    data.qpos[:] = world.mj_data.qpos
    q = found.model.joints.drive @ data.qpos
    data.ctrl[:] = position_inputs(found.model, np.stack([q, 0.0 * q, 0.0 * q], axis=-1))
    mujoco.mj_kinematics(found.mj, data)
    tip = found.mj.site("PSM1/site/tip").id
    before = data.site_xpos[tip].copy()
    mujoco.mj_step(found.mj, data, 300)
    assert np.linalg.norm(data.site_xpos[tip] - before) < SUNK
    apart = data.site_xpos[found.loops[:, 0]] - data.site_xpos[found.loops[:, 1]]
    assert 0.0 < np.linalg.norm(apart, axis=1).max() < GAP


def test_fingers_feel_the_object_that_they_press():
    found, scene = made("needle-pick"), load_scene("needle-pick")
    world = World(scene.rig, welded=scene.welded)
    data = mujoco.MjData(found.mj)
    data.qpos[:] = world.mj_data.qpos
    mujoco.mj_forward(found.mj, data)
    addresses = found.touch["PSM1"]
    assert addresses.shape == (2, 1)
    columns = addresses[..., None] + np.arange(3)
    assert not data.sensordata[columns].any()
    fingers = world.arms["PSM1"].description.fingers
    at, body = found.objects["needle"], found.mj.body(f"PSM1/{fingers[0]}").id
    solid = np.flatnonzero((found.mj.geom_bodyid == body) & (found.mj.geom_contype > 0))
    across = data.body("needle").xmat.reshape(3, 3)[:, 1]  # to the middle of the arc, 10 mm away
    data.qpos[at : at + 3] = data.geom_xpos[solid].mean(axis=0) - 0.01 * across
    mujoco.mj_forward(found.mj, data)
    touching = {
        tuple(sorted(found.mj.geom_bodyid[c.geom].tolist())) for c in data.contact if c.dist < 0.0
    }
    pressed = np.linalg.norm(data.sensordata[columns], axis=-1)[:, 0] > 0.0
    needle = found.mj.body("needle").id
    for name, feels in zip(fingers, pressed, strict=True):
        pair = tuple(sorted((needle, found.mj.body(f"PSM1/{name}").id)))
        assert feels == (pair in touching)
    assert pressed.any()


def test_shapes_with_a_friction_of_their_own_have_pairs_with_the_pads_as_with_pid_servos():
    scene = load_scene("dynamic-push")
    pid, ours = build(scene.rig).mj, made("dynamic-push").mj
    assert ours.npair == pid.npair > 0
    np.testing.assert_array_equal(ours.pair_friction, pid.pair_friction)


def test_objects_that_are_not_free_are_rejected():
    with pytest.raises(InputError, match="got pendulum; allowed on a GPU: free bodies"):
        made("dynamic-pendulum")
    with pytest.raises(InputError, match="servo: got 'pid'; allowed on a GPU: 'position'"):
        gpu_scene(build(load_scene("needle-pick").rig))
