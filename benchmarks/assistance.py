"""What virtual fixtures do for a noisy operator: error and time along a line and a needle's arc.

The operator is a model: a hand holds the handle of a simulated master by a spring and a damper and
leads it along the path. It drifts and trembles; the eye sees the instrument's deviation from the
path late, and the hand corrects it, and slows down meanwhile. Everything between handle and
instrument is the simulation's: the master's dynamics and friction, teleoperation, the instrument.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt
from scipy.stats import t as student

from trocar.descriptions.fixtures import Fixture, NeedleArc, Tube, read_fixtures
from trocar.errors import InputError
from trocar.live import Loop
from trocar.plotting.drawing import new_figure, png
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.teleoperation import Teleoperation
from trocar.teleoperation.masters import ArmMaster
from trocar.teleoperation.psm import PsmTeleoperation
from trocar.teleoperation.slave import view_in_world
from trocar.teleoperation.virtual_fixtures import Fixtures

Array = NDArray[np.float64]

FOLDER = Path(__file__).parents[1] / "examples" / "assistance"
PATHS = {"line": "line.toml", "needle arc": "needle_arc.toml"}
CONDITIONS = ("none", "force", "filter")
SEEDS = 50
CONFIDENCE = 0.95

TICK_S = 0.001
#: A trial that takes longer has failed. Source: our own choice; a trial takes 2 to 5 s. [s]
LIMIT_S = 20.0
#: Time between two looks at the instrument. Source: our own choice, a display of 100 Hz. [s]
LOOK_S = 0.01
#: Stiffness and damping of the hand at the handle. Source: Tsuji et al., Biological Cybernetics 72,
#: 1995: 100 to 400 N/m and 5 to 20 N s/m of the hand of an arm at rest. [N/m, N s/m]
HAND_N_M, HAND_NS_M = 300.0, 10.0
#: Delay from a deviation on the display to its correction. Source: 0.11 to 0.16 s without a
#: display, Brenner and Smeets, Journal of Motor Behavior 29, 1997, Saunders and Knill, Experimental
#: Brain Research 152, 2003; the delay of a display on top is our own choice. [s]
DELAY_S = 0.2
#: Rate of correction. Source: the crossover model with such a delay, McRuer and Jex, IEEE Trans.
#: Human Factors in Electronics 8, 1967, whose crossover lies at 3 to 5 rad/s. [1/s]
CORRECTION = 3.0
#: Drift of the hand on each axis, root mean square, and its band. Source: our own choice, 2 % of a
#: reach of 0.1 m; the band of voluntary motion of surgeons, Riviere, Rader and Khosla, IEEE EMBS
#: 1997: 98.9 % of its power below 2 Hz. [m, Hz]
DRIFT_M, DRIFT_HZ = 0.002, 2.0
#: Tremor on each axis, root mean square, and its band. Source: 8 to 12 Hz, with a mean of 8.1 Hz in
#: surgeons (Muerbe et al., Otology and Neurotology 22, 2001); the size is our own choice, twice
#: that of eye surgeons who hold an instrument still (Riviere, 49 um in all). [m, Hz]
TREMOR_M, TREMOR_HZ = 0.0001, (8.0, 12.0)
#: Speed of the hand on the path. Source: our own choice. [m/s]
SPEED = 0.05
#: Deviation at which the hand goes no further, and least part of its speed. Source: our own choice;
#: slowing by error as in the steering law, Accot and Zhai, ACM CHI 1997. [m]
TOLERANCE_M, SLOWEST = 0.001, 0.1


@dataclass(frozen=True)
class Trial:
    """One run along a path.

    Attributes:
        rms, largest: distance from the instrument's tip to the path [m]
        time: from start to end [s]
        tips: (k, 3) [m]
    """

    rms: float
    largest: float
    time: float
    tips: Array


class HeldMaster(ArmMaster):
    """A master that the modelled hand holds: the force of the hand and of fixtures act together."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.wrench = np.zeros(6)

    def release(self, world: World, *, locked: bool) -> None:
        """Let the hand move it."""
        super().release(world, locked=locked)
        self.wrench = np.zeros(6)

    def exert(self, world: World, wrench: Array) -> None:  # noqa: ARG002
        """Exert the wrench of fixtures from the next tick on."""
        self.wrench = wrench

    def push(self, world: World, force: Array) -> None:
        """Push the handle, (3,) [N] in the surgeon's axes, against the force of fixtures."""
        R = self.read(world).T[:3, :3]
        super().exert(world, np.concatenate([R.T @ force, np.zeros(3)]) + self.wrench)


