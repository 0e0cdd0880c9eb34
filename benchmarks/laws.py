"""Laws of physics that props keep: momentum, Coulomb's friction, soft pads, Hooke's bands."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.inertial import STANDARD_GRAVITY
from trocar.robot.verification.figures import Figure
from trocar.simulation import World

Array = NDArray[np.float64]

#: Bounds. Source: the project's own goals, relative.
MOMENTUM, SLIP, DEPTH, HOOKE = 1e-12, 0.02, 0.1, 0.01

ARM = """
schema = 1
name = "laws"
source = "our own choice"
[[arm]]
name = "ECM"
description = "ecm"
xyz_m = [3, 3, 1]
[[pose]]
name = "start"
[pose.q_rad_m]
ECM = [0, 0, 0.1, 0]
"""
#: Balls in flight that two bands pull together, so that they collide.
FLIGHT = {
    "one": (2.0, [0.0, 0.0, 5.0]),
    "two": (6.0, [0.09, 0.01, 5.0]),
    "three": (3.0, [0, 0.1, 5]),
}
#: Friction coefficients; masses on pads and stiffness of these; masses on bands and stiffness of
#: these [g, N/m].
FRICTION = (0.1, 0.3, 0.6, 1.0)
PADS = ((5.0, 50.0), (50.0, 50.0), (50.0, 500.0), (500.0, 2000.0))
BANDS = ((10.0, 20.0), (50.0, 20.0), (50.0, 200.0))
#: Rest length of the bands that carry weights [m].
REST_M = 0.1
#: Force on a block from below to above what friction carries, in this time; it slips above this
#: speed [s, m/s].
RAMP, RAMP_S, SLIPS_M_S = (0.95, 1.05), 2.0, 2e-4


def rig_text() -> str:
    """Return a rig in which every law shows."""
    text = [ARM]
    for name, (mass, at) in FLIGHT.items():
        text.append(
            f'[[prop]]\nname = "{name}"\nmovable = true\nmass_g = {mass}\nxyz_m = {at}\n'
            'shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 10 }]\n'
        )
    for name, ends in {"first": ("one", "two"), "second": ("two", "three")}.items():
        points = ", ".join(f'{{ prop = "{end}" }}' for end in ends)
        text.append(
            f'[[band]]\nname = "{name}"\nrest_length_mm = 20\nstiffness_n_per_m = 10\n'
            f"damping_ns_per_m = 0.01\npoint = [{points}]\n"
        )
    text.append(
        '[[prop]]\nname = "table"\n'
        'shape = [{ kind = "box", center_mm = [0, 0, -10], size_mm = [2000, 2000, 20] }]\n'
    )
    for k, friction in enumerate(FRICTION):
        text.append(
            f'[[prop]]\nname = "block{k}"\nmovable = true\nmass_g = 20\n'
            f"xyz_mm = [0, {100 * k}, 5]\n"
            'shape = [{ kind = "box", center_mm = [0, 0, 0], size_mm = [40, 40, 10],'
            f" friction = {friction} }}]\n"
        )
    for k, (mass, stiffness) in enumerate(PADS):
        text.append(
            f'[[prop]]\nname = "pad{k}"\nxyz_mm = [-200, {100 * k}, 0]\n'
            'shape = [{ kind = "box", center_mm = [0, 0, 10], size_mm = [80, 80, 20],'
            f" stiffness_n_per_m = {stiffness} }}]\n"
            f'[[prop]]\nname = "punch{k}"\nmovable = true\nmass_g = {mass}\n'
            f"xyz_mm = [-200, {100 * k}, 30]\n"
            'shape = [{ kind = "box", center_mm = [0, 0, 0], size_mm = [40, 40, 20] }]\n'
        )
    for k, (mass, stiffness) in enumerate(BANDS):
        damping = 2.0 * np.sqrt(1e-3 * mass * stiffness)
        text.append(
            f'[[prop]]\nname = "hook{k}"\nxyz_m = [-0.4, {0.1 * k}, 1]\n'
            'shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 2, collide = false }]\n'
            f'[[prop]]\nname = "load{k}"\nmovable = true\nmass_g = {mass}\n'
            f"xyz_m = [-0.4, {0.1 * k}, {1.0 - REST_M}]\n"
            'shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 10 }]\n'
            f'[[band]]\nname = "rubber{k}"\nrest_length_m = {REST_M}\n'
            f"stiffness_n_per_m = {stiffness}\ndamping_ns_per_m = {damping}\n"
            f'point = [{{ prop = "hook{k}" }}, {{ prop = "load{k}" }}]\n'
            f'[[sensor]]\nname = "tension{k}"\nkind = "tension"\nband = "rubber{k}"\n'
        )
    return "\n".join(text)


def laws() -> list[Figure]:
    """Simulate 3 s of a rig in which every law shows."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "laws.toml"
        file.write_text(rig_text(), encoding="utf-8")
        world = World(file, dynamics="cad")
    momentum = _momentum(world, 0.5)
    world.step(500)  # blocks, punches and loads come to rest
    thresholds = _thresholds(world)
    found = [
        Figure("momentum of balls, bands and collisions in flight", momentum, "", MOMENTUM),
        Figure(
            "slip against the friction coefficient",
            max(abs(at / mu - 1.0) for at, mu in zip(thresholds, FRICTION, strict=True)),
            "",
            SLIP,
        ),
        Figure("depth of a punch in a soft pad", max(_off_depths(world)), "", DEPTH),
        Figure("force of a band by Hooke", max(_off_bands(world)), "", HOOKE),
    ]
    return found


