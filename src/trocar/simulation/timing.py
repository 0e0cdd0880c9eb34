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
        bare: mj_step alone, of the same model in the same motion [s]
        at_rest: one call of mj_step alone from the same start: the arms rest, which is cheaper [s]
        overhead: own / bare, the median of the passes' ratios
        overhead_at_rest: own / at rest, likewise
        recording: samples of the last own pass
    """

    simulated: float
    own: float
    bare: float
    at_rest: float
    overhead: float
    overhead_at_rest: float
    recording: Recording

    @property
    def real_time_factor(self) -> float:
        """Simulated over wall-clock time."""
        return self.simulated / self.own

    @property
    def bare_real_time_factor(self) -> float:
        """The same of MuJoCo alone, in the same motion."""
        return self.simulated / self.bare


def time_beside_bare(
    world: World, trajectory: TestTrajectory, every: int, passes: int = 5
) -> Timing:
    """Play a trajectory, step the same model alone, and play with a clock around mj_step, in turn.

    An arm at rest is cheaper to step than one in motion (fewer iterations of the solver), so the
    overhead that Python costs is told beside the same motion, and the other ratio is the larger.

    Args:
        world: is reset before each pass
        trajectory: what the arms follow
        every: physics periods of a row
        passes: how often each is done
    """
    count = every * len(next(iter(trajectory.positions.values())))
    own: list[float] = []
    bare: list[float] = []
    at_rest: list[float] = []
    recording: Recording | None = None
    for _ in range(passes):
        begin_trajectory(world, trajectory)
        before = time.perf_counter()
        recording = world.play(trajectory.positions, trajectory.velocities, every=every)
        own.append(time.perf_counter() - before)
        begin_trajectory(world, trajectory)
        before = time.perf_counter()
        mujoco.mj_step(world._model, world._data, nstep=count)
        at_rest.append(time.perf_counter() - before)
        bare.append(_seconds_in_mujoco(world, trajectory, every))
    world.reset()
    if recording is None:
        raise ValueError(f"passes: got {passes}; allowed: 1 or more")
    return Timing(
        count * world.timestep,
        statistics.median(own),
        statistics.median(bare),
        statistics.median(at_rest),
        statistics.median(o / b for o, b in zip(own, bare, strict=True)),
        statistics.median(o / r for o, r in zip(own, at_rest, strict=True)),
        recording,
    )


@dataclass(frozen=True)
class RecordingCost:
    """What recording takes, medians over interleaved passes.

    Attributes:
        simulated: simulated time of a pass [s]
        with_it, without: wall-clock time of a pass [s]
        lost: share of the real-time factor that recording takes: 1 - without / with
        thread: share of the stepping thread's own processor time that it adds
        size: of a recording [bytes]
    """

    simulated: float
    with_it: float
    without: float
    lost: float
    thread: float
    size: int


def time_recording(
    world: World, trajectory: TestTrajectory, every: int, file: str, passes: int = 5
) -> RecordingCost:
    """Play a trajectory with and without a recording, in turn.

    Args:
        world: is reset before each pass
        trajectory: what the arms follow
        every: physics periods of a row
        file: is written anew by each pass
        passes: how often each is done
    """
    spent: list[tuple[float, float]] = []
    own: list[tuple[float, float]] = []
    size = 0

    def played() -> tuple[float, float]:
        before, worked = time.perf_counter(), time.thread_time()
        world.play(trajectory.positions, trajectory.velocities, every=every)
        return time.perf_counter() - before, time.thread_time() - worked

    for _ in range(passes):
        begin_trajectory(world, trajectory)
        without, alone = played()
        begin_trajectory(world, trajectory)
        with world.record(file, overwrite=True) as recorder:
            with_it, busy = played()
        size = recorder.size
        spent.append((with_it, without))
        own.append((busy, alone))
    count = every * len(next(iter(trajectory.positions.values())))
    return RecordingCost(
        count * world.timestep,
        statistics.median(a for a, _ in spent),
        statistics.median(b for _, b in spent),
        statistics.median(1.0 - b / a for a, b in spent),
        statistics.median(a / b - 1.0 for a, b in own),
        size,
    )


def _seconds_in_mujoco(world: World, trajectory: TestTrajectory, every: int) -> float:
    """Play a trajectory and return how long mj_step took of it [s]."""
    spent = 0.0

    def clocked(model: mujoco.MjModel, data: mujoco.MjData, periods: int) -> None:
        nonlocal spent
        before = time.perf_counter()
        mujoco.mj_step(model, data, periods)
        spent += time.perf_counter() - before

    begin_trajectory(world, trajectory)
    world._mj_step = clocked
    try:
        world.play(trajectory.positions, trajectory.velocities, every=every, record=False)
    finally:
        world._mj_step = mujoco.mj_step
    return spent


def begin_trajectory(world: World, trajectory: TestTrajectory) -> None:
    """Reset a world and put its arms where a trajectory begins."""
    world.reset()
    for name, q in trajectory.start.items():
        world.set_state(name, q)
