"""An hour of the whole cart in motion, in which no error, warning or memory use may grow."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from trocar.apps.figures import Figure
from trocar.apps.trials import TICK_S, begin_trajectory, paper_sine, periods_per_tick
from trocar.errors import InputError
from trocar.simulation import World
from trocar.simulation.health import arm_health

#: Simulated time of a soak, and its first and last part that are compared. Source: the project's
#: own goal. [s]
DURATION_S, WINDOW_S = 3600.0, 60.0
#: Simulated time that is played and checked at once, one swing of the sine. Source: our own choice;
#: some 6 MB. [s]
PIECE_S = 10.0
#: Share that is compared of runs shorter than two windows. Source: our own choice.
SHORT_SHARE = 0.25
#: Allowed ratio of the last part to the first, and growth of memory. Source: the project's goal
#: ("do not grow", "flat to 1 %"); 5 % are for swings that begin a little otherwise than the first.
MOST_GROWTH, MOST_MEMORY_PERCENT = 1.05, 1.0


@dataclass(frozen=True)
class Worst:
    """Worst of a stretch: loop gap [m], remote-centre error [m], whether branches were kept."""

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


def soak(
    duration_s: float = DURATION_S,
    watch: Callable[[str], None] = lambda _: None,
    rig: str = "full_cart",
) -> list[Figure]:
    """Drive a rig along the test sine for long and compare its end with its beginning.

    The sine is made and played a piece at a time, so memory does not grow with the duration. But
    for memory, the same duration gives the same figures.

    Args:
        duration_s: simulated time; its first and last minute are compared, a quarter of runs
            shorter than two minutes [s]
        watch: called with the progress
        rig: name of a built-in rig, or a path

    Raises:
        InputError: the duration is no number above 0
        DivergedError: the simulation left the finite numbers
    """
    if not 0.0 < duration_s < float("inf"):
        raise InputError(f"soak: got {duration_s!r} s; allowed: above 0")
    world = World(rig)
    begin_trajectory(world, paper_sine(world.rig, TICK_S, TICK_S))
    refused = sum(arm.warnings for arm in world.arms.values())
    window = WINDOW_S if duration_s >= 2.0 * WINDOW_S else SHORT_SHARE * duration_s
    first, last, whole = Worst(), Worst(), Worst()
    memory: list[int] = []  # after the first part, and from then on
    clipped, told = 0, 0.0
    for begin, end in pieces(duration_s, window):
        worst, more = play_piece(world, begin, end)
        clipped, whole = clipped + more, whole.or_worse(worst)
        now = resident_memory()
        if end <= window + 0.5 * TICK_S:
            first, memory = first.or_worse(worst), []
        if begin >= duration_s - window - 0.5 * TICK_S:
            last = last.or_worse(worst)
        memory += [] if now is None else [now]
        if end - told >= WINDOW_S or end >= duration_s:
            watch(f"soak: {end:g} of {duration_s:g} s")
            told = end
    refused = sum(arm.warnings for arm in world.arms.values()) - refused
    part = f"{window:g} s"
    found = [Figure("soak: simulated time", duration_s, "s")]
    for name, key in (("loop gap", "loop_gap_m"), ("remote-centre error", "rcm_error_m")):
        at_first, at_last, most = (1e6 * getattr(worst, key) for worst in (first, last, whole))
        found += [
            Figure(f"soak: {name}, first {part}", at_first, "um"),
            Figure(f"soak: {name}, last {part}", at_last, "um", MOST_GROWTH * at_first),
            Figure(f"soak: {name}, all the time", most, "um"),
        ]
    found.append(Figure("soak: branch flips", float(not whole.branch_ok), "", 0.0))
    if memory:
        grown = 100.0 * (max(memory) / memory[0] - 1.0)
        # a process still allocates its buffers in the first minute
        allowed = MOST_MEMORY_PERCENT if window >= WINDOW_S else None
        found += [
            Figure(f"soak: resident memory after the first {part}", memory[0] / 1e6, "MB"),
            Figure("soak: growth of it from then on", grown, "%", allowed),
        ]
    else:
        found.append(Figure("soak: resident memory (not available here)", float("nan"), "MB"))
    warnings = sum(world.engine_warnings().values())
    found.append(Figure("soak: warnings of MuJoCo", warnings, "", 0.0))
    return [*found, Figure("soak: commands refused or clipped", refused + clipped, "", 0.0)]


def resident_memory() -> int | None:
    """Return the resident memory of this process [byte]; None where it is not available.

    Source: Linux, proc(5): the second number of /proc/self/statm is the resident pages.
    """
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def pieces(duration_s: float, window_s: float) -> Iterator[tuple[float, float]]:
    """Cut a duration into pieces of whole ticks that end where the compared parts do."""
    ticks = max(1, round(duration_s / TICK_S))
    edge = max(1, round(window_s / TICK_S))
    at = 0
    while at < ticks:
        ends = [at + round(PIECE_S / TICK_S), ticks, *(e for e in (edge, ticks - edge) if e > at)]
        yield at * TICK_S, min(ends) * TICK_S
        at = min(ends)


def play_piece(world: World, begin_s: float, end_s: float) -> tuple[Worst, int]:
    """Play a piece of the sine; return the worst of its samples and the count of clipped rows."""
    sine = paper_sine(world.rig, end_s - begin_s, TICK_S, begin_s)
    played = world.play(sine.positions, sine.velocities, every=periods_per_tick(world))
    worst = Worst()
    for name in sine.positions:
        found = arm_health(world.rig.arm(name).arm, played.coordinates[name])
        worst = worst.or_worse(Worst(found.loop_gap_m, found.rcm_error_m, found.branch_ok))
    return worst, sum(played.clipped.values())
