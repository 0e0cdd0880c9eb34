"""An hour of the whole cart in motion: nothing may grow, be refused or be warned of."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from trocar.apps.benchmarks.figures import Figure
from trocar.apps.trials import TICK_S, begin_trajectory, paper_sine, periods_per_tick
from trocar.errors import InputError
from trocar.simulation import World
from trocar.simulation.health import arm_health

#: Simulated time of a soak, and its first and last part that are compared. Source: the project's
#: own goal. [s]
DURATION_S = 3600.0
WINDOW_S = 60.0
#: Simulated time that is played and looked at at once, one swing of the sine; shorter in runs too
#: short for whole minutes. Source: our own choice; some 6 MB. [s]
PIECE_S = 10.0
#: Runs shorter than two windows compare this share of themselves. Source: our own choice.
SHORT_SHARE = 0.25
#: Times that differ by less are the same. Source: half a tick. [s]
HAIR_S = 0.5 * TICK_S
#: How much the last part may be worse than the first, and memory grow. Source: the project's goal
#: ("do not grow", "flat to 1 %"); 5 % are for swings that begin a little otherwise than the first.
MOST_GROWTH = 1.05
MOST_MEMORY_PERCENT = 1.0


@dataclass(frozen=True)
class Worst:
    """The worst of a stretch: loop gap [m], remote-centre error [m], whether branches were kept."""

    loop_gap_m: float = 0.0
    rcm_error_m: float = 0.0
    branch_ok: bool = True

    def or_worse(self, other: Worst) -> Worst:
        """Return the worst of both."""
        return Worst(
            max(self.loop_gap_m, other.loop_gap_m),
            max(self.rcm_error_m, other.rcm_error_m),
            self.branch_ok and other.branch_ok,
        )


@dataclass(frozen=True)
class SoakState:
    """A soak so far.

    Attributes:
        first, last, all: the worst of the first part, of the last, of everything
        memory: resident memory after the first part, and the most since [byte]; None: not available
        clipped: rows of set-points that lay beyond a limit
    """

    first: Worst = Worst()
    last: Worst = Worst()
    all: Worst = Worst()
    memory: tuple[int, int] | None = None
    clipped: int = 0


def soak(
    duration_s: float = DURATION_S,
    watch: Callable[[str], None] | None = None,
    rig: str = "full_cart",
) -> list[Figure]:
    """Drive a rig along the test sine for long and compare its end with its beginning.

    The sine is made and played a piece at a time, so memory does not grow with the duration. But
    for memory, the same duration gives the same figures.

    Args:
        duration_s: simulated time; its first and last minute are compared, a quarter of runs
            shorter than two minutes [s]
        watch: told how far it is
        rig: name of a built-in rig, or a path

    Raises:
        InputError: the duration is no number above 0
        DivergedError: the simulation left the finite numbers
    """
    if not 0.0 < duration_s < float("inf"):
        raise InputError(f"soak: got {duration_s!r} s; allowed: above 0")
    world = World(rig)
    begin_trajectory(world, paper_sine(world.rig, TICK_S, TICK_S))
    before = _refused(world)
    window = WINDOW_S if duration_s >= 2.0 * WINDOW_S else SHORT_SHARE * duration_s
    state, told = SoakState(), 0.0
    for begin, end in _pieces(duration_s, window):
        worst, clipped = _play(world, begin, end)
        part = (end <= window + HAIR_S, begin >= duration_s - window - HAIR_S)
        state = _after(state, worst, clipped, part)
        if watch is not None and (end - told >= WINDOW_S or end >= duration_s):
            watch(f"soak: {end:g} of {duration_s:g} s")
            told = end
    return list(_figures(state, world, duration_s, window, _refused(world) - before))


def resident_memory() -> int | None:
    """Return how much memory this process has in RAM [byte], None where nobody tells.

    Source: Linux, proc(5): the second number of /proc/self/statm is the resident pages.
    """
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def _pieces(duration_s: float, window_s: float) -> Iterator[tuple[float, float]]:
    """Cut a duration into pieces of whole ticks that end where the compared parts do."""
    ticks = max(1, round(duration_s / TICK_S))
    edge = max(1, round(window_s / TICK_S))
    longest = round(PIECE_S / TICK_S)
    at = 0
    while at < ticks:
        ends = [at + longest, ticks, *(e for e in (edge, ticks - edge) if e > at)]
        yield at * TICK_S, min(ends) * TICK_S
        at = min(ends)


def _play(world: World, begin_s: float, end_s: float) -> tuple[Worst, int]:
    """Play a piece of the sine and return the worst of its samples, and how many were clipped."""
    sine = paper_sine(world.rig, end_s - begin_s, TICK_S, begin_s)
    played = world.play(sine.positions, sine.velocities, every=periods_per_tick(world))
    worst = Worst()
    for name in sine.positions:
        found = arm_health(world.rig.arm(name).arm, played.coordinates[name])
        worst = worst.or_worse(Worst(found.loop_gap_m, found.rcm_error_m, found.branch_ok))
    return worst, sum(played.clipped.values())


def _after(state: SoakState, worst: Worst, clipped: int, part: tuple[bool, bool]) -> SoakState:
    """Return the state with a piece more, which may belong to the first or the last part."""
    in_first, in_last = part
    memory, now = state.memory, resident_memory()
    if now is not None:
        memory = (now, now) if in_first or memory is None else (memory[0], max(memory[1], now))
    return replace(
        state,
        first=state.first.or_worse(worst) if in_first else state.first,
        last=state.last.or_worse(worst) if in_last else state.last,
        all=state.all.or_worse(worst),
        memory=memory,
        clipped=state.clipped + clipped,
    )


def _refused(world: World) -> int:
    return sum(arm.warnings for arm in world.arms.values())


def _figures(
    state: SoakState, world: World, duration_s: float, window_s: float, refused: int
) -> Iterator[Figure]:
    part = f"{window_s:g} s"
    yield Figure("soak: simulated time", duration_s, "s")
    for name, first, last, most in (
        ("loop gap", state.first.loop_gap_m, state.last.loop_gap_m, state.all.loop_gap_m),
        ("remote-centre error", state.first.rcm_error_m, state.last.rcm_error_m,
         state.all.rcm_error_m),
    ):  # fmt: skip
        yield Figure(f"soak: {name}, first {part}", 1e6 * first, "um")
        yield Figure(f"soak: {name}, last {part}", 1e6 * last, "um", 1e6 * MOST_GROWTH * first)
        yield Figure(f"soak: {name}, all the time", 1e6 * most, "um")
    yield Figure("soak: branch flips", float(not state.all.branch_ok), "", 0.0)
    if state.memory is None:
        yield Figure("soak: resident memory (not available here)", float("nan"), "MB")
    else:
        after, most = state.memory
        grown = 100.0 * (most / after - 1.0)
        yield Figure(f"soak: resident memory after the first {part}", after / 1e6, "MB")
        # Before the first minute is over, the process still meets its buffers for the first time.
        most_grown = MOST_MEMORY_PERCENT if window_s >= WINDOW_S else None
        yield Figure("soak: growth of it from then on", grown, "%", most_grown)
    yield Figure("soak: warnings of MuJoCo", sum(world.engine_warnings().values()), "", 0.0)
    yield Figure("soak: commands refused or clipped", refused + state.clipped, "", 0.0)
