"""Table 9: how many simulated seconds a second of the machine's time holds."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, closing

from trocar.apps.timing import CONFIGURATIONS, time_beside_bare
from trocar.apps.trials import TICK_S, begin_trajectory, paper_sine, periods_per_tick
from trocar.apps.verification.figure import Figure, Part
from trocar.errors import TrocarError
from trocar.rendering import Endoscope
from trocar.simulation import World

#: Simulated time of a pass, and passes of which the median counts. Source: our own choice. [s]
DURATION_S = 2.0
PASSES = 3
#: The row with the camera: the paper's figure, whose camera it is here, and how often a pair of
#: pictures is drawn. Source: closed-loop paper, Table 9; facts, section 6 (the slides' 60 Hz).
CAMERA = "SUJ + 3 PSM + ECM + camera"
PAPER_CAMERA, PRESET, RATE_HZ = 0.47, "dvrk_sd_640x480", 60.0
SOURCE = "closed-loop paper, Table 9 (Gazebo, i7-4770K); limit: no slower than that"


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
        figures.append(
            Figure(label, timing.real_time_factor, "", paper_simulation=paper, lower=paper,
                   source=SOURCE)
        )  # fmt: skip
    if watch is not None:
        watch(f"realtime: {CAMERA}")
    drawn = _with_camera(duration_s)
    if isinstance(drawn, Figure):
        figures.append(drawn)
        camera = (
            f"With the camera, every pair of pictures is drawn, {PRESET} at {RATE_HZ:g} Hz, in one"
            " pass; what draws may use all cores."
        )
    else:
        camera = f"The row with the camera is left out: {drawn}."
    notes = (
        "Real-time coefficient: simulated over wall-clock time, as fast as it goes, with bodies"
        " that collide. Gazebo's cannot exceed 1. Ours depends on the machine; nominal arms.",
        f"Median of {PASSES} passes of {duration_s:g} s at 1 kHz on one core, without the camera.",
        camera,
    )
    command = "trocar verify --only realtime"
    return Part("realtime", "", "Speed: Table 9 of the paper", tuple(figures), command, notes)


def _with_camera(duration_s: float) -> Figure | str:
    """Drive the whole cart while its endoscope is drawn, or say why it cannot be."""
    world = World("full_cart", friction="paper")
    with ExitStack() as stack:
        try:
            scope = stack.enter_context(closing(Endoscope(world, "endoscope", preset=PRESET)))
            scope.capture()  # the first takes long: everything is made then
        except TrocarError as problem:
            return str(problem)
        factor = _factor_with(scope, world, duration_s)
    return Figure(
        CAMERA, factor, "", paper_simulation=PAPER_CAMERA, lower=PAPER_CAMERA, source=SOURCE
    )


def _factor_with(scope: Endoscope, world: World, duration_s: float) -> float:
    sine = paper_sine(world.rig, duration_s, TICK_S)
    begin_trajectory(world, sine)
    begun, begun_at, drawn = time.perf_counter(), world.time, 0

    def look() -> None:
        nonlocal drawn
        if world.time - begun_at >= drawn / RATE_HZ:
            scope.capture_next()
            drawn += 1

    leave = world.observe(look, every=5)
    world.play(sine.positions, sine.velocities, every=periods_per_tick(world), record=False)
    factor = (world.time - begun_at) / (time.perf_counter() - begun)
    leave()
    return factor
