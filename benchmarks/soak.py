"""Hours of the whole cart in motion, in which no error, energy, memory or file handle may grow."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from trocar.errors import InputError
from trocar.plotting.drawing import MEASURED, new_figure, png
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.simulation.health import arm_health
from trocar.simulation.trials import TICK_S, begin_trajectory, paper_sine, periods_per_tick

#: Simulated time of a soak, and of its windows. Source: the project's own goal. [s]
DURATION_S, WINDOW_S = 3600.0, 60.0
#: Simulated time that is played and checked at once, one swing of the sine. Source: our own choice;
#: some 6 MB. [s]
PIECE_S = 10.0
#: Windows of runs shorter than two minutes. Source: our own choice.
SHORT_WINDOWS = 4
#: Allowed ratio of the last window to the first, growth of memory, and of open files. Source: the
#: project's goal ("do not grow", "flat to 1 %"); 5 % are for swings that begin a little otherwise
#: than the first.
MOST_GROWTH, MOST_MEMORY_PERCENT, MOST_HANDLES = 1.05, 1.0, 0.0


@dataclass(frozen=True)
class Window:
    """Worst samples of a window of a soak, and the process at its end.

    Attributes:
        end_s: simulated time of its end [s]
        loop_gap_m: loop gap [m]
        rcm_error_m: remote-centre error [m]
        branch_ok: whether every loop kept its branch
        rest_energy_j: kinetic energy of the arm that rests [J]; 0 where every arm moves
        rest_fall_j: potential energy that it has lost since the first window's end [J]
        clipped: set-points beyond a limit
        memory: resident memory [byte]; None where it is not available
        handles: open file handles; None where they are not available
    """

    end_s: float = 0.0
    loop_gap_m: float = 0.0
    rcm_error_m: float = 0.0
    branch_ok: bool = True
    rest_energy_j: float = 0.0
    rest_fall_j: float = 0.0
    clipped: int = 0
    memory: int | None = None
    handles: int | None = None

    def joined(self, later: Window) -> Window:
        """Return the worst of both, at the end of the later one."""
        return Window(
            later.end_s,
            max(self.loop_gap_m, later.loop_gap_m),
            max(self.rcm_error_m, later.rcm_error_m),
            self.branch_ok and later.branch_ok,
            max(self.rest_energy_j, later.rest_energy_j),
            later.rest_fall_j,
            self.clipped + later.clipped,
            later.memory,
            later.handles,
        )


@dataclass(frozen=True)
class Soak:
    """A soak: its figures, and its windows in order."""

    figures: list[Figure]
    windows: list[Window]


def soak(
    duration_s: float = DURATION_S,
    watch: Callable[[str], None] = lambda _: None,
    rig: str = "full_cart",
) -> Soak:
    """Drive a rig along the test sine for long and compare its last window with its first.

    The last of several PSMs rests at its middle position meanwhile. The sine is made and played a
    piece at a time, so memory does not grow with the duration. But for memory and file handles, the
    same duration gives the same figures. Ctrl-C ends it after the last whole window.

    Args:
        duration_s: simulated time; windows are minutes, quarters of runs below two minutes [s]
        watch: called with the progress
        rig: name of a built-in rig, or a path

    Raises:
        InputError: the duration is no number above 0
        DivergedError: the simulation left the finite numbers
        KeyboardInterrupt: before the end of the first window
    """
    if not 0.0 < duration_s < float("inf"):
        raise InputError(f"soak: got {duration_s!r} s; allowed: above 0")
    world = World(rig, dynamics="cad")
    arm = resting_arm(world)
    begin_trajectory(world, paper_sine(world.rig, TICK_S, TICK_S))
    energy = RestEnergy(world, arm)
    rejected = sum(arm.rejections.count for arm in world.arms.values())
    windows: list[Window] = []
    try:
        for edges in window_edges(duration_s):
            worst = Window()
            for begin, end in edges:
                played = play_piece(world, begin, end, arm)
                worst = worst.joined(replace(played, end_s=end, rest_energy_j=energy.kinetic()))
            windows.append(
                replace(
                    worst,
                    rest_fall_j=energy.fallen(),
                    memory=resident_memory(),
                    handles=file_handles(),
                )
            )
            watch(f"soak: {windows[-1].end_s:g} of {duration_s:g} s")
    except KeyboardInterrupt:
        if not windows:
            raise
    rejected = sum(arm.rejections.count for arm in world.arms.values()) - rejected
    warnings = sum(world.engine_warnings().values())
    found = [
        *compared(windows, arm),
        Figure("soak: warnings of MuJoCo", warnings, "", 0.0),
        Figure(
            "soak: commands rejected or clipped",
            rejected + sum(window.clipped for window in windows),
            "",
            0.0,
        ),
    ]
    return Soak(found, windows)


def soak_figures(
    watch: Callable[[str], None], duration_s: float = DURATION_S, output: Path | None = None
) -> list[Figure]:
    """Measure a soak, and plot it into the file `output` where one is named."""
    found = soak(duration_s, watch)
    if output is not None:
        output.write_bytes(draw(found.windows))
    return found.figures


def compared(windows: Sequence[Window], arm: str) -> list[Figure]:
    """Return the figures of windows, the last beside the first; `arm` rests, "" for none."""
    first, last, whole = windows[0], windows[-1], windows[0]
    for window in windows[1:]:
        whole = whole.joined(window)
    part = f"{first.end_s:g} s"
    found = [Figure("soak: simulated time", last.end_s, "s")]
    rows = [
        ("loop gap", "loop_gap_m", 1e6, "um"),
        ("remote-centre error", "rcm_error_m", 1e6, "um"),
    ]
    if arm:
        rows.append((f"kinetic energy of {arm} at rest", "rest_energy_j", 1e9, "nJ"))
    for name, key, factor, unit in rows:
        at_first, at_last, most = (factor * getattr(each, key) for each in (first, last, whole))
        found += [
            Figure(f"soak: {name}, first {part}", at_first, unit),
            Figure(f"soak: {name}, last {part}", at_last, unit, MOST_GROWTH * at_first),
            Figure(f"soak: {name}, all the time", most, unit),
        ]
    if arm:
        fallen = 1e6 * (last.rest_fall_j - first.rest_fall_j)
        found.append(Figure(f"soak: potential energy of {arm} at rest, lost", fallen, "uJ"))
    found.append(Figure("soak: branch flips", float(not whole.branch_ok), "", 0.0))
    memory = [window.memory for window in windows if window.memory is not None]
    if memory:
        grown = 100.0 * (max(memory) / memory[0] - 1.0)
        # a process still allocates its buffers in the first minute
        allowed = MOST_MEMORY_PERCENT if first.end_s >= WINDOW_S else None
        found += [
            Figure(f"soak: resident memory after the first {part}", memory[0] / 1e6, "MB"),
            Figure("soak: growth of it from then on", grown, "%", allowed),
        ]
    else:
        found.append(Figure("soak: resident memory (not available here)", float("nan"), "MB"))
    handles = [window.handles for window in windows if window.handles is not None]
    if handles:
        found += [
            Figure(f"soak: open files after the first {part}", handles[0], ""),
            Figure("soak: more of them later", max(handles) - handles[0], "", MOST_HANDLES),
        ]
    return found


def draw(windows: Sequence[Window]) -> bytes:
    """Return a plot of the windows of a soak over simulated time, as PNG.

    Raises:
        MissingExtraError: matplotlib is not installed
    """
    hours = [window.end_s / 3600.0 for window in windows]
    rows = [
        ("loop gap [um]", [1e6 * w.loop_gap_m for w in windows]),
        ("RCM error [um]", [1e6 * w.rcm_error_m for w in windows]),
        ("arm at rest:\nmotion [nJ]", [1e9 * w.rest_energy_j for w in windows]),
        ("arm at rest:\nfall [uJ]", [1e6 * w.rest_fall_j for w in windows]),
        ("memory [MB]", [(w.memory or 0) / 1e6 for w in windows]),
        ("open files", [float(w.handles or 0) for w in windows]),
    ]
    figure = new_figure(7.0, 7.0, "drawing a soak")
    panels = figure.subplots(len(rows), sharex=True)
    for axes, (label, values) in zip(panels, rows, strict=True):
        axes.plot(hours, values, color=MEASURED, marker="." if len(hours) < 100 else "")
        axes.set_ylabel(label)
        axes.set_ylim(0.0, 1.3 * max(*values, 1e-9))
        axes.grid(alpha=0.3)
    panels[-1].set_xlabel("simulated time [h]")
    return png(figure)


def resting_arm(world: World) -> str:
    """Return the last of a rig's PSMs, or "" where there are fewer than two."""
    names = [arm.name for arm in world.rig.arms if arm.arm.type == "PSM"]
    return names[-1] if len(names) > 1 else ""


