"""Speed of a world beside bare MuJoCo: headless runs, and the configurations of Table 9."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_rig
from trocar.descriptions.overlay import Overlay
from trocar.errors import InputError
from trocar.live.loop import WallClock
from trocar.live.pace import Pace
from trocar.simulation import World
from trocar.simulation.records import Recording
from trocar.simulation.trials import (
    TICK_S,
    TestTrajectory,
    begin_trajectory,
    loop_health,
    paper_sine,
    periods_per_tick,
    tracking_rms,
)
from trocar.simulation.world import INTEGRATION

Array = NDArray[np.float64]

#: Configurations: title, rig, setup joints, the paper's real-time factor, and ours at least.
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
#: Simulated time of a pass. Source: our own choice. [s]
PASS_S = 10.0


@dataclass(frozen=True, eq=False)
class Timing:
    """Wall-clock seconds of one trajectory, medians over interleaved passes.

    Attributes:
        simulated: simulated time of a pass [s]
        own: the world with set-points written and samples taken [s]
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
    world: World,
    trajectory: TestTrajectory,
    every: int,
    passes: int = 5,
    watch: Callable[[str], None] = lambda _: None,
) -> Timing:
    """Play a trajectory, step the same model alone, and play with a clock around mj_step, in turn.

    An arm at rest is cheaper to step than one in motion (fewer iterations of the solver), so
    `overhead` compares the same motion, and `overhead_at_rest` is the larger of the two.

    Args:
        world: is reset before each pass
        trajectory: what the arms follow
        every: physics periods of a row
        passes: how often each is done
        watch: called with the name of each pass
    """
    count = every * len(next(iter(trajectory.positions.values())))
    own: list[float] = []
    bare: list[float] = []
    at_rest: list[float] = []
    recording: Recording | None = None
    for done in range(passes):
        watch(f"pass {done + 1} of {passes}")
        begin_trajectory(world, trajectory)
        before = time.perf_counter()
        recording = world.play(trajectory.positions, trajectory.velocities, every=every)
        own.append(time.perf_counter() - before)
        begin_trajectory(world, trajectory)
        model, data = world.mj_model, mujoco.MjData(world.mj_model)
        mujoco.mj_setState(model, data, world.save().row, INTEGRATION)
        before = time.perf_counter()
        mujoco.mj_step(model, data, nstep=count)
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


def _seconds_in_mujoco(world: World, trajectory: TestTrajectory, every: int) -> float:
    """Play a trajectory, and return how long mj_step alone takes for the same motion [s]."""
    begin_trajectory(world, trajectory)
    start, told = world.save().row, list[Array]()
    stop = world.observe(lambda: told.append(world.servos.setpoint.ravel().copy()), every)
    world.play(trajectory.positions, trajectory.velocities, every=every, record=False)
    stop()
    model = world.mj_model
    data, spent = mujoco.MjData(model), 0.0
    mujoco.mj_setState(model, data, start, INTEGRATION)
    for ctrl in told:
        data.ctrl[:] = ctrl
        before = time.perf_counter()
        mujoco.mj_step(model, data, every)
        spent += time.perf_counter() - before
    return spent


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
        watch: called with the name of what is measured next
        overlays: calibrations of the arms that they are of, wherever a configuration has one

    Raises:
        InputError: a calibration of an arm that no configuration has
    """
    kinds = {row[1]: {arm.arm.name for arm in load_rig(row[1]).arms} for row in CONFIGURATIONS}
    for overlay in overlays:
        if not any(overlay.arm in of_rig for of_rig in kinds.values()):
            known = ", ".join(sorted({name for of_rig in kinds.values() for name in of_rig}))
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


@dataclass(frozen=True)
class HeadlessReport:
    """Report of a headless run; `tracking_rms` is {arm: {joint: rad or m}}.

    `wall_s` is how long the run took with all that it measured, `pass_s` one pass over
    `simulated_s`, the median, of which the real-time factor is.

    `rcm_error_um_max` is None where no arm has a remote centre; `rcm_wander_um_max` is how much of
    it the arms' own geometry may account for over the range of the joints, 0 but for calibrated
    arms whose centre wanders.
    """

    rig: str
    timestep_s: float
    simulated_s: float
    wall_s: float
    pass_s: float
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
    watch: Callable[[str], None] = lambda _: None,
) -> HeadlessReport:
    """Drive every arm of a world but its setup joints along the test trajectory.

    The timed passes sample every 5 ms; loop health is that of a separate, untimed pass that
    samples every physics period. In real time another pass keeps to the wall clock, and it is
    that one's time and factor that are reported. With `record` one more pass, the first and
    untimed, runs inside the context that it returns. `watch` is called with the name of each pass.

    Raises:
        InputError: the duration, a timestep that 5 ms is no whole multiple of, or a file that
            cannot be written
        DivergedError: the simulation left the finite numbers
    """
    begun = time.perf_counter()
    every = periods_per_tick(world)
    trajectory = paper_sine(world.rig, duration_s, TICK_S)
    if record is not None:
        watch("recording")
        with record():
            begin_trajectory(world, trajectory)
            world.play(trajectory.positions, trajectory.velocities, every=every, record=False)
    timing = time_beside_bare(world, trajectory, every, passes, watch)
    pass_s = timing.own
    if realtime:
        watch("pass in real time")
        pass_s = _paced_pass(world, trajectory, every)
    watch("loop error")
    gap, rcm, branch = loop_health(world, trajectory, every)
    centred = any(name in trajectory.positions for name in world.remote_centres())
    return HeadlessReport(
        rig=world.rig.name,
        timestep_s=world.timestep,
        simulated_s=timing.simulated,
        wall_s=time.perf_counter() - begun,
        pass_s=pass_s,
        real_time_factor=timing.simulated / pass_s,
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
