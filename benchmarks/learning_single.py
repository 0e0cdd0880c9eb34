"""What one environment of 20 ms costs beside its physics: Python's share of a step.

    python -m benchmarks.learning_single

prints the rows alone. A step is `Task.command` and the observation of it; its physics is the CPU
time inside of `mj_step` in the same steps, run again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.learning.observations import StateEncoder
from trocar.learning.readings import read_task
from trocar.tasks import Task, make_task

Array = NDArray[np.float64]
#: A figure, its value, its unit and its goal, None where it has none.
Row = tuple[str, float, str, float | None]

SCENES = ("needle-reach", "needle-pick", "peg-transfer")
#: Steps that are measured of each scene and each source of actions, and most of one episode.
STEPS, LONGEST = 600, 150
#: Steps for which a random action is kept. Source: our own choice, 0.2 s as SurRoL's.
KEPT = 10
#: Largest share of a step of needle-pick outside of the physics. Source: our own goal. [%]
GOAL = 20.0


@dataclass
class Cost:
    """CPU time of steps of one thread.

    Attributes:
        steps: their number
        whole, physics: their time, and what of it `mj_step` took [ns]
    """

    steps: int = 0
    whole: int = 0
    physics: int = 0

    @property
    def outside_us(self) -> float:
        """Time of a step outside of the physics [us]."""
        return 1e-3 * (self.whole - self.physics) / self.steps

    @property
    def share(self) -> float:
        """Its share of the step [%]."""
        return 100.0 * (1.0 - self.physics / self.whole)


@contextmanager
def physics_timed(cost: Cost) -> Iterator[None]:
    """Add the CPU time of every `mj_step` of this thread to a cost."""
    engine: Any = mujoco
    step = engine.mj_step

    def timed(*arguments: Any) -> None:
        begin = time.thread_time_ns()
        step(*arguments)
        cost.physics += time.thread_time_ns() - begin

    engine.mj_step = timed
    try:
        yield
    finally:
        engine.mj_step = step


def random_actions(task: Task, seed: int) -> Iterator[Array]:
    """Yield actions drawn between the limits, each for `KEPT` steps, without an end."""
    rng = np.random.default_rng(seed)
    while True:
        action = rng.uniform(*task.limits)
        for _ in range(KEPT):
            yield action


def measure(
    task: Task, actions: Callable[[int], Iterator[Array]], observe: Callable[[], object]
) -> Cost:
    """Measure `STEPS` steps of a task, each episode once whole and once more for its physics.

    The second time the clock runs inside of the step, which would slow down the first.

    Args:
        task: its episodes have the seeds from 0 on
        actions: source of an episode's actions, by its seed; what it takes is not counted
        observe: called after every command
    """
    cost, watched, seed = Cost(), Cost(), 0
    while cost.steps < STEPS:
        most = min(cost.steps + LONGEST, STEPS)
        _run(task, seed, actions(seed), observe, cost, most)
        with physics_timed(cost):
            _run(task, seed, actions(seed), observe, watched, most)
        seed += 1
    return cost


def _run(
    task: Task,
    seed: int,
    actions: Iterator[Array],
    observe: Callable[[], object],
    cost: Cost,
    most: int,
) -> None:
    """Add the steps of an episode to a cost, until it has as many as `most`."""
    task.reset(seed)
    for action in actions:
        if task.done or cost.steps >= most:
            return
        begin = time.thread_time_ns()
        task.command(action)
        observe()
        cost.whole += time.thread_time_ns() - begin
        cost.steps += 1


def single() -> list[Row]:
    """Return the figures of one environment: share and time outside of the physics, steps/s.

    Observations are those of `Task`, and those of networks, here in every period.
    """
    rows: list[Row] = []
    for scene in SCENES:
        task = make_task(scene)
        encoder = StateEncoder(task)
        sources: dict[str, Callable[[int], Iterator[Array]]] = {
            "scripted": lambda _, task=task: task.policy(),
            "random": lambda seed, task=task: random_actions(task, seed),
        }
        observations: dict[str, Callable[[], object]] = {
            "": task.observation,
            ", encoded": lambda task=task, encoder=encoder: encoder.encode(read_task(task)),
        }
        for (name, actions), (kind, observe) in product(sources.items(), observations.items()):
            cost = measure(task, actions, observe)
            title = f"{scene}, {name}{kind}"
            goal = GOAL if scene == "needle-pick" and not kind else None
            rows += [
                (f"{title}: share of a step outside of mj_step", cost.share, "%", goal),
                (f"{title}: time of a step outside of mj_step", cost.outside_us, "us", None),
                (f"{title}: steps of 20 ms", 1e9 * cost.steps / cost.whole, "1/s", None),
            ]
    return rows


if __name__ == "__main__":
    for figure, value, unit, goal in single():
        print(f"{figure:65} {value:8.1f} {unit}" + (f", goal {goal:g}" if goal else ""))
