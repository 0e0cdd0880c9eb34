"""Position servos do what PID servos without integral gain do, and run on MuJoCo Warp."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.descriptions.records import RigDescription
from trocar.errors import InputError
from trocar.kinematics.forward import coordinates
from trocar.modeling.build import RigModel, build, gpu_model, position_inputs, preset
from trocar.modeling.options import ModelOptions
from trocar.simulation.trials import paper_sine

#: Both compute in float64; 2.5e-14 was measured.
SAME = 1e-13
#: Physics steps between two set-points.
EVERY = 5


def setpoints(rig: RigDescription, seconds: float) -> np.ndarray:
    """Return the paper's sine with velocities, and efforts beyond the motors' limits, (k, n, 3)."""
    sine = paper_sine(rig, seconds, 0.001 * EVERY)
    count = len(next(iter(sine.positions.values())))
    columns: list[np.ndarray] = []
    for place in rig.arms:
        limit = np.array([joint.effort_max for joint in place.arm.joints])
        phase = np.linspace(0.0, 40.0, count)[:, None] + np.arange(len(limit))
        effort = 1.5 * limit * np.sin(phase) ** 9  # beyond the limit for a fifth of the time
        parts = sine.positions[place.name], sine.velocities[place.name], effort
        columns.append(np.stack(parts, axis=-1))
    return np.concatenate(columns, axis=1)


def pid_model(rig: RigDescription) -> mujoco.MjModel:
    """Return a rig with PID servos and the dVRK's gains."""
    model = build(rig).mj
    for place in rig.arms:
        for joint, gains in preset(place.arm).pid.items():
            servo = model.actuator(f"{place.name}/{joint}").id
            model.actuator_biasprm[servo, 1:3] = -gains.p, -gains.d
            model.actuator_gainprm[servo, 0] = gains.i
    model.actuator_forcerange[model.actuator_ctrlnum == 0] = 0.0  # position servos have no supply
    return model


@pytest.mark.parametrize("name", ["psm", "two_psm_ecm"])
def test_position_servos_move_as_pid_servos_along_the_papers_sine(name):
    rig = load_rig(name)
    model = build(rig, ModelOptions(servo="position"))
    pid = pid_model(rig)
    ours, theirs = mujoco.MjData(model.mj), mujoco.MjData(pid)
    table = setpoints(rig, 4.0)
    assert model.mj.nu == table.shape[1] and pid.nu == 3 * model.mj.nu
    apart, saturated = 0.0, 0
    for row in table:
        ours.ctrl[:], theirs.ctrl[:] = position_inputs(model, row), row.ravel()
        mujoco.mj_step(model.mj, ours, EVERY)
        mujoco.mj_step(pid, theirs, EVERY)
        apart = max(apart, float(np.abs(ours.qpos - theirs.qpos).max()))
        reached = np.abs(ours.actuator_force) >= model.mj.actuator_forcerange[:, 1]
        saturated += int(reached.any())
    assert saturated > len(table) // 10
    assert np.abs(ours.qpos).max() > 0.05
    assert apart < SAME


def test_a_feed_forward_that_is_left_out_is_seen():
    """The agreement is no tautology."""
    rig = load_rig("psm")
    model = build(rig, ModelOptions(servo="position"))
    row = setpoints(rig, 1.0)[50]
    without = row * [1.0, 1.0, 0.0]
    assert np.abs(position_inputs(model, row) - position_inputs(model, without)).max() > 1e-3


def test_the_gains_and_limits_of_position_servos_are_those_of_the_preset():
    rig = load_rig("psm")
    for control in ("dvrk", "paper"):
        model = build(rig, ModelOptions(servo="position", control=control)).mj
        place = rig.arms[0]
        chosen = preset(place.arm, control)
        for joint in place.arm.joints:
            servo = model.actuator(f"{place.name}/{joint.name}")
            gains = chosen.pid[joint.name]
            assert (-servo.biasprm[1], -servo.biasprm[2]) == (gains.p, gains.d)
            limited = chosen.effort_limits or joint.name == "jaw"
            assert bool(model.actuator_forcelimited[servo.id]) == limited


def on_gpu(name: str) -> tuple[RigModel, mujoco.MjModel]:
    model = build(load_rig(name), ModelOptions(servo="position"))
    return model, gpu_model(model)


def test_the_model_for_gpus_is_sparse_above_60_degrees_of_freedom_and_resets_by_itself():
    dense, sparse = mujoco.mjtJacobian.mjJAC_DENSE, mujoco.mjtJacobian.mjJAC_SPARSE
    for name, jacobian in (("psm", dense), ("full_cart", sparse)):
        model, copied = on_gpu(name)
        assert copied.opt.jacobian == int(jacobian)
        assert not copied.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        assert model.mj.opt.jacobian == int(dense)  # what MuJoCo itself steps is untouched
        assert model.mj.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def test_pid_servos_are_rejected_for_gpus():
    with pytest.raises(InputError, match="servo: got 'pid'; allowed on a GPU: 'position'"):
        gpu_model(build(load_rig("psm")))


def at_start(model: RigModel) -> mujoco.MjData:
    """Return a rig at its pose "start", loops closed, with set-points there."""
    data = mujoco.MjData(model.mj)
    start = model.rig.poses["start"]
    for place in model.rig.arms:
        at = coordinates(place.arm.mechanism, start[place.name])
        for frame, value in zip(place.arm.mechanism.frames, at, strict=True):
            if frame.motion != "fixed":
                data.joint(f"{place.name}/{frame.name}").qpos = value
    q = np.concatenate([start[place.name] for place in model.rig.arms])
    data.ctrl[:] = position_inputs(model, np.stack([q, 0.0 * q, 0.0 * q], axis=-1))
    mujoco.mj_forward(model.mj, data)
    return data


#: Loops gape by 0.04 to 0.14 um under Warp, in single precision; 1.6e-6 rad apart was measured. [m]
GAP = 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("name", "steps"), [("psm", 100), ("full_cart", 10)])
def test_loops_stay_closed_in_mujoco_warp(name, steps):
    warp = pytest.importorskip(
        "warp", reason="MuJoCo Warp is not installed: pip install mujoco-warp"
    )
    mjw = pytest.importorskip("mujoco_warp", reason="pip install mujoco-warp")
    warp.config.quiet = True
    model, copied = on_gpu(name)
    data = at_start(model)
    with warp.ScopedDevice("cpu"):
        device = mjw.put_model(copied)
        first = mujoco.MjData(copied)
        first.qpos[:] = data.qpos
        state = mjw.put_data(copied, first, nworld=2, nconmax=64, njmax=512)
        for step in range(steps):
            data.ctrl[:] += 1e-4 * np.sin(0.02 * step)
            state.ctrl.assign(np.tile(data.ctrl.astype(np.float32), (2, 1)))
            mjw.step(device, state)
            mujoco.mj_step(model.mj, data)
        found = state.qpos.numpy()
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_allclose(found[0], data.qpos, atol=1e-5)
    shown = mujoco.MjData(model.mj)
    shown.qpos[:] = found[0]
    mujoco.mj_kinematics(model.mj, shown)
    loops = np.flatnonzero(model.mj.eq_type == int(mujoco.mjtEq.mjEQ_CONNECT))
    ends = model.mj.eq_obj1id[loops], model.mj.eq_obj2id[loops]
    gap = np.linalg.norm(shown.site_xpos[ends[0]] - shown.site_xpos[ends[1]], axis=1)
    assert gap.max() < GAP
