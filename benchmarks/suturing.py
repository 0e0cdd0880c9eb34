"""Stitches through soft tissue: successes, errors, forces, closure and speed, over many seeds.

Each seed draws the wound's place (+-15 mm, +-20 deg), its stiffness (x 0.5 to 2) and the needle's
place (+-3 mm, +-20 deg), seen with 1 mm and 5 deg, in the jaws with 0.2 mm and 0.5 deg.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.tasks import wilson
from trocar.apps.figures import Figure
from trocar.apps.suturing.planning import Reach
from trocar.apps.suturing.scene import suturing_scene
from trocar.apps.suturing.task import Suturing
from trocar.apps.tasks import Episode, run_episode
from trocar.errors import DivergedError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import transform

#: Stitches of a running suture, and the share of the seeds that it is sewn for. Source: our own
#: choice.
RUNNING, SHARE = 4, 5
#: Needles in tissues that are tried beside the scene's own. Source: our own choice.
OTHERS = (("36mm-half", "skin"), ("24mm-3/8", "phantom"), ("17mm-half", "soft"))
#: Episodes of random motion by those of a stitch, ways in each, and their speed. Source: our own
#: choice. [m/s]
RANDOM, MOVES, RANDOM_M_S = 4, 5, 0.1
#: Noise of the harder runs, by that of the others. Source: our own choice.
HARDER = 2.5


def suturing(episodes: int, watch: Callable[[str], None]) -> list[Figure]:
    """Return the figures of one stitch, also with more noise, others' needles, and of four."""
    found: list[Figure] = []
    few = max(1, episodes // SHARE)
    rows: list[tuple[str, tuple[int, str, str], float, int, float | None]] = [
        ("one stitch", (1, "", "phantom"), 1.0, episodes, 0.96),
        ("one stitch, noise x 2.5", (1, "", "phantom"), HARDER, few, 0.85),
    ]
    for needle, tissue in OTHERS:
        rows.append((f"{needle} in {tissue}", (1, needle, tissue), 1.0, max(1, few // 3), None))
    rows.append(("four stitches", (RUNNING, "", "phantom"), 1.0, few, 0.90))
    for name, variant, noise, count, least in rows:
        watch(f"{name}, {count} episodes")
        before = len(found)
        task = Suturing(suturing_scene(*variant))
        task.noise = task.noise.scaled(noise)
        results: list[Episode] = []
        made: list[dict[str, Any]] = []
        begin = time.process_time()
        for seed in range(count):
            results.append(run_episode(task, seed))
            if results[-1].success:
                made += [asdict(score) for score in task.watch.scores]
            watch(f"{name}: seed {seed}: {results[-1].reason}, {results[-1].time_s:.1f} s")
        cpu = time.process_time() - begin
        found += figures(name, results, made, least)
        speed = sum(one.time_s for one in results) / cpu
        note = "simulated time over processor time, one core, with policy and scores"
        goal = 3.5 if variant[0] > 1 else 5.0
        found.append(Figure(f"{name}: speed", speed, "", lower=goal, source=note))
        found.append(_physics(name, task))
        for figure in found[before:]:
            watch(f"{figure.name}: {figure.value:.3g} {figure.unit} ({figure.source})")
    watch(f"random motion, {RANDOM * episodes} episodes")
    return found + _random_motion(RANDOM * episodes)


def figures(
    name: str, results: Sequence[Episode], made: Sequence[dict[str, Any]], least: float | None
) -> list[Figure]:
    """Return the figures of episodes.

    Args:
        name: what they are
        results: the episodes
        made: scores of the stitches of those that succeeded
        least: share of successes that is the goal; None: none is set
    """
    good = [one for one in results if one.success]
    low, high = wilson(len(good), len(results))
    interval = f"95 % interval {100 * low:.1f} to {100 * high:.1f} % (Wilson), {len(results)} seeds"
    found = [Figure(f"{name}: success", len(good) / len(results), "", lower=least, source=interval)]
    if made:
        for key, what, unit, goal in (
            ("time_s", "time of a stitch", "s", 30.0),
            ("entry_mm", "entry error", "mm", 0.4),
            ("exit_mm", "exit error", "mm", 0.4),
            ("depth_mm", "depth error", "mm", 0.4),
            ("bites_mm", "difference of the bites", "mm", 0.5),
            ("gap_deep_mm", "gap at depth in the end", "mm", None),
            ("force_n", "largest force of tissue", "N", None),
            ("displacement_mm", "largest displacement of tissue", "mm", None),
            ("tension_n", "tension of the thread", "N", None),
            ("press_n", "force of fingers on the surface", "N", None),
            ("slip_um", "slip in a jaw that holds", "um", 10.0),
            ("friction", "share of friction used", "", 0.8),
        ):
            values = np.array([one[key] for one in made])
            spread = f"median; 90 %: {np.quantile(values, 0.9):.2f}; largest {values.max():.2f}"
            found.append(
                Figure(f"{name}: {what}", float(np.median(values)), unit, upper=goal, source=spread)
            )
        gaps = np.array([one["gap_mm"] for one in made])
        closed = float((gaps <= 0.3).mean())
        note = f"stitches with 0.3 mm or less at the surface; largest {gaps.max():.2f} mm"
        found.append(Figure(f"{name}: closed", closed, "", lower=0.95, source=note))
        excess = max(one["excess_mm"] for one in made)
        found.append(
            Figure(f"{name}: thread too long by", excess, "mm", upper=0.5, source="largest")
        )
    return found


def _random_motion(count: int) -> list[Figure]:
    """Return the figures of jaws that move at random in tissue: what diverges, what passes."""
    task = Suturing(suturing_scene())
    world, diverged, deepest = task.world, 0, 0.0
    tissue, size = task.tissue, task.tissue.tissue
    reach = Reach(world, "PSM1")
    arm = world.arms["PSM1"]
    for seed in range(count):
        rng = np.random.default_rng([seed, 3])
        world.reset(seed)
        turn = rotation_z(rng.uniform(-0.5, 0.5)) @ np.diag([1.0, -1.0, -1.0])
        at = tissue.pose[:3, 3] + [0.0, 0.5 * size.width, 0.02]
        start, first = arm.setpoints()[:-1], reach.all(transform(turn, at))[0]
        for k in range(100):
            arm.servo_jp(start + (k + 1) / 100 * (first - start))
            world.step(5)
        try:
            for _ in range(MOVES):
                away = rng.uniform(-1.0, 1.0, 3) * [0.4 * size.length, size.width, 0.006]
                goal = tissue.pose[:3, 3] + away + [0.0, 0.0, 0.0125]
                jaw = rng.uniform(-0.3, 0.6)
                for _ in range(round(float(np.linalg.norm(goal - at)) / (RANDOM_M_S * 0.005))):
                    way = goal - at
                    at = at + way * min(1.0, RANDOM_M_S * 0.005 / float(np.linalg.norm(way)))
                    q = reach.near(transform(turn, at), arm.setpoints()[:-1])
                    if q is not None and arm.jaw is not None:
                        arm.servo_jp(q)
                        arm.jaw.servo_jp([jaw])
                    world.step(5)
                deepest = min(deepest, float(tissue.displacements()[:, 2].min()))
        except DivergedError:
            diverged += 1
    note = f"{count} episodes of {MOVES} ways at {1e3 * RANDOM_M_S:g} mm/s with a jaw in tissue"
    return [
        Figure("random motion: divergences", diverged, "", upper=0.0, source=note),
        Figure("random motion: deepest dent", -1e3 * deepest, "mm", source=note),
    ]


def _physics(name: str, task: Suturing) -> Figure:
    """Return the speed of physics where the last episode ended: thread in tissue, and tight."""
    best = np.inf
    for _ in range(5):
        begin = time.process_time()
        task.world.step(500)
        best = min(best, (time.process_time() - begin) / 500)
    speed = task.world.timestep / best
    note = "simulated time over processor time, one core; thread through all points, needle held"
    return Figure(
        f"{name}: speed of physics", speed, "", lower=5.0 if "four" in name else 9.0, source=note
    )