class RestEnergy:
    """Watches the energy of an arm that rests, about its own hinges.

    Args:
        world: is sampled every tick from now on
        arm: that is watched; "" for none, whose energy is 0
    """

    def __init__(self, world: World, arm: str) -> None:
        self._most = 0.0
        self._first: float | None = None
        self._arm = arm
        if arm:
            self._model, self._data = world.mj_model, world.mj_data
            index = world.arm(arm).runtime.motors.index
            self._dof, self._bodies = index.dof, list(index.bodies.values())
            self._velocity, self._momentum = np.zeros((2, world.mj_model.nv))
            world.observe(self._sample, periods_per_tick(world))

    def kinetic(self) -> float:
        """Return the largest kinetic energy since the last call [J]."""
        most, self._most = self._most, 0.0
        return most

    def fallen(self) -> float:
        """Return the potential energy that the arm has lost since the first call [J]."""
        if not self._arm:
            return 0.0
        weights = self._model.body_mass[self._bodies, None] * self._model.opt.gravity
        potential = -float((weights * self._data.xipos[self._bodies]).sum())
        self._first = potential if self._first is None else self._first
        return self._first - potential

    def _sample(self) -> None:
        own = self._data.qvel[self._dof]
        self._velocity[self._dof] = own
        mujoco.mj_mulM(self._model, self._data, self._momentum, self._velocity)
        self._most = max(self._most, 0.5 * float(own @ self._momentum[self._dof]))


