"""The configurations of the paper's Table 9: our speed beside bare MuJoCo and the paper's."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from trocar.descriptions import load_rig
from trocar.descriptions.overlay import Overlay
from trocar.errors import InputError
from trocar.simulation.timing import time_beside_bare
from trocar.simulation.trajectories import paper_sine
from trocar.simulation.trials import TICK_S, periods_per_tick
from trocar.simulation.world import World

#: Source: closed-loop paper, Table 9 (i7-4770K, Gazebo). Its last row, with the camera, is in
#: `trocar verify`. The least real-time factors on one core are the project's own goal.
CONFIGURATIONS: tuple[tuple[str, str, Literal["braked", "locked"], float, float], ...] = (
    ("PSM", "psm", "braked", 1.0, 100.0),
    ("ECM", "ecm", "braked", 1.0, 130.0),
    ("2 PSM + ECM", "two_psm_ecm", "braked", 0.98, 42.0),
    ("3 PSMs", "three_psm", "braked", 0.99, 40.0),
    ("SUJ + 3 PSM + ECM", "full_cart", "braked", 0.51, 22.0),
    ("the same, setup joints locked", "full_cart", "locked", 0.51, 28.0),
)


@dataclass(frozen=True)
class Table9Row:
    """One configuration.

    Attributes:
        bare_real_time_factor: of mj_step alone, in the same motion
        overhead: own time over that of mj_step in the same motion
        overhead_at_rest: own time over that of one call of mj_step while the arms rest
        collision_cost: time of mj_step with over without bodies that collide, while the arms rest
    """

    configuration: str
    rig: str
    setup_joints: str
    real_time_factor: float
    bare_real_time_factor: float
    overhead: float
    overhead_at_rest: float
    collision_cost: float
    paper: float
    goal: float


#: Simulated time of a pass. Source: our own choice. [s]
PASS_S = 10.0


def table9(
    duration_s: float = PASS_S,
    passes: int = 5,
    watch: Callable[[str], None] | None = None,
    overlays: Sequence[Overlay] = (),
) -> list[Table9Row]:
    """Measure every configuration at 1 kHz with the paper's joint model (damping, no dry friction).

    Args:
        duration_s: simulated time of a pass [s]
        passes: interleaved passes of each figure
        watch: told what is measured next
        overlays: calibrations of the arms that they are of, wherever a configuration has one

    Raises:
        InputError: a calibration of an arm that no configuration has
    """
    kinds = {row[1]: {arm.arm.name for arm in load_rig(row[1]).arms} for row in CONFIGURATIONS}
    for overlay in overlays:
        if not any(overlay.arm in of_rig for of_rig in kinds.values()):
            known = ", ".join(sorted(set().union(*kinds.values())))
            file = overlay.file or "overlay"
            raise InputError(f"{file}: is a calibration of {overlay.arm!r}; allowed: {known}")
    rows: list[Table9Row] = []
    for label, rig, setup, paper, goal in CONFIGURATIONS:
        if watch is not None:
            watch(label)
        laid = [overlay for overlay in overlays if overlay.arm in kinds[rig]] or None
        own = World(rig, friction="paper", setup_joints=setup, calibration=laid)
        free = World(rig, friction="paper", setup_joints=setup, collisions=False, calibration=laid)
        trajectory = paper_sine(own.rig, duration_s, TICK_S)
        every = periods_per_tick(own)
        ratios: list[float] = []
        factors: list[tuple[float, float, float, float]] = []
        for _ in range(passes):
            with_bodies = time_beside_bare(own, trajectory, every, passes=1)
            without = time_beside_bare(free, trajectory, every, passes=1)
            ratios.append(with_bodies.at_rest / without.at_rest)
            factors.append(
                (
                    with_bodies.real_time_factor,
                    with_bodies.bare_real_time_factor,
                    with_bodies.overhead,
                    with_bodies.overhead_at_rest,
                )
            )
        factor, bare, overhead, resting = map(statistics.median, zip(*factors, strict=True))
        cost = statistics.median(ratios)
        rows.append(
            Table9Row(label, rig, setup, factor, bare, overhead, resting, cost, paper, goal)
        )
    return rows
