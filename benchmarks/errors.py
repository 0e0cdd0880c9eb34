"""How far the tip is from where the robot reports it, for each preset of errors."""

from __future__ import annotations

import numpy as np

from trocar.robot.verification.figures import Figure
from trocar.simulation import World

RIG, ARM = "two_psm_ecm", "PSM1"
#: Poses about the middle of the workspace, half their range, with a settled servo [rad, m], [s].
MIDDLE = (0.2, -0.2, 0.15, 0.0, 0.0, 0.0)
RANGE = (0.35, 0.35, 0.05, 0.8, 0.8, 0.8)
SETTLE_S = 0.4
#: Bounds of the RMS tip error [mm]. Source: docs/robot-errors.md.
BOUNDS = {"perfect": (0.0, 1e-9), "lab": (2.0, 5.0), "wide": (5.0, 20.0)}
SOURCE = (
    "lab: of a real dVRK before its cables are compensated, 2.96 mm on average (Hwang and others,"
    " 2020); RMS over poses and seeds of |measured_cp - true_state|"
)


def errors(seeds: int = 8, poses: int = 8) -> list[Figure]:
    """Return the RMS tip error of each preset, in the frame of `measured_cp` [mm]."""
    found: list[Figure] = []
    for name, (lower, upper) in BOUNDS.items():
        value = 1e3 * tip_error(name, seeds, poses)
        title = f"errors {name}: tip, RMS of {seeds} seeds and {poses} poses"
        found.append(Figure(title, value, "mm", upper, lower, source=SOURCE))
    return found


def tip_error(name: str, seeds: int, poses: int) -> float:
    """Return the RMS tip error of a preset [m]."""
    world = World(RIG, errors=name, collisions=False)
    arm, rng = world.arm(ARM), np.random.default_rng(1)
    squares: list[float] = []
    for seed in range(seeds):
        world.reset(seed, "work")
        for _ in range(poses):
            arm.move_jp(np.array(MIDDLE) + np.array(RANGE) * rng.uniform(-1.0, 1.0, 6)).wait()
            world.step(round(SETTLE_S / world.timestep))
            apart = arm.measured_cp().matrix[:3, 3] - world.true_state(ARM).cp.matrix[:3, 3]
            squares.append(float(apart @ apart))
    return float(np.sqrt(np.mean(squares)))
