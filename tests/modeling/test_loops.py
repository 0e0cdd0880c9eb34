"""Loops in the compiled model: hinges that close them, and the guard of the parallelograms."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.catalogue import DATA
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import gaps, loops_are_parallelograms
from trocar.modeling import naming
from trocar.modeling.mjcf import lone_rig, rig_spec
from trocar.simulation import World


@pytest.fixture
def perturbed(tmp_path: Path) -> Path:
    """A PSM whose pitch_bottom hinge sits half a millimetre off: no parallelogram."""
    text = (DATA / "arms" / "psm.toml").read_text(encoding="utf-8")
    assert text.count("a_mm = 516.0") == 1
    path = tmp_path / "my_psm.toml"
    path.write_text(text.replace("a_mm = 516.0", "a_mm = 516.5"), encoding="utf-8")
    return path


def equalities(model: mujoco.MjModel) -> list[str]:
    return [model.equality(k).name for k in range(model.neq)]


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_parallelograms_have_a_connect_each_and_one_guard(name):
    arm = load_arm(name)
    model = rig_spec(lone_rig(arm)).compile()
    for closure in arm.mechanism.closures:
        connect = model.equality(naming.scoped("arm", closure.name))
        assert connect.type == mujoco.mjtEq.mjEQ_CONNECT
    guards = [n for n in equalities(model) if "/guard/" in n]
    assert len(guards) == 1
    guard = model.equality(guards[0])
    assert guard.type == mujoco.mjtEq.mjEQ_JOINT
    np.testing.assert_array_equal(guard.data[:5], [0, 1, 0, 0, 0])


def test_a_loop_that_is_no_parallelogram_closes_by_newton_and_has_no_guard(perturbed):
    arm = load_arm(perturbed)
    mechanism = arm.mechanism
    assert not loops_are_parallelograms(mechanism)
    q = np.zeros((9, 7))
    q[:, 1] = np.linspace(mechanism.lower[1], mechanism.upper[1], 9)
    found = coordinates(mechanism, q)
    assert gaps(mechanism, found).max() < 1e-9
    ends = [mechanism.frame_index[n] for n in ("pitch_end", "pitch_back")]
    assert np.abs(found[:, ends[0]] - found[:, ends[1]]).max() > 1e-4  # a guard would fight
    model = rig_spec(lone_rig(arm)).compile()
    assert not [n for n in equalities(model) if "/guard/" in n]


def test_a_loop_that_is_no_parallelogram_moves_on_its_branch(perturbed):
    arm = load_arm(perturbed)
    world = World(lone_rig(arm))
    start = np.array([0, arm.mechanism.lower[1], 0.12, 0, 0, 0, 0])
    world.set_state("arm", start)
    assert world.health().loop_gap_m < 1e-9
    goal = start[:6].copy()
    goal[1] = arm.mechanism.upper[1]
    motion = world.arm("arm").move_jp(goal)
    worst = 0.0
    while not motion.done:
        world.step(50)
        health = world.health()
        assert health.branch_ok
        worst = max(worst, health.loop_gap_m)
    assert worst < 1e-7
    assert world.arm("arm").measured_js().position[1] == pytest.approx(goal[1], abs=0.02)


def test_every_moving_frame_that_no_motor_and_no_loop_moves_is_coupled():
    arm = load_arm("psm")
    model = rig_spec(lone_rig(arm)).compile()
    for frame, ratio in (("counterweight", 0.6025), ("finger_right", -1.0)):
        assert model.equality(naming.scoped("arm", frame)).data[1] == pytest.approx(ratio)