def resident_memory() -> int | None:
    """Return the resident memory of this process [byte]; None where it is not available.

    Source: Linux, proc(5): the second number of /proc/self/statm is the resident pages.
    """
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def file_handles() -> int | None:
    """Return how many file handles this process has open; None where that is not available.

    Source: Linux, proc(5): /proc/self/fd has an entry for each, the one of the listing included.
    """
    try:
        return len(os.listdir("/proc/self/fd")) - 1
    except OSError:
        return None


def window_edges(duration_s: float) -> Iterator[list[tuple[float, float]]]:
    """Cut a duration into equal windows, each into pieces of whole ticks, (begin, end) [s]."""
    ticks = max(1, round(duration_s / TICK_S))
    count = int(duration_s // WINDOW_S)
    count = min(ticks, count if count >= 2 else SHORT_WINDOWS)
    edges = [round(k * ticks / count) for k in range(count + 1)]
    most = round(PIECE_S / TICK_S)
    for begin, end in pairwise(edges):
        starts = range(begin, end, most)
        yield [(at * TICK_S, min(at + most, end) * TICK_S) for at in starts]


def play_piece(world: World, begin_s: float, end_s: float, resting: str = "") -> Window:
    """Play a piece of the sine on all arms but one; return the worst of its samples."""
    sine = paper_sine(world.rig, end_s - begin_s, TICK_S, begin_s)
    moved = [name for name in sine.positions if name != resting]
    played = world.play(
        {name: sine.positions[name] for name in moved},
        {name: sine.velocities[name] for name in moved},
        every=periods_per_tick(world),
    )
    worst = Window(clipped=sum(played.clipped.values()))
    for name in sine.positions:
        found = arm_health(world.rig.arm(name).arm, played.coordinates[name])
        worst = worst.joined(Window(end_s, found.loop_gap_m, found.rcm_error_m, found.branch_ok))
    return worst
