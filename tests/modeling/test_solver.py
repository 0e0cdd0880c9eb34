"""The solver's settings are those that were measured, and why the Jacobian is dense."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.modeling.build import build
from trocar.modeling.options import ModelOptions
from trocar.simulation import World

#: MuJoCo's automatic choice turns sparse here. Source: MuJoCo, mjJAC_AUTO.
SPARSE_FROM = 60


@pytest.mark.parametrize("rig", ["psm", "full_cart"])
def test_settings_are_the_measured_ones(rig):
    """Source: measured on these arms, docs/simulation.md."""
    option = build(load_rig(rig)).mj.opt
    assert option.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    assert option.solver == mujoco.mjtSolver.mjSOL_NEWTON
    assert option.jacobian == mujoco.mjtJacobian.mjJAC_DENSE
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert option.impratio == 1000.0
    assert option.timestep == 0.001
    np.testing.assert_array_equal(option.gravity, [0.0, 0.0, -9.81])


@pytest.mark.parametrize("timestep", [0.0005, 0.001, 0.002])
def test_the_timestep_is_the_one_that_was_asked_for(timestep):
    world = World("psm", timestep_s=timestep)
    assert world.mj_model.opt.timestep == world.timestep == timestep
    world.step(round(0.1 / timestep))
    assert world.time == pytest.approx(0.1)
    assert world.health().loop_gap_m < 1e-6


def test_the_cart_stays_finite_with_the_dense_jacobian():
    world = World("full_cart")
    assert world.mj_model.nv >= SPARSE_FROM
    assert not mujoco.mj_isSparse(world.mj_model)
    world.step(50)
    assert np.isfinite(world.mj_data.qpos).all()
    assert world.health().branch_ok
    assert world.health().loop_gap_m < 1e-7


def test_the_sparse_jacobian_of_this_mujoco_is_the_reason(tmp_path, monkeypatch):
    """A cart that rests with a dense Jacobian is thrown about by Newton on a sparse one.

    Source: google-deepmind/mujoco issue 3767.
    """
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log of its own where it runs
    fastest = {}
    for kind, jacobian in (
        ("DENSE", mujoco.mjtJacobian.mjJAC_DENSE),
        ("SPARSE", mujoco.mjtJacobian.mjJAC_SPARSE),
    ):
        world = World("full_cart")
        world.mj_model.opt.jacobian = jacobian
        assert mujoco.mj_isSparse(world.mj_model) == (kind == "SPARSE")
        mujoco.mj_step(world.mj_model, world.mj_data, nstep=100)
        fastest[kind] = np.abs(world.mj_data.qvel).max()
    assert fastest["DENSE"] < 1e-3
    if fastest["SPARSE"] < 1e-2:
        pytest.skip(f"MuJoCo {mujoco.__version__} keeps this chain with a sparse Jacobian too")
    assert not fastest["SPARSE"] < 100.0 * fastest["DENSE"]  # or no number at all


def test_options_reach_the_model():
    rig = load_rig("psm")
    model = build(rig, ModelOptions(timestep=0.002, collisions=False)).mj
    assert model.opt.timestep == 0.002
    assert model.ngeom == 0
    drawn = build(rig, ModelOptions(decoration=True)).mj
    shapes = [s for a in rig.arms for b in a.arm.bodies for s in b.shapes]
    shapes += [s for prop in rig.props for s in prop.shapes]
    assert drawn.ngeom == sum(s.visible or s.collide for s in shapes)
