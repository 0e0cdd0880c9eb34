"""Nothing is lost and nothing is made when friction, damping and servos are off."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.catalogue import DATA
from trocar.modeling.build import lone_rig
from trocar.simulation import World


@pytest.fixture
def frictionless(tmp_path: Path):
    """Return the function that copies an arm without its paper damping, and makes a world."""

    def make(name: str) -> World:
        text = (DATA / "arms" / f"{name}.toml").read_text(encoding="utf-8")
        tool = DATA / "tools" / "LARGE_NEEDLE_DRIVER_400006.toml"
        (tmp_path / "arm.toml").write_text(undamped(text), encoding="utf-8")
        (tmp_path / "tool.toml").write_text(
            undamped(tool.read_text(encoding="utf-8")), encoding="utf-8"
        )
        mounted = tmp_path / "tool.toml" if name == "psm" else "none"
        arm = load_arm(tmp_path / "arm.toml", mounted)
        assert all(f.viscous == f.coulomb == 0.0 for f in arm.friction["paper"].values())
        world = World(lone_rig(arm), friction="paper", gravity_compensation=False)
        world.arm("arm").joints.set_mode("effort")
        world.mj_model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        return world

    return make


def undamped(text: str) -> str:
    head, mark, rest = text.partition("[friction.paper]")
    assert mark
    block, split, tail = rest.partition("\n[")
    block = re.sub(r"viscous_(\w+) = [\d.]+", r"viscous_\1 = 0.0", block)
    return head + mark + block + split + tail


def energies(world: World, looks: int, every: int = 1) -> np.ndarray:
    """Potential and kinetic energy each few physics steps [J]."""
    found = []
    for _ in range(looks):
        mujoco.mj_forward(world.mj_model, world.mj_data)
        found.append(world.mj_data.energy.copy())
        world.step(every)
    return np.array(found)


STARTS = {
    "psm": ([0.0, 0.0, 0.12, 0, 0, 0, 0.5], [0.4, 0.3, 0.02, 0.5, 0, 0, 0]),
    "ecm": ([0.0, 0.1, 0.1, 0.0], [0.3, 0.2, 0.02, 0.3]),
}


COASTS = {
    "psm": ([-0.8, -0.3, 0.1, 0, 0, 0, 0.5], [0.15, 0.06, 0.005, 0.3, 0.03, 0.03, 0.0]),
    "ecm": ([-0.6, -0.3, 0.05, -0.5], [0.1, 0.06, 0.01, 0.1]),
}


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_kinetic_energy_stays_for_ten_seconds_without_gravity(frictionless, name):
    """All joints coast through much of their ranges at 1 ms, and hit no stop."""
    world = frictionless(name)
    world.mj_model.opt.gravity[:] = 0.0
    q, v = (np.array(x, dtype=float) for x in COASTS[name])
    world.set_state("arm", q, v)
    kinetic = energies(world, 100, 100)[:, 1]
    moved = np.abs(world.arm("arm").joints.readings()[0] - q)
    assert moved[:2].min() > 0.2
    assert np.ptp(kinetic) / kinetic[0] < 1e-3


def test_total_energy_stays_for_ten_seconds_as_the_arm_swings(frictionless):
    """Without stops. Positions and velocities are half a step apart, as the integrator has them."""
    world = frictionless("psm")
    world.mj_model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    q, v = np.array([0.3, 0.1, 0.12, 0, 0, 0, 0.5]), np.array([0, 0, 0, 1.0, 0, 0, 0])
    world.set_state("arm", q, v)
    model, data = world.mj_model, world.mj_data
    there = mujoco.MjData(model)
    found = []
    for _ in range(500):
        there.qpos[:], before = data.qpos, data.qvel.copy()
        world.step()
        there.qvel[:] = 0.5 * (before + data.qvel)
        mujoco.mj_forward(model, there)
        found.append(there.energy.copy())
        world.step(19)
    energy = np.array(found)
    exchanged = np.ptp(energy[:, 0])
    assert exchanged > 0.1
    assert np.ptp(energy.sum(axis=1)) / exchanged < 1e-3


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_total_energy_stays_as_the_arm_falls(frictionless, name):
    world = frictionless(name)
    q, v = (np.array(x, dtype=float) for x in STARTS[name])
    world.set_state("arm", q, v)
    # The scope falls on its stop, which keeps no energy, after 0.17 s.
    energy = energies(world, 150 if name == "ecm" else 400)
    total = energy.sum(axis=1)
    exchanged = np.ptp(energy[:, 0])
    assert exchanged > 0.05
    assert np.ptp(total) / exchanged < 2e-2


def test_the_paper_damping_takes_energy_away():
    world = World("psm", friction="paper", gravity_compensation=False)
    world.arm("PSM1").joints.set_mode("effort")
    world.mj_model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    world.mj_model.opt.gravity[:] = 0.0
    q, v = (np.array(x, dtype=float) for x in STARTS["psm"])
    world.set_state("PSM1", q, v)
    kinetic = energies(world, 300)[:, 1]
    assert (np.diff(kinetic) < 1e-12).all()
    assert kinetic[-1] < 0.9 * kinetic[0]
