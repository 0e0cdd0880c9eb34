"""Table 9: how many simulated seconds a second of the machine's time holds."""

from __future__ import annotations

from collections.abc import Callable

from trocar.apps.verification.figure import Figure, Part
from trocar.simulation import World
from trocar.simulation.table9 import CONFIGURATIONS
from trocar.simulation.timing import time_beside_bare
from trocar.simulation.trajectories import paper_sine
from trocar.simulation.trials import TICK_S, periods_per_tick

#: Simulated time of a pass, and passes of which the median counts. Source: our own choice. [s]
DURATION_S = 2.0
PASSES = 3


def realtime(watch: Callable[[str], None] | None = None, duration_s: float = DURATION_S) -> Part:
    """Drive each configuration of Table 9 along the test sine at 1 kHz, on one core.

    Args:
        watch: told which configuration is next
        duration_s: simulated time of a pass [s]
    """
    figures: list[Figure] = []
    for label, rig, setup, paper, _ in CONFIGURATIONS:
        if setup != "braked":
            continue  # not a row of the paper's
        if watch is not None:
            watch(f"realtime: {label}")
        world = World(rig, friction="paper", setup_joints=setup)
        sine = paper_sine(world.rig, duration_s, TICK_S)
        timing = time_beside_bare(world, sine, periods_per_tick(world), PASSES)
        source = "closed-loop paper, Table 9 (Gazebo, i7-4770K); limit: no slower than that"
        figures.append(
            Figure(label, timing.real_time_factor, "", paper_simulation=paper, lower=paper,
                   source=source)
        )  # fmt: skip
    notes = (
        "Real-time coefficient: simulated over wall-clock time, as fast as it goes, with bodies"
        " that collide. Gazebo's cannot exceed 1. Ours depends on the machine; nominal arms.",
        f"Median of {PASSES} passes of {duration_s:g} s at 1 kHz on one core.",
    )
    command = "trocar verify --only realtime"
    return Part("realtime", "", "Speed: Table 9 of the paper", tuple(figures), command, notes)