def _momentum(world: World, time_s: float) -> float:
    """Return how far momentum is from m v + m g t, relative to what moves, the worst in flight."""
    masses = np.array([1e-3 * mass for mass, _ in FLIGHT.values()])
    names = list(FLIGHT)
    worst = 0.0
    for _ in range(round(time_s / world.timestep)):
        world.step()
        states = world.object_states()
        moving = masses[:, None] * states.linear[[states.names.index(n) for n in names]]
        fallen = np.array([0.0, 0.0, -STANDARD_GRAVITY * world.time]) * masses.sum()
        worst = max(worst, float(np.abs(moving.sum(axis=0) - fallen).max() / np.abs(moving).sum()))
    return worst


def _thresholds(world: World) -> list[float]:
    """Return the force at which each block slips, over its weight."""
    blocks = [world.object(f"block{k}") for k in range(len(FRICTION))]
    slipped: dict[int, float] = {}
    steps = round(RAMP_S / world.timestep)
    for step in range(steps):
        share = RAMP[0] + (RAMP[1] - RAMP[0]) * step / steps
        for k, (block, friction) in enumerate(zip(blocks, FRICTION, strict=True)):
            force = share * friction * block.mass * STANDARD_GRAVITY
            block.servo_cf([force, 0.0, 0.0, 0.0, 0.0, 0.0])
            if k not in slipped and block.measured_cv().linear[0] > SLIPS_M_S:
                slipped[k] = share * friction
        world.step()
    return [slipped.get(k, np.inf) for k in range(len(FRICTION))]


def _off_depths(world: World) -> list[float]:
    """Return the relative error of each depth; a box rests on its four corners."""
    found: list[float] = []
    for k, (mass, stiffness) in enumerate(PADS):
        depth = 0.03 - world.object(f"punch{k}").measured_cp().matrix[2, 3]
        found.append(abs(depth / (1e-3 * mass * STANDARD_GRAVITY / (4.0 * stiffness)) - 1.0))
    return found


def _off_bands(world: World) -> list[float]:
    """Return the relative errors of each band's extension at rest and of its measured tension."""
    found: list[float] = []
    for k, (mass, stiffness) in enumerate(BANDS):
        weight = 1e-3 * mass * STANDARD_GRAVITY
        extension = 1.0 - REST_M - float(world.object(f"load{k}").measured_cp().matrix[2, 3])
        reading: Mapping[str, float] = vars(world.sensor(f"tension{k}"))
        found += [abs(stiffness * extension / weight - 1.0), abs(reading["tension"] / weight - 1.0)]
    return found
