"""Loops hold while the arm moves under load."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.simulation.pitching import PITCH, whole_pitch
from trocar.descriptions import load_arm
from trocar.kinematics.loops import gaps, residual_jacobian, residuals
from trocar.modeling.build import lone_rig
from trocar.simulation import World
from trocar.simulation.health import arm_health

#: Source: the goals that `trocar bench` prints beside its figures.
GAP_M = 0.1e-6
RCM_M = 3e-6


@pytest.mark.parametrize(("rig", "name"), [("psm", "PSM1"), ("ecm", "ECM")])
def test_loops_and_remote_centre_hold_under_ten_newtons_over_the_whole_pitch(rig, name):
    world = World(rig, tip_load_n=10.0)
    q, v = whole_pitch(world, name, 4.0)
    world.set_state(name, q[0], v[0])
    played = world.play({name: q}, {name: v}, every=1)
    arm = world.rig.arm(name).arm
    reached = played.positions[name][:, PITCH]
    assert reached.min() < arm.mechanism.lower[PITCH] + 0.02
    assert reached.max() > arm.mechanism.upper[PITCH] - 0.02
    health = arm_health(arm, played.coordinates[name])
    assert health.loop_gap_m <= GAP_M
    assert health.rcm_error_m <= RCM_M
    assert health.branch_ok
    assert health.flattening_margin_rad >= 0.2


def test_the_load_is_felt():
    """Without it the pitch stands elsewhere: the loop figures are not those of an idle arm."""
    idle, loaded = World("psm"), World("psm", tip_load_n=10.0)
    for world in (idle, loaded):
        world.step(500)
    moved = loaded.arm("PSM1").joints.readings()[0] - idle.arm("PSM1").joints.readings()[0]
    assert np.abs(moved[:2]).max() > 5e-3


@pytest.mark.parametrize(("rig", "name"), [("psm", "PSM1"), ("ecm", "ECM")])
def test_the_constraints_residual_is_the_analytic_gap(rig, name):
    """What the solver calls a violation is what health measures, in the world's axes."""
    world = World(rig, tip_load_n=10.0)
    world.arm(name).move_jp(world.arm(name).measured_js().position + 0.1)
    world.step(300)
    model, data = world.mj_model, world.mj_data
    health = world.arm(name).joints.health()
    mujoco.mj_forward(model, data)
    for closure in world.rig.arm(name).arm.mechanism.closures:
        a, b = (data.site(f"{name}/{closure.name}/{side}").xpos for side in "ab")
        residual = np.linalg.norm(a - b)
        rows = data.efc_id[: data.nefc] == model.equality(f"{name}/{closure.name}").id
        rows &= data.efc_type[: data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        assert np.linalg.norm(data.efc_pos[: data.nefc][rows]) == pytest.approx(residual, abs=1e-15)
        assert residual <= health.loop_gap_m + 1e-15
    found = gaps(world.rig.arm(name).arm.mechanism, world.arm(name).joints.frame_coordinates())
    worst = max(
        np.linalg.norm(data.site(f"{name}/{c.name}/a").xpos - data.site(f"{name}/{c.name}/b").xpos)
        for c in world.rig.arm(name).arm.mechanism.closures
    )
    assert found.max() == pytest.approx(worst, abs=1e-12)
    assert found.max() > 0.0


def test_a_folded_loop_is_told_from_a_good_one():
    """A closed loop on its other branch has no gap; only the branch tells."""
    arm = load_arm("psm")
    mechanism = arm.mechanism
    good = np.zeros(len(mechanism.frames))
    folded = good.copy()
    # Mirror c1's quadrilateral: a parallelogram whose links lie folded is anti-parallel. Found by
    # closing the loop from the other side by Newton's method.
    front, bottom = (mechanism.frame_index[n] for n in ("pitch_front", "pitch_bottom"))
    passive = [mechanism.frame_index[n] for c in mechanism.closures for n in c.passive]
    best = None
    for turn_front in np.linspace(-3, 3, 13):
        for turn_bottom in np.linspace(-3, 3, 13):
            trial = folded.copy()
            trial[front], trial[bottom] = turn_front, turn_bottom
            for _ in range(60):
                miss = residuals(mechanism, trial).ravel()
                step = np.linalg.pinv(residual_jacobian(mechanism, trial)[:, passive], 1e-9) @ miss
                trial[passive] -= np.clip(step, -0.2, 0.2)
            if gaps(mechanism, trial).max() < 1e-9 and not arm_health(arm, trial).branch_ok:
                best = trial
                break
        if best is not None:
            break
    assert best is not None
    health = arm_health(arm, best)
    assert health.loop_gap_m < 1e-9
    assert not health.branch_ok
    assert arm_health(arm, good).branch_ok


def test_a_joint_range_that_comes_near_a_flat_loop_is_warned_of(tmp_path, caplog):
    text = Path(load_arm("psm").file).read_text(encoding="utf-8")
    arm = tmp_path / "bold.toml"
    arm.write_text(text.replace("lower_rad = -0.925025", "lower_rad = -1.2"), encoding="utf-8")
    World(lone_rig(load_arm(arm), "PSM1"))
    assert "PSM1: a loop of psm is singular 0.080 rad from the joint range" in caplog.text
    caplog.clear()
    World("psm")
    assert not caplog.text
