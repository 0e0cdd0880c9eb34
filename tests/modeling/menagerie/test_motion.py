"""The files move in plain MuJoCo: as `World` does, under random control, and in other scenes."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from trocar.modeling.menagerie import MJX, PID, POSITION, Variant, scene_document
from trocar.simulation import World
from trocar.simulation.trajectories import paper_sine

from .conftest import compiled, find, written
from .shake import busy_scene, shake, twice

#: Both compute the same in float64; 1e-14 was measured, and 1e-9 is what was asked for.
SAME = 1e-9
#: A loop that holds gapes by a micrometre at the 150 rad/s of random control, a torn one by
#: millimetres [m]. Under `implicitfast` they yield more (docs/simulation.md).
TORN, TORN_MJX = 1e-5, 1e-3
#: What MuJoCo writes, and reads, of a servo of the simulation: position, velocity, effort.
INPUTS = 3


def moved_beside(
    world: World, model: mujoco.MjModel, told: Callable[[np.ndarray], np.ndarray], velocities: bool
) -> float:
    """Drive a world and a file along the test sine; return how far they come apart.

    Args:
        world: the simulation
        model: the file
        told: `ctrl` of the file from (n, 3) inputs of the world's servos
        velocities: whether set-points have velocities
    """
    sine = paper_sine(world.rig, 10.0, 0.005)
    for arm, q in sine.start.items():
        world.set_state(arm, q)
    data = mujoco.MjData(model)
    data.qpos[:] = world._data.qpos
    apart = [0.0]

    def step_both(ours: mujoco.MjModel, state: mujoco.MjData, count: int) -> None:
        data.ctrl[:] = told(state.ctrl.reshape(-1, INPUTS))
        mujoco.mj_step(model, data, nstep=count)
        mujoco.mj_step(ours, state, nstep=count)
        apart.append(float(np.abs(data.qpos - state.qpos).max()))

    world._mj_step = step_both
    start = world._data.qpos.copy()
    world.play(sine.positions, sine.velocities if velocities else None, every=5, record=False)
    assert len(apart) > 2000 and data.time == pytest.approx(10.0)
    assert np.isfinite(data.qpos).all() and np.abs(start).sum() > 0.0
    return max(apart)


@pytest.mark.parametrize(
    "rig", ["psm", "ecm", "mtm", pytest.param("full_cart", marks=pytest.mark.slow)]
)
def test_the_file_with_the_simulations_servos_moves_as_the_simulation(rig):
    """Gravity, friction, loops, brakes and servos are the same; gravity compensation is fed in."""
    world = World(rig)
    model = compiled(world.rig, PID)
    assert moved_beside(world, model, lambda inputs: inputs.ravel(), velocities=True) < SAME


@pytest.mark.parametrize("rig", ["psm", "ecm", "mtm", "suj_two_psm_ecm"])
def test_the_file_that_takes_positions_moves_as_the_simulation_does_without_weight(rig):
    world = World(rig)
    world._model.opt.gravity[:] = 0.0
    world._servos.balanced[:] = 0.0
    for arm in world.arms.values():
        if arm.type == "SUJ":
            arm.release_brakes()
    model = compiled(world.rig)
    joints = [joint for arm in world.rig.arms for joint in arm.arm.joints]
    column = np.array([0 if joint.spring is None else 2 for joint in joints])
    rows = np.arange(len(joints))
    assert moved_beside(world, model, lambda inputs: inputs[rows, column], velocities=False) < SAME


def test_a_friction_that_differs_by_a_thousandth_is_seen():
    """The agreement is no tautology."""
    world = World("psm")
    text, meshes = written(world.rig, PID)
    changed = text.replace('frictionloss="0.05"', 'frictionloss="0.05005"')
    assert changed != text
    model = mujoco.MjModel.from_xml_string(changed, meshes)
    assert moved_beside(world, model, lambda inputs: inputs.ravel(), velocities=True) > 1e-7


def scene(name: str, variant: Variant = POSITION) -> mujoco.MjModel:
    """Return a lone arm on its floor."""
    rig = find(name)
    text, meshes = written(rig, variant)
    files = {f"{name}{variant.suffix}.xml": text.encode(), **meshes}
    return mujoco.MjModel.from_xml_string(scene_document(rig, variant).decode(), files)


@pytest.mark.parametrize("variant", [POSITION, MJX], ids=["position", "mjx"])
@pytest.mark.parametrize("name", ["psm", "ecm", "mtml", "suj_psm1"])
def test_random_control_breaks_no_loop_and_raises_no_warning(name, variant, rng, complaints):
    assert shake(scene(name, variant), 4.0, rng) < (TORN if variant is POSITION else TORN_MJX)
    assert not complaints


@pytest.mark.slow
@pytest.mark.parametrize("name", ["psm", "ecm", "mtml"])
def test_a_minute_of_random_control_raises_no_warning(name, rng, complaints):
    assert shake(scene(name), 60.0, rng) < TORN
    assert not complaints


def spec_of(name: str) -> mujoco.MjSpec:
    text, meshes = written(find(name))
    return mujoco.MjSpec.from_string(text, assets=meshes)


@pytest.mark.parametrize(
    ("name", "seconds"),
    [("psm", 2.0), ("ecm", 2.0), pytest.param("psm", 60.0, marks=pytest.mark.slow)],
)
def test_two_arms_work_in_a_large_scene_that_took_over_the_option_block(
    name, seconds, rng, complaints
):
    model = twice(lambda: spec_of(name), busy_scene(spec_of(name)))
    assert model.nv > 60
    assert {model.key(k).name for k in range(model.nkey)} == {"left_home", "right_home"}
    assert shake(model, seconds, rng) < TORN
    assert not complaints


def test_a_scene_that_keeps_its_own_option_block_tears_the_loops(rng, tmp_path, monkeypatch):
    """That is why the README says what must be copied."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log of its own where it runs
    with pytest.warns(UserWarning, match="integrator: parent has"):
        model = twice(lambda: spec_of("psm"), busy_scene(None))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    gap = 0.0
    for step in range(300):
        if step % 50 == 0:
            data.ctrl[:] = rng.uniform(*model.actuator_ctrlrange.T)
        mujoco.mj_step(model, data)
        apart = data.site("left_c2_a").xpos - data.site("left_c2_b").xpos
        gap = max(gap, float(np.linalg.norm(apart)))
    assert not gap < TORN  # or no number at all
