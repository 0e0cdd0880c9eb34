"""Arms touch other arms and the table, never themselves; the named poses are clear."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_rig, names
from trocar.descriptions.catalogue import DATA
from trocar.modeling.geoms import OBJECTS, contact_masks
from trocar.simulation import World
from trocar.simulation.trials import paper_sine

RIGS = names("rigs")


def touching(world: World) -> set[tuple[str, str]]:
    """The pairs of bodies in contact in the present pose."""
    mujoco.mj_kinematics(world.mj_model, world.mj_data)
    mujoco.mj_collision(world.mj_model, world.mj_data)
    found = set()
    for contact in world.mj_data.contact:
        if contact.dist <= 0.0:
            bodies = (int(world.mj_model.geom_bodyid[g]) for g in contact.geom)
            found.add(tuple(sorted(world.mj_model.body(b).name for b in bodies)))
    return found


@pytest.mark.parametrize("rig", RIGS)
def test_nothing_touches_at_any_named_pose(rig):
    world = World(rig)
    for pose in world.rig.poses:
        world.reset(pose=pose)
        assert not touching(world), pose


@pytest.mark.parametrize("rig", RIGS)
def test_nothing_touches_along_the_test_trajectory(rig):
    """The trajectory as it is commanded, every 50 ms over its 10 s."""
    world = World(rig)
    sine = paper_sine(world.rig, 10.0, 0.05)
    for row in range(len(next(iter(sine.positions.values())))):
        for name in sine.positions:
            world.arm(name).runtime.motors.place(
                sine.positions[name][row], np.zeros_like(sine.positions[name][row])
            )
        assert not touching(world), row


@pytest.mark.parametrize("rig", RIGS)
def test_masks_are_symmetric_and_no_arm_touches_itself_or_its_carrier(rig):
    description = load_rig(rig)
    masks = contact_masks(description)

    def touches(a: str, b: str) -> bool:
        return bool(masks[a].contype & masks[b].conaffinity)

    for a in masks:
        for b in masks:
            assert touches(a, b) == touches(b, a), (a, b)
        assert touches(a, a) == (a == OBJECTS)
    for arm in description.arms:
        if arm.on:
            assert not touches(arm.name, arm.on)
    setup = [a.name for a in description.arms if a.arm.type == "SUJ"]
    assert not any(touches(a, b) for a in setup for b in setup)
    moved = [a.name for a in description.arms if a.arm.type != "SUJ"]
    assert all(touches(a, b) for a in moved for b in moved if a != b)


def test_an_arm_that_is_driven_into_another_pushes_it():
    """PSM2 swings across the scope's lower link; without collisions it passes through."""
    pushed, met = {}, {}
    for collisions in (True, False):
        world = World("two_psm_ecm", collisions=collisions)
        scope = world.arm("ECM")
        world.arm("PSM2").move_jp([1.2, 0, 0.2, 0, 0, 0])
        met[collisions], pushed[collisions] = set(), 0.0
        for _ in range(60):
            world.step(50)
            met[collisions] |= touching(world)
            off = scope.measured_js().position - scope.setpoint_js().position
            pushed[collisions] = max(pushed[collisions], np.abs(off).max())
    assert pushed[False] < 1e-3
    assert pushed[True] > 3e-3
    assert not met[False]
    assert {body.split("/")[0] for pair in met[True] for body in pair} == {"ECM", "PSM2"}


def test_a_tool_that_is_driven_into_the_table_rests_on_it(tmp_path: Path):
    """With the remote centre 0.22 m above the table, a tool of 0.2335 m is too long."""
    text = (DATA / "rigs" / "psm.toml").read_text(encoding="utf-8")
    assert text.count("xyz_m = [0.0, 0.0, 0.3]") == 1
    low = tmp_path / "low.toml"
    low.write_text(text.replace("xyz_m = [0.0, 0.0, 0.3]", "xyz_m = [0.0, 0.0, 0.22]"))
    depths = {}
    for collisions in (True, False):
        world = World(low, collisions=collisions)
        world.arm("PSM1").move_jp([0, 0, 0.24, 0, 0, 0]).wait(5.0)
        world.step(500)
        depths[collisions] = world.arm("PSM1").local.measured_cp().matrix[2, 3]
        if collisions:
            assert touching(world) >= {("PSM1/finger_left", "table")}
    assert depths[False] == pytest.approx(-0.2335, abs=5e-4)
    assert depths[True] > -0.215  # the fingers reach 10 mm beyond the tip, and rest on it


def test_without_collisions_there_is_nothing_to_collide():
    model = World("full_cart", collisions=False).mj_model
    assert model.ngeom == 0


def test_collision_geoms_carry_no_mass():
    """Mass is the description's; shapes only look and touch."""
    for rig in ("psm", "full_cart"):
        on, off = World(rig).mj_model, World(rig, collisions=False).mj_model
        np.testing.assert_array_equal(on.body_mass, off.body_mass)
        np.testing.assert_array_equal(on.body_inertia, off.body_inertia)
        assert on.ngeom > 0
