"""A rig along the paper's test trajectory, without a window: speed, loop health, tracking."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass

from trocar.apps.timing import time_beside_bare
from trocar.apps.trials import (
    TICK_S,
    TestTrajectory,
    begin_trajectory,
    loop_health,
    paper_sine,
    periods_per_tick,
    tracking_rms,
)
from trocar.interfaces.loop import WallClock
from trocar.interfaces.pace import Pace
from trocar.simulation import World


@dataclass(frozen=True)
class HeadlessReport:
    """What a headless run found; `tracking_rms` is {arm: {joint: rad or m}}.

    `rcm_error_um_max` is None where no arm has a remote centre; `rcm_wander_um_max` is how much of
    it the arms' own geometry may account for over the range of the joints, 0 but for calibrated
    arms whose centre wanders.
    """

    rig: str
    timestep_s: float
    simulated_s: float
    wall_s: float
    real_time_factor: float
    bare_real_time_factor: float
    overhead: float
    overhead_at_rest: float
    loop_gap_um_max: float
    rcm_error_um_max: float | None
    rcm_wander_um_max: float | None
    branch_ok: bool
    tracking_rms: Mapping[str, Mapping[str, float]]


def run_headless(
    world: World,
    duration_s: float,
    passes: int = 5,
    realtime: bool = False,
    record: Callable[[], AbstractContextManager[object]] | None = None,
) -> HeadlessReport:
    """Drive every arm of a world but its setup joints along the test trajectory.

    The timed passes sample every 5 ms; loop health is that of a separate, untimed pass that
    samples every physics period. In real time another pass keeps to the wall clock, and it is
    that one's wall time and factor that are reported. With `record` one more pass, the first and
    untimed, runs inside the context that it returns.

    Raises:
        InputError: the duration, a timestep that 5 ms is no whole multiple of, or a file that
            cannot be written
        DivergedError: the simulation left the finite numbers
    """
    every = periods_per_tick(world)
    trajectory = paper_sine(world.rig, duration_s, TICK_S)
    if record is not None:
        with record():
            begin_trajectory(world, trajectory)
            world.play(trajectory.positions, trajectory.velocities, every=every, record=False)
    timing = time_beside_bare(world, trajectory, every, passes)
    wall = _paced_pass(world, trajectory, every) if realtime else timing.own
    gap, rcm, branch = loop_health(world, trajectory, every)
    centred = any(name in trajectory.positions for name in world.remote_centres())
    return HeadlessReport(
        rig=world.rig.name,
        timestep_s=world.timestep,
        simulated_s=timing.simulated,
        wall_s=wall,
        real_time_factor=timing.simulated / wall,
        bare_real_time_factor=timing.bare_real_time_factor,
        overhead=timing.overhead,
        overhead_at_rest=timing.overhead_at_rest,
        loop_gap_um_max=1e6 * gap,
        rcm_error_um_max=1e6 * rcm if centred else None,
        rcm_wander_um_max=1e6 * world.health().rcm_wander_m if centred else None,
        branch_ok=branch,
        tracking_rms=tracking_rms(world, trajectory, timing.recording),
    )


def _paced_pass(world: World, trajectory: TestTrajectory, every: int) -> float:
    """Play a trajectory tick by tick on the wall clock and return how long that took [s]."""
    clock = WallClock()
    begin_trajectory(world, trajectory)
    pace = Pace(clock, TICK_S)
    before = clock.now()
    for row in range(len(next(iter(trajectory.positions.values())))):
        part = slice(row, row + 1)
        world.play(
            {name: q[part] for name, q in trajectory.positions.items()},
            {name: v[part] for name, v in trajectory.velocities.items()},
            every=every,
            record=False,
        )
        pace.wait()
    return clock.now() - before