class Operator:
    """The hand and the eye; a player of the teleoperation.

    Args:
        component: of the master that it holds and the instrument that it looks at
        master: that one
        fixture: whose path it follows
        seed: of drift and tremor
    """

    def __init__(
        self, component: PsmTeleoperation, master: HeldMaster, fixture: Fixture, seed: int
    ) -> None:
        self._component, self._master, self._world = component, master, component.world
        self._course = Course(fixture)
        self._noise = noise(seed)
        self._R = view_in_world(self._world)[:3, :3]
        self.restart()

    def restart(self) -> None:
        """Begin anew."""
        self._ticks, self.done, self.tips = 0, False, list[Array]()
        self._gone = 0.0
        self._seen: deque[Array] = deque([np.zeros(3)] * round(DELAY_S / LOOK_S))
        self._correction = np.zeros(3)
        self._start = np.zeros(3)
        self._before: tuple[Array, Array] | None = None

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self._ticks * TICK_S

    def tick(self, period_s: float) -> None:
        """Look, correct, and lead the handle on, once the instrument follows."""
        if not self._component.following or self.done:
            return
        hand = self._master.read(self._world).T[:3, 3]
        if self._ticks == 0:
            self._start = hand - self._noise[0]
        if self._ticks % round(LOOK_S / TICK_S) == 0:
            self._look()
        error = self._seen[0]
        self._correction += CORRECTION * period_s * self._R.T @ error / self._component.scale
        slow = max(SLOWEST, 1.0 - float(np.linalg.norm(error)) / TOLERANCE_M)
        self._gone += self._component.scale * SPEED * slow * period_s
        way = self._course.at(self._gone) - self._course.at(0.0)
        goal = self._start + self._R.T @ way / self._component.scale - self._correction
        goal += self._noise[self._ticks]
        before = (hand, goal) if self._before is None else self._before
        rates = (goal - before[1] - (hand - before[0])) / period_s
        self._before = hand, goal
        self._master.push(self._world, HAND_N_M * (goal - hand) + HAND_NS_M * rates)
        self._ticks += 1
        self.done = self._gone >= self._course.length or self.time >= LIMIT_S

    def trial(self) -> Trial:
        """Return what was measured."""
        tips = np.array(self.tips)
        errors = np.array([np.linalg.norm(p - self._course.core.nearest(p)) for p in tips])
        return Trial(float(np.sqrt(np.mean(errors**2))), float(errors.max()), self.time, tips)

    def _look(self) -> None:
        arm = self._component.description.slave
        tip = self._world.reference_pose(arm) @ self._world.arm(arm).local.measured_cp().matrix
        self.tips.append(tip[:3, 3])
        self._seen.popleft()
        self._seen.append(tip[:3, 3] - self._course.core.nearest(tip[:3, 3]))


class Course:
    """The path inside a tube or about an arc.

    Args:
        fixture: of one of these kinds

    Attributes:
        core: the path, as a region without clearance
        length: of the path [m]

    Raises:
        InputError: another kind
    """

    def __init__(self, fixture: Fixture) -> None:
        region = fixture.region
        if isinstance(region, Tube):
            points = region.points
        elif isinstance(region, NeedleArc):
            points = np.array([region.at(a) for a in np.linspace(0.0, region.sweep, 500)])
        else:
            raise InputError(f"{fixture.name}: no path; allowed: a tube or a needle_arc")
        self.core = replace(region, clearance=0.0)
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        self._points, self._gone = points, np.concatenate([[0.0], np.cumsum(lengths)])
        self.length = float(self._gone[-1])

    def at(self, gone: float) -> Array:
        """Return the point after a length [m], (3,) [m]."""
        return np.array([np.interp(gone, self._gone, axis) for axis in self._points.T])


def noise(seed: int) -> Array:
    """Return drift and tremor of the hand at every tick, (n, 3) [m]."""
    rng, count = np.random.default_rng(seed), round(LIMIT_S / TICK_S) + 1
    settle = round(2.0 / TICK_S)
    drift = butter(2, DRIFT_HZ, fs=1.0 / TICK_S, output="sos")
    tremor = butter(1, TREMOR_HZ, btype="bandpass", fs=1.0 / TICK_S, output="sos")
    found = np.zeros((count, 3))
    for sections, size in ((drift, DRIFT_M), (tremor, TREMOR_M)):
        white = rng.standard_normal((settle + count, 3))
        values = np.asarray(sosfilt(sections, white, axis=0))[settle:]
        found += size * values / values.std(axis=0)
    return found


