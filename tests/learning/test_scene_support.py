"""Scenes are said to run where they do."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import pytest

from trocar.descriptions import names
from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.scenes import Scene
from trocar.formats.meshes import obj
from trocar.formats.mjcf import MESH_FOLDER, MJX, mjcf_document
from trocar.learning.scene_support import scene_support, warp_obstacle
from trocar.modeling.build import build
from trocar.modeling.gpu_scene import GpuScene, gpu_scene
from trocar.modeling.options import ModelOptions

SCENES = [load_scene(name) for name in names("scenes")]
ON_WARP = [scene for scene in SCENES if not warp_obstacle(scene)]


def on_gpu(scene: Scene) -> GpuScene:
    locked = {arm: scene.rig.poses["start"][arm] for arm in scene.welded}
    return gpu_scene(build(scene.rig, ModelOptions(servo="position", locked=locked)))


def test_what_runs_on_warp_runs_in_a_batch_too():
    assert len(ON_WARP) >= 16
    for scene in ON_WARP:
        assert scene_support(scene).batch == ""


def test_an_obstacle_says_what_it_is_and_what_is_allowed():
    assert warp_obstacle(load_scene("suturing")) == (
        "has soft tissue (pad); allowed on a GPU: none"
    )
    assert warp_obstacle(load_scene("static-track")) == (
        "its class Track has its own met; allowed on a GPU: those of Task"
    )
    pick = load_scene("needle-pick")
    identified = replace(pick, rig=replace(pick.rig, dynamics="identified"))
    assert "'identified', which need PID servos" in warp_obstacle(identified)
    assert warp_obstacle(pick) == ""


@pytest.mark.slow
@pytest.mark.parametrize("scene", ON_WARP, ids=lambda scene: scene.name)
def test_mujoco_warp_accepts_the_model_of_each_scene_that_runs_there(scene):
    mjw = pytest.importorskip("mujoco_warp", reason="pip install 'trocar[gpu]'")
    warp = pytest.importorskip("warp", reason="pip install 'trocar[gpu]'")
    with warp.ScopedDevice("cpu"):
        assert mjw.put_model(on_gpu(scene).mj).nv == on_gpu(scene).mj.nv


@pytest.mark.parametrize("name", ["peg-transfer", "dynamic-band"])
def test_the_file_for_mjx_has_the_scene_and_only_features_of_mjx(name):
    scene = load_scene(name)
    text, meshes = mjcf_document(scene.rig, MJX)
    assets = {f"{MESH_FOLDER}/{stem}.obj": obj(mesh) for stem, mesh in meshes.items()}
    model = mujoco.MjModel.from_xml_string(text.decode(), assets)
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert model.nflex == 0 and (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).sum() == 1
    touching = model.geom_type[model.geom_contype > 0]
    assert int(mujoco.mjtGeom.mjGEOM_CYLINDER) not in touching.tolist()
    assert model.nu == sum(len(place.arm.joints) for place in scene.rig.arms)
