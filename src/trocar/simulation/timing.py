"""How fast a world runs beside its bare physics: the only place below interfaces with a clock."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass

import mujoco

from trocar.simulation.records import Recording
from trocar.simulation.trajectories import TestTrajectory
from trocar.simulation.world import World


@dataclass(frozen=True, eq=False)
class Timing:
    """Wall-clock seconds of one trajectory, medians over interleaved passes.

    Attributes:
        simulated: simulated time of a pass [s]
        own: the world with targets written and samples taken [s]
        bare: the same model, stepped by MuJoCo alone [s]
        overhead: own / bare, the median of the passes' ratios
        recording: samples of the last own pass
    """

    simulated: float
    own: float
    bare: float
    overhead: float
    recording: Recording

    @property
    def real_time_factor(self) -> float:
        """Simulated over wall-clock time."""
        return self.simulated / self.own

    @property
    def bare_real_time_factor(self) -> float:
        """The same of MuJoCo alone."""
        return self.simulated / self.bare


def time_beside_bare(
    world: World, trajectory: TestTrajectory, every: int, passes: int = 5
) -> Timing:
    """Play a trajectory and step the same model alone, in turn.

    Args:
        world: is reset before each pass
        trajectory: what the arms follow
        every: physics periods of a row
        passes: how often each is done
    """
    count = every * len(next(iter(trajectory.positions.values())))
    own: list[float] = []
    bare: list[float] = []
    recording: Recording | None = None
    for _ in range(passes):
        begin_trajectory(world, trajectory)
        before = time.perf_counter()
        recording = world.play(trajectory.positions, trajectory.velocities, every=every)
        own.append(time.perf_counter() - before)
        begin_trajectory(world, trajectory)
        before = time.perf_counter()
        mujoco.mj_step(world._model, world._data, nstep=count)
        bare.append(time.perf_counter() - before)
    world.reset()
    if recording is None:
        raise ValueError(f"passes: got {passes}; allowed: 1 or more")
    return Timing(
        count * world.timestep,
        statistics.median(own),
        statistics.median(bare),
        statistics.median(o / b for o, b in zip(own, bare, strict=True)),
        recording,
    )


def begin_trajectory(world: World, trajectory: TestTrajectory) -> None:
    """Reset a world and put its arms where a trajectory begins."""
    world.reset()
    for name, q in trajectory.start.items():
        world.set_state(name, q)
