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
        world.arm("arm").set_mode("effort")
        world.mj_model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        return world

    return make


def undamped(text: str) -> str:
    head, mark, rest = text.partition("[friction.paper]")
    assert mark
    block, split, tail = rest.partition("\n[")
    block = re.sub(r"viscous_(\w+) = [\d.]+", r"viscous_\1 = 0.0", block)
    return head + mark + block + split + tail


def energies(world: World, steps: int) -> np.ndarray:
    """Potential and kinetic energy at each period [J]."""
    found = []
    for _ in range(steps):
        mujoco.mj_forward(world.mj_model, world.mj_data)
        found.append(world.mj_data.energy.copy())
        world.step()
    return np.array(found)


STARTS = {
    "psm": ([0.0, 0.0, 0.12, 0, 0, 0, 0.5], [0.4, 0.3, 0.02, 0.5, 0, 0, 0]),
    "ecm": ([0.0, 0.1, 0.1, 0.0], [0.3, 0.2, 0.02, 0.3]),
}


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_kinetic_energy_stays_without_gravity(frictionless, name):
    """First-order integration at 1 ms over 1 s: a few parts in a thousand."""
    world = frictionless(name)
    world.mj_model.opt.gravity[:] = 0.0
    q, v = (np.array(x, dtype=float) for x in STARTS[name])
    world.set_state("arm", q, v)
    kinetic = energies(world, 1000)[:, 1]
    moved = np.abs(world.arm("arm").readings()[0] - q)
    assert moved[:2].min() > 0.05
    assert np.ptp(kinetic) / kinetic[0] < 5e-3


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
    world.arm("PSM1").set_mode("effort")
    world.mj_model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    world.mj_model.opt.gravity[:] = 0.0
    q, v = (np.array(x, dtype=float) for x in STARTS["psm"])
    world.set_state("PSM1", q, v)
    kinetic = energies(world, 300)[:, 1]
    assert (np.diff(kinetic) < 1e-12).all()
    assert kinetic[-1] < 0.9 * kinetic[0]
