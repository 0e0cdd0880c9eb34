"""Loops in the compiled model: hinges that close them, and the guard of the parallelograms."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.catalogue import DATA
from trocar.errors import DescriptionError
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import gaps, loops_are_parallelograms
from trocar.modeling import naming
from trocar.modeling.build import build, lone_rig
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
    model = build(lone_rig(arm)).mj
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
    model = build(lone_rig(arm)).mj
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
    model = build(lone_rig(arm)).mj
    for frame, ratio in (("counterweight", 0.6025), ("finger_right", -1.0)):
        assert model.equality(naming.scoped("arm", frame)).data[1] == pytest.approx(ratio)


@pytest.fixture
def opened(tmp_path: Path) -> Path:
    """A PSM whose upper long link has come off its pin."""
    text = (DATA / "arms" / "psm.toml").read_text(encoding="utf-8")
    path = tmp_path / "opened.toml"
    path.write_text(text.replace('name = "c2"', 'name = "c2"\nopen = true'), encoding="utf-8")
    return path


def test_an_open_hinge_is_left_out_with_the_guard_and_ties_nothing_instead(opened):
    model = build(lone_rig(load_arm(opened))).mj
    sound = build(lone_rig(load_arm("psm"))).mj
    assert set(equalities(sound)) - set(equalities(model)) == {
        naming.scoped("arm", "c2"),
        naming.guard("arm", "c2"),
    }
    assert set(equalities(model)) <= set(equalities(sound))
    assert (model.nq, model.nbody) == (sound.nq, sound.nbody)


def test_an_open_loop_lets_the_shaft_leave_the_remote_centre_and_a_closed_one_does_not(opened):
    for file, least, most in (("psm", 0.0, 1e-7), (opened, 1e-2, 1.0)):
        world = World(lone_rig(load_arm(file), "PSM1"), dynamics="cad")
        world.step(200)
        health = world.health()
        assert least <= health.rcm_error_m <= most
        assert least <= health.loop_gap_m <= most


def test_what_is_computed_without_simulating_is_the_closed_linkage(opened):
    q = [0.1, 0.4, 0.12, 0.0, 0.2, 0.0, 0.3]
    open_arm, sound = load_arm(opened).mechanism, load_arm("psm").mechanism
    np.testing.assert_array_equal(coordinates(open_arm, q), coordinates(sound, q))
    assert gaps(open_arm, coordinates(open_arm, q)).max() < 1e-9


def test_open_says_what_is_allowed(opened):
    opened.write_text(opened.read_text(encoding="utf-8").replace("open = true", 'open = "yes"'))
    with pytest.raises(DescriptionError, match=r"open: got 'yes'; allowed: true, false"):
        load_arm(opened)
