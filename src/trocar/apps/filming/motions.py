"""What arms do while they are filmed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.apps.trials import paper_sine

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

Array = NDArray[np.float64]
#: Runs a world until a time [s].
Move = Callable[[float], None]

MOTIONS = ("instruments", "sine", "still")
#: Time between two set-points [s]. Source: as in headless runs.
TICK_S = 0.005
#: How far an instrument's joints swing, and how often [rad or m, Hz]. Source: our own choice: what
#: a person at the console does slowly, and all of it in view.
SWINGS = {
    "yaw": (0.05, 0.11),
    "pitch": (0.04, 0.17),
    "insertion": (0.012, 0.13),
    "roll": (0.7, 0.10),
    "wrist_pitch": (0.4, 0.19),
    "wrist_yaw": (0.45, 0.15),
    "jaw": (0.35, 0.31),
}
#: Share of the way to a joint's limit that it swings at most, and how long it takes to begin [s].
SHARE, BEGIN_S = 0.8, 0.5


def mover(world: World, duration_s: float, motion: str) -> Move:
    """Return what moves a world while it is filmed; it may put arms where the motion begins.

    Args:
        world: is moved by the function that is returned
        duration_s: at most so long [s]
        motion: one of MOTIONS: the instruments about where they are, every arm but the setup
            joints along the paper's sine, or none
    """
    if motion == "still":
        return lambda until: _wait(world, until)
    every = max(1, round(TICK_S / world.timestep))
    tick = every * world.timestep
    count = int(duration_s / tick) + 2
    if motion == "sine":
        sine = paper_sine(world.rig, count * tick, tick)
        for name, q in sine.start.items():
            world.set_state(name, q)
        return _player(world, sine.positions, every)
    times = tick * np.arange(1, count + 1, dtype=np.float64)
    arms = [arm for arm in world.arms.values() if arm.type == "PSM"]
    tables = {arm.name: swings(arm, times, number) for number, arm in enumerate(arms)}
    return _player(world, tables, every) if tables else lambda until: _wait(world, until)


def swings(arm: Arm, times: Array, number: int) -> Array:
    """Return set-points (k, n) [rad or m] of an instrument that moves about where it is.

    Args:
        arm: the instrument's
        times: since the motion began (k,) [s]
        number: instruments of other numbers are at other places of their swings
    """
    still = arm.snapshot(None).setpoint
    found = np.tile(still, (len(times), 1))
    begin = np.clip(times / BEGIN_S, 0.0, 1.0)
    for joint, name in enumerate(arm.joint_names):
        if name not in SWINGS:
            continue
        far, often = SWINGS[name]
        middle = max(still[joint], far) if name == "jaw" else still[joint]  # it opens and closes
        room = SHARE * min(arm.upper[joint] - middle, middle - arm.lower[joint])
        phase = 2.1 * number + joint
        swing = np.sin(2.0 * np.pi * often * times + phase) - np.sin(phase) * (1.0 - begin)
        found[:, joint] += begin * (middle - still[joint] + min(far, max(room, 0.0)) * swing)
    return found


def _player(world: World, positions: dict[str, Array], every: int) -> Move:
    """Return what plays tables of set-points, piece by piece."""
    row, tick = 0, every * world.timestep

    def move(until: float) -> None:
        nonlocal row
        count = round((until - world.time) / tick)
        if count > 0:
            part = {name: q[row : row + count] for name, q in positions.items()}
            world.play(part, every=every, record=False)
            row += count

    return move


def _wait(world: World, until: float) -> None:
    periods = round((until - world.time) / world.timestep)
    if periods > 0:
        world.step(periods)
