"""The cost of recording the whole cart in motion, every joint in every period."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from trocar.apps.benchmarks.figure import Figure
from trocar.apps.trials import (
    TICK_S,
    TestTrajectory,
    begin_trajectory,
    paper_sine,
    periods_per_tick,
)
from trocar.recording import record
from trocar.simulation import World

#: Simulated time of a pass [s]. Many short ones: what else the machine does comes and goes slowly.
DURATION_S = 4.0
#: Added processor time of the stepping thread [%], size of a minute [MB].
#: Source: the project's own goals.
MOST_PERCENT, MOST_MB = 8.0, 40.0
SECONDS_A_MINUTE = 60.0


@dataclass(frozen=True)
class RecordingCost:
    """The cost of recording, medians over interleaved passes.

    Attributes:
        simulated: simulated time of a pass [s]
        with_it, without: wall-clock time of a pass at full speed [s]
        lost: ratio of the real-time factor that is lost at full speed: 1 - without / with
        stepping: added processor time of the stepping thread over its own
        writing: processor time of all other threads over simulated time
        size: of a recording [bytes]
    """

    simulated: float
    with_it: float
    without: float
    lost: float
    stepping: float
    writing: float
    size: int


def recording(
    duration_s: float = DURATION_S,
    passes: int = 31,
    watch: Callable[[str], None] | None = None,
) -> list[Figure]:
    """Measure the cost of recording `full_cart` along the test trajectory.

    Args:
        duration_s: simulated time of a pass [s]
        passes: interleaved passes with and without
        watch: told what is measured

    Raises:
        MissingExtraError: the library for MCAP is not installed
    """
    if watch is not None:
        watch("recording")
    return list(_measured(duration_s, passes))


def _measured(duration_s: float, passes: int) -> Iterator[Figure]:
    world = World("full_cart")
    sine = paper_sine(world.rig, duration_s, TICK_S)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        cost = time_recording(world, sine, periods_per_tick(world), file, passes)
    minute = 1e-6 * cost.size * SECONDS_A_MINUTE / cost.simulated
    added = 100.0 * cost.stepping
    yield Figure("recording: added in the stepping thread", added, "% of its time", MOST_PERCENT)
    yield Figure("recording: a simulated minute", minute, "MB", MOST_MB)
    yield Figure("  writing thread at 1 kHz", 100.0 * cost.writing, "% of a core")
    yield Figure("  loss of real-time factor at full speed", 100.0 * cost.lost, "%")
    yield Figure("  real-time factor with", cost.simulated / cost.with_it, "")
    yield Figure("  real-time factor without", cost.simulated / cost.without, "")


def time_recording(
    world: World, trajectory: TestTrajectory, every: int, file: Path, passes: int = 5
) -> RecordingCost:
    """Play a trajectory with and without a recording, in turn.

    Args:
        world: is reset before each pass
        trajectory: what the arms follow
        every: physics periods of a row
        file: is written anew by each pass
        passes: how often each is done
    """
    walls: list[tuple[float, float]] = []
    busy: list[tuple[float, float]] = []
    others: list[float] = []
    size = 0

    def clocks() -> tuple[float, float, float]:
        return time.perf_counter(), time.thread_time(), time.process_time()

    def played() -> tuple[float, float, float]:
        before = clocks()
        world.play(trajectory.positions, trajectory.velocities, every=every)
        wall, thread, process = (b - a for a, b in zip(before, clocks(), strict=True))
        return wall, thread, process - thread

    for _ in range(passes):
        begin_trajectory(world, trajectory)
        without, alone, _ = played()
        begin_trajectory(world, trajectory)
        with record(world, file, overwrite=True):
            with_it, stepping, writing = played()
        size = file.stat().st_size
        walls.append((with_it, without))
        busy.append((stepping, alone))
        others.append(writing)
    simulated = every * len(next(iter(trajectory.positions.values()))) * world.timestep
    return RecordingCost(
        simulated,
        statistics.median(a for a, _ in walls),
        statistics.median(b for _, b in walls),
        statistics.median(1.0 - b / a for a, b in walls),
        statistics.median(a / b - 1.0 for a, b in busy),
        statistics.median(others) / simulated,
        size,
    )
