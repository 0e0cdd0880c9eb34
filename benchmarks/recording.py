"""The cost of recording the whole cart in motion, every joint in every period."""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from trocar.recording import record
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.simulation.trials import TICK_S, begin_trajectory, paper_sine, periods_per_tick

#: Added processor time of the stepping thread [%], size of a minute [MB].
#: Source: the project's own goals.
MOST_PERCENT, MOST_MB = 8.0, 40.0


def recording(duration_s: float = 4.0, passes: int = 31) -> list[Figure]:
    """Measure the cost of recording `full_cart` along the test trajectory.

    Args:
        duration_s: simulated time of a pass [s]; short ones, since other load varies slowly
        passes: interleaved passes with and without a recording

    Raises:
        MissingExtraError: the library for MCAP is not installed
    """
    world = World("full_cart")
    sine, every = paper_sine(world.rig, duration_s, TICK_S), periods_per_tick(world)
    simulated = every * len(next(iter(sine.positions.values()))) * world.timestep
    # a row a pass: wall, stepping thread, other threads; each with and without a recording [s]
    rows: list[tuple[float, ...]] = []

    def played() -> tuple[float, float, float]:
        clocks = time.perf_counter, time.thread_time, time.process_time
        before = [clock() for clock in clocks]
        world.play(sine.positions, sine.velocities, every=every)
        wall, thread, process = (clock() - b for clock, b in zip(clocks, before, strict=True))
        return wall, thread, process - thread

    with TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        for _ in range(passes):
            begin_trajectory(world, sine)
            without = played()
            begin_trajectory(world, sine)
            with record(world, file, overwrite=True):
                rows.append(played() + without)
        size = file.stat().st_size
    median = statistics.median
    added = 100.0 * median(r[1] / r[4] - 1.0 for r in rows)
    lost = 100.0 * median(1.0 - r[3] / r[0] for r in rows)
    writing = 100.0 * median(r[2] for r in rows) / simulated
    return [
        Figure("recording: added in the stepping thread", added, "% of its time", MOST_PERCENT),
        Figure("recording: a simulated minute", 60e-6 * size / simulated, "MB", MOST_MB),
        Figure("  writing thread at 1 kHz", writing, "% of a core"),
        Figure("  loss of real-time factor at full speed", lost, "%"),
        Figure("  real-time factor with", simulated / median(r[0] for r in rows), ""),
        Figure("  real-time factor without", simulated / median(r[3] for r in rows), ""),
    ]