def trials(name: str, condition: str, seeds: int) -> list[Trial]:
    """Run the operator along a path, once for each seed.

    Args:
        name: of the path
        condition: "none", "force" or "filter"
        seeds: how many
    """
    (fixture,) = read_fixtures(FOLDER / PATHS[name])
    world = World(FOLDER / "rig.toml")
    loop, master = Loop(world, tick_s=TICK_S, speed="max"), HeldMaster("MTMR")
    acting = None
    if condition == "force":
        acting = Fixtures(world, [fixture])
    elif condition == "filter":
        acting = Fixtures(world, [replace(fixture, mode="filter", stiffness=0.0)])
    engine = Teleoperation(loop, None, {"MTMR": master}, acting)
    engine.start()
    component = cast(PsmTeleoperation, engine.components["MTMR_PSM1"])
    component.set_align(False)
    component.lock_rotation(True)
    component.command("enable")
    found: list[Trial] = []
    for seed in range(seeds):
        world.reset()
        operator = Operator(component, master, fixture, seed)
        engine.players[:] = [operator]
        while not operator.done:
            loop.tick()
        found.append(operator.trial())
    return found


#: What is measured of a trial, its unit, and that of the display.
MEASURES = (("error RMS", "m", "mm"), ("error largest", "m", "mm"), ("time", "s", ""))
Results = dict[str, dict[str, list[Trial]]]


def assistance_figures(
    watch: Callable[[str], None], seeds: int = 50, output: Path | None = None
) -> list[Figure]:
    """Measure the operator with `seeds` trials of each, and draw some into `output` if named."""
    results = assistance(seeds, watch)
    if output is not None:
        output.write_bytes(draw(results))
    return figures(results)


def assistance(seeds: int, watch: Callable[[str], None]) -> Results:
    """Return the trials of each path and condition, which run in processes of their own.

    Args:
        seeds: trials of each
        watch: called with what is measured
    """
    results: Results = {}
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        running = {
            (name, condition): pool.submit(trials, name, condition, seeds)
            for name in PATHS
            for condition in CONDITIONS
        }
        for (name, condition), run in running.items():
            watch(f"assistance: {name}, {condition}, {seeds} trials")
            results.setdefault(name, {})[condition] = run.result()
    return results


def figures(results: Results) -> list[Figure]:
    """Return means over seeds with the half width of their 95 % interval, and paired differences.

    Bound: fixtures reduce the errors, beyond the 95 % interval of the paired difference.
    """
    found: list[Figure] = []
    for name, by_condition in results.items():
        plain = _table(by_condition["none"])
        for condition, runs in by_condition.items():
            here = _table(runs)
            for index, (what, unit, display) in enumerate(MEASURES):
                mean, half = interval(here[:, index])
                label = f"{name}, {condition}: {what}"
                shown: dict[str, Any] = {"unit": unit, "shown": display}
                source = f"mean of {len(runs)} seeds"
                found.append(Figure(label, mean, source=source, **shown))
                found.append(Figure(f"{label}, 95 % +-", half, source=source, **shown))
                if condition != "none":
                    less, half = interval(plain[:, index] - here[:, index])
                    lower = 0.0 if index < 2 else None
                    found.append(
                        Figure(
                            f"{label}, saved at least (95 %)",
                            less - half,
                            lower=lower,
                            source="paired with the same seeds without assistance",
                            **shown,
                        )
                    )
    return found


def interval(values: Array) -> tuple[float, float]:
    """Return the mean and the half width of its 95 % interval, by Student's distribution."""
    count = len(values)
    factor = float(student.ppf(0.5 + 0.5 * CONFIDENCE, count - 1))
    return float(values.mean()), factor * float(values.std(ddof=1)) / count**0.5


def _table(runs: Sequence[Trial]) -> Array:
    return np.array([[one.rms, one.largest, one.time] for one in runs])


def draw(results: Results) -> bytes:
    """Return a picture of some trials of each path and condition, PNG."""
    figure = new_figure(12.0, 6.4, "drawing assistance")
    axes: Any = figure.subplots(len(results), len(CONDITIONS), sharex="row", sharey="row")
    for row, (name, by_condition) in zip(axes, results.items(), strict=True):
        (fixture,) = read_fixtures(FOLDER / PATHS[name])
        course = Course(fixture)
        core = 1e3 * np.array([course.at(s) for s in np.linspace(0.0, course.length, 200)])
        for axis, (condition, runs) in zip(row, by_condition.items(), strict=True):
            for one in runs[:20]:
                axis.plot(1e3 * one.tips[:, 0], 1e3 * one.tips[:, 2], color="#1c7ed6", lw=0.6)
            axis.plot(core[:, 0], core[:, 2], color="#212529", lw=1.4)
            mean, half = interval(_table(runs)[:, 0])
            axis.set_title(f"{name}, {condition}: RMS {1e3 * mean:.2f} +- {1e3 * half:.2f} mm")
            axis.set_aspect("equal")
            axis.grid(visible=True, color="#dddddd", linewidth=0.6)
        row[0].set_ylabel("z [mm]")
    for axis in axes[-1]:
        axis.set_xlabel("x [mm]")
    return png(figure)
