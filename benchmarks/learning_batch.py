"""Batches of scenes on two threads: their speed over one task, parity, resets and images."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.learning.images import SceneCamera
from trocar.learning.scene_batch import SceneBatch
from trocar.tasks import Task, make_task
from trocar.tasks.controller import PERIOD_S

Array = NDArray[np.float64]
Watch = Callable[[str], None]
#: A figure, its value, its unit, and its goal.
Row = tuple[str, float | None, str, str]

THREADS, WORLDS = 2, 64
#: Commands of an episode of random actions, each held for some of them, and repetitions of which
#: the median counts.
STEPS, HELD, REPEATS = 50, 5, 3
#: Simulated seconds a second of SurRoL on two cores. Source: measured, 209 steps of 0.2 s.
SURROL = 42.0
SCENES = ("needle-reach", "needle-pick", "peg-transfer", "bi-peg-transfer")
EDGE = 84


@dataclass(frozen=True)
class Pace:
    """Time of an environment step of 20 ms of one world.

    Attributes:
        wall: [s]
        thread: processor time of the calling thread; other threads may spin while they wait [s]
        outside: ratio of the wall time outside of physics
        physics: processor time of the calling thread in physics [s]
    """

    wall: float
    thread: float
    outside: float = 0.0
    physics: float = 0.0


def batches(watch: Watch, short: bool = False) -> list[Row]:
    """Return all rows of batches of scenes."""
    rows: list[Row] = []
    for scene in SCENES[1:2] if short else SCENES:
        watch(f"{scene}, {WORLDS} worlds on {THREADS} threads beside one task")
        rows += speed(scene)
    scene = "needle-pick"
    watch(f"{scene}, parity")
    rows += parity(scene)
    watch("resets")
    for one in ("needle-pick", "peg-board"):
        rows.append(reset(one))
    watch(f"{scene}, 1 to 256 worlds")
    rows += curve(scene, (1, 16, 64) if short else (1, 4, 16, 64, 256))
    watch(f"{scene}, images")
    rows += images(scene)
    return rows


def speed(scene: str) -> list[Row]:
    """Compare a batch with one task, in turn; both return what an observation needs."""
    task, batch = make_task(scene), SceneBatch(scene, WORLDS, threads=THREADS)
    alone = SceneBatch(scene, WORLDS, threads=1)  # all its physics is in the calling thread
    one, many, serial = _in_turn(task, batch, alone)
    label = f"{scene}, {WORLDS} worlds on {THREADS} threads"
    bound = THREADS * one.thread / serial.physics
    return [
        (f"{label}: environment steps of 20 ms", 1.0 / many.wall, "/s", "printed"),
        (f"{label}: over one task in the same run", one.wall / many.wall, "x", ">= 3"),
        (f"{label}: over one task if physics were all, by thread time", bound, "x", "printed"),
        (f"{label}: outside physics, of the wall", many.outside, "", "<= 0.15"),
        (f"{label}: simulated over SurRoL's", PERIOD_S / many.wall / SURROL, "x", ">= 1.6"),
    ]


def parity(scene: str) -> list[Row]:
    """Compare a scripted episode in a batch with the task's."""
    task = make_task(scene)
    batch = SceneBatch(scene, 2, threads=THREADS)
    task.reset(1)
    batch.reset(seeds=[0, 1])
    grasps = batch.physics.grasps
    worst, differ = 0.0, 0
    for action in task.policy():
        actions = batch.idle()
        actions[1] = action
        task.command(action)
        batch.command(actions)
        row = task.world.save().row
        worst = max(worst, float(np.abs(batch.physics.rows[1] - row).max()))
        names = {a: n for a, n in task.referee.held.items() if n}
        found_names = {} if grasps is None else _held(batch, 1)
        differ += names != found_names
        if task.done:
            break
    return [
        (f"{scene}: largest difference from the task's state", worst, "", "<= 1e-10"),
        (f"{scene}: periods in which grasps differ", float(differ), "", "<= 0"),
    ]


def reset(scene: str) -> Row:
    """Time the reset of one world of a batch."""
    batch = SceneBatch(scene, WORLDS, threads=THREADS)
    mask, times = np.arange(WORLDS) == 5, list[float]()
    for seed in range(30):
        begin = time.thread_time()
        batch.reset(mask, [seed])
        times.append(time.thread_time() - begin)
    return (
        f"{scene}: reset of one of {WORLDS} worlds",
        1e3 * float(np.median(times)),
        "ms",
        "<= 0.5",
    )


