"""What it costs to record the whole cart in motion, every joint in every period."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from trocar.apps.benchmarks.figure import Figure
from trocar.simulation import World
from trocar.simulation.timing import time_recording
from trocar.simulation.trajectories import paper_sine
from trocar.simulation.trials import TICK_S, periods_per_tick

#: Simulated time of a pass [s]. Many short ones: what else the machine does comes and goes slowly.
DURATION_S = 4.0
#: Source: the project's own goals.
MOST_PERCENT, MOST_MB = 5.0, 40.0
SECONDS_A_MINUTE = 60.0


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
        file = str(Path(folder) / "run.mcap")
        cost = time_recording(world, sine, periods_per_tick(world), file, passes)
    minute = 1e-6 * cost.size * SECONDS_A_MINUTE / cost.simulated
    yield Figure("recording: loss of real-time factor", 100.0 * cost.lost, "%", MOST_PERCENT)
    yield Figure("recording: a simulated minute", minute, "MB", MOST_MB)
    yield Figure("  of which in the stepping thread", 100.0 * cost.thread, "% of its time")
    yield Figure("  real-time factor with", cost.simulated / cost.with_it, "")
    yield Figure("  real-time factor without", cost.simulated / cost.without, "")
