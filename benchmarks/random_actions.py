"""Episodes of random efforts in every scene: what diverges, flies off or sinks in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.tasks import own_scenes
from trocar.errors import DivergedError
from trocar.robot.verification.figures import Figure
from trocar.tasks import make_task
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.task import Task

#: Time of an episode, and for which the motors exert what they do: each the most it can, one way
#: or the other. Source: our own choice. [s]
EPISODE_S, LEAST_S, MOST_S = 2.0, 0.05, 0.4
#: Bounds. Source: the project's own goals. [m/s, m]
FASTEST_M_S, DEEPEST_M = 5.0, 0.002


@dataclass
class Extremes:
    """Extremes of all episodes of a scene.

    Attributes:
        time: how long they lasted [s]
        diverged, warnings: how many
        speed: of the fastest object [m/s]
        depth, sunk: of the deepest contact of an object, and of the deepest for a period on end [m]
    """

    time: float = 0.0
    diverged: int = 0
    warnings: int = 0
    speed: float = 0.0
    depth: float = 0.0
    sunk: float = 0.0


def random_actions(
    scenes: Sequence[str] = (),
    episodes: int = 1000,
    duration_s: float = EPISODE_S,
    watch: Callable[[str], None] = lambda _: None,
) -> list[Figure]:
    """Return the figures of scenes, all built-in ones when none is named, with seeds from 0 on."""
    found: list[Figure] = []
    for name in scenes or own_scenes():
        watch(f"{name}, {episodes} episodes of random actions")
        task, worst = make_task(name), Extremes()
        for seed in range(episodes):
            _episode(task, seed, duration_s, worst)
        note = f"{episodes} episodes of {worst.time / episodes:.2f} s on average"
        found += [
            Figure(f"{name}: divergences", worst.diverged, "", upper=0.0, source=note),
            Figure(f"{name}: warnings of the engine", worst.warnings, "", upper=0.0, source=note),
            Figure(f"{name}: fastest object", worst.speed, "m/s", upper=FASTEST_M_S, source=note),
            Figure(
                f"{name}: deepest object",
                worst.depth * 1e3,
                "mm",
                upper=DEEPEST_M * 1e3,
                source=f"{note}; up to its speed times the step of 1 ms where it hits something",
            ),
            Figure(
                f"{name}: deepest object for {1e3 * PERIOD_S:g} ms",
                worst.sunk * 1e3,
                "mm",
                upper=DEEPEST_M * 1e3,
                source=note,
            ),
        ]
    return found


def _episode(task: Task, seed: int, duration_s: float, worst: Extremes) -> None:
    rng = np.random.default_rng((seed, 1))
    task.reset(seed)
    world, left = task.world, 0
    soft = {p.name for p in world.rig.props if any(s.stiffness is not None for s in p.shapes)}
    objects, steps = set(world.objects), round(PERIOD_S / world.timestep)
    deep: dict[frozenset[str], float] = {}  # of each pair of bodies a period ago
    before = sum(world.engine_warnings().values())
    try:
        for _ in range(round(duration_s / PERIOD_S)):
            if left == 0:
                for name in task.arms:
                    arm = world.arms[name]
                    effort = arm.joints.effort_limit * rng.choice(
                        [-1.0, 1.0], len(arm.joints.effort_limit)
                    )
                    own = len(effort) - (arm.jaw is not None)
                    arm.servo_jf(effort[:own])
                    if arm.jaw is not None:
                        arm.jaw.servo_jf(effort[own:])
                left = round(rng.uniform(LEAST_S, MOST_S) / PERIOD_S)
            left -= 1
            world.step(steps)
            task.look()
            if task.done:  # something left the table, which ends an episode
                break
            states, table = world.object_states(), world.contact_table()
            speeds = np.linalg.norm(states.linear, axis=1)
            worst.speed = max(worst.speed, float(speeds.max(initial=0.0)))
            before_that, deep = deep, {}
            for (one, two), depth in zip(table.bodies.tolist(), table.depths.tolist(), strict=True):
                pair = frozenset((table.names[one], table.names[two]))
                if pair & objects and not pair & soft:  # soft pads yield by what is in their file
                    deep[pair] = max(deep.get(pair, 0.0), depth)
            worst.depth = max(worst.depth, *deep.values(), 0.0)
            worst.sunk = max(
                worst.sunk, *(min(deep[pair], before_that.get(pair, 0.0)) for pair in deep), 0.0
            )
    except DivergedError:
        worst.diverged += 1
    worst.time += task.time
    worst.warnings += sum(world.engine_warnings().values()) - before
