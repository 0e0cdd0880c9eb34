"""Success, time, forces and speed of the scripted policies of every scene, over many seeds."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from trocar.apps.figures import Figure
from trocar.apps.tasks import Episode, make_task, run_episode
from trocar.descriptions import names

EPISODES = 50
CONFIDENCE = 0.95
#: Least share of successes: with one arm, and with two. Source: our own goals; the real dVRK has
#: 94.1 % in peg transfer (Hwang et al., IROS 2020).
ONE_ARM, TWO_ARMS = 0.99, 0.95


def tasks(episodes: int, watch: Callable[[str], None]) -> list[Figure]:
    """Return the figures of every built-in scene, with seeds from 0 on, in this process."""
    found: list[Figure] = []
    for name in names("scenes"):
        watch(f"{name}, {episodes} episodes")
        task = make_task(name)
        begin = time.process_time()
        results = [run_episode(task, seed) for seed in range(episodes)]
        found += figures(results, time.process_time() - begin)
    return found


def figures(results: Sequence[Episode], cpu_s: float) -> list[Figure]:
    """Return the figures of a scene's episodes.

    Args:
        results: the episodes
        cpu_s: processor time that they took [s]
    """
    name, count = results[0].scene, len(results)
    good = [one for one in results if one.success]
    low, high = wilson(len(good), count)
    least = ONE_ARM if len(results[0].distance_m) == 1 else TWO_ARMS
    interval = f"95 % interval {100 * low:.1f} to {100 * high:.1f} % (Wilson), {count} seeds"
    found = [Figure(f"{name}: success", len(good) / count, "", lower=least, source=interval)]
    if good:
        times = np.array([one.time_s for one in good])
        spread = 0.0
        if len(times) > 1:
            quantile = student.ppf(0.5 + CONFIDENCE / 2.0, len(times) - 1)
            spread = float(quantile * times.std(ddof=1) / np.sqrt(len(times)))
        note = f"mean of the successes, +- {spread:.2f} s (95 %)"
        found.append(Figure(f"{name}: time", float(times.mean()), "s", source=note))
    force = max(max(one.force_n.values()) for one in results)
    drops = sum(one.drops for one in results)
    speed = sum(one.time_s for one in results) / cpu_s
    return [
        *found,
        Figure(f"{name}: drops", drops, "", source="all episodes"),
        Figure(
            f"{name}: largest force", force, "N", source="net contact force on an arm, at 50 Hz"
        ),
        Figure(f"{name}: speed", speed, "", source="simulated time over processor time, one core"),
    ]


def wilson(good: int, count: int) -> tuple[float, float]:
    """Return the interval of a ratio that holds with 95 %.

    Source: Wilson, Journal of the American Statistical Association 22, 1927.
    """
    z = float(norm.ppf(0.5 + CONFIDENCE / 2.0))
    middle = (good + z * z / 2.0) / (count + z * z)
    half = z / (count + z * z) * np.sqrt(good * (count - good) / count + z * z / 4.0)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))