def curve(scene: str, counts: tuple[int, ...]) -> list[Row]:
    """Print the time of a step against the number of worlds."""
    rows: list[Row] = []
    for n in counts:
        pace = median([_many(SceneBatch(scene, n, threads=THREADS), 1) for _ in range(2)])
        rows.append((f"{scene}, {n} worlds: environment steps", 1.0 / pace.wall, "/s", "printed"))
    return rows


def images(scene: str) -> list[Row]:
    """Time images of all worlds after a step."""
    batch = SceneBatch(scene, WORLDS, threads=THREADS)
    camera = SceneCamera(batch.task, EDGE)
    batch.images(range(WORLDS), camera)
    times = list[float]()
    for _ in range(3):
        batch.command(batch.idle())
        begin = time.process_time()
        batch.images(range(WORLDS), camera)
        times.append(time.process_time() - begin)
    camera.close()
    each = 1e3 * float(np.median(times))
    return [
        (f"{scene}: {WORLDS} images of {EDGE}x{EDGE}, processor time", each, "ms", "printed"),
        (f"{scene}: of each of them", each / WORLDS, "ms", "<= 2"),
    ]


# ---------------------------------------------------------------------- measuring


def median(paces: list[Pace]) -> Pace:
    """Return the medians of measurements."""
    return Pace(*np.median([astuple(one) for one in paces], axis=0).tolist())


def _in_turn(task: Task, *batches: SceneBatch) -> list[Pace]:
    """Measure a task, then each batch, and so again; return the medians in this order."""
    rounds = [
        [_one(task, seed), *(_many(batch, seed) for batch in batches)] for seed in range(REPEATS)
    ]
    return [median([*paces]) for paces in zip(*rounds, strict=True)]


def _actions(limits: tuple[Array, Array], n: int, seed: int) -> Array:
    """Return random actions, each held for some commands, (STEPS, n, k)."""
    low, high = limits
    drawn = np.random.default_rng(seed).uniform(0.5 * low, 0.5 * high, (STEPS // HELD, n, len(low)))
    return np.repeat(drawn, HELD, axis=0)


def _one(task: Task, seed: int) -> Pace:
    """Time episodes of one task with what an observation needs."""
    count, wall, thread = 0, 0.0, 0.0
    for episode in range(4):
        task.reset(100 * seed + episode)
        actions = _actions(task.limits, 1, 100 * seed + episode)
        begin, spent = time.perf_counter(), time.thread_time()
        for action in actions[:, 0]:
            if task.done:
                break
            task.command(action)
            task.observation()
            count += 1
        wall, thread = wall + time.perf_counter() - begin, thread + time.thread_time() - spent
    return Pace(wall / count, thread / count)


def _many(batch: SceneBatch, seed: int) -> Pace:
    """Time episodes of a batch with what an observation needs."""
    batch.reset()
    actions, count = _actions(batch.limits, batch.n, seed), 0
    with _physics(batch) as inside:
        begin, spent = time.perf_counter(), time.thread_time()
        for row in actions:
            count += int((~batch.over).sum())
            batch.command(row)
            _ = batch.readings
        wall, thread = time.perf_counter() - begin, time.thread_time() - spent
    return Pace(wall / count, thread / count, 1.0 - inside[0] / wall, inside[1] / count)


@contextmanager
def _physics(batch: SceneBatch) -> Any:
    """Measure the wall and the thread time of MuJoCo's steps, in a list [s]."""
    physics: Any = batch.physics
    rows, inside = physics._rows, [0.0, 0.0]

    class Timed:
        def __getattr__(self, name: str) -> Any:
            return getattr(rows, name)

        def step(self, *args: Any, **kwargs: Any) -> None:
            begin, spent = time.perf_counter(), time.thread_time()
            rows.step(*args, **kwargs)
            inside[0] += time.perf_counter() - begin
            inside[1] += time.thread_time() - spent

    physics._rows = Timed()
    try:
        yield inside
    finally:
        physics._rows = rows


def _held(batch: SceneBatch, world: int) -> dict[str, str]:
    readings = batch.readings
    rows = {arm: int(held[world]) for arm, held in readings.held.items()}
    return {arm: readings.names[row] for arm, row in rows.items() if row >= 0}
