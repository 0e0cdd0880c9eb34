"""Success of a policy over many seeds, with its interval, times, forces and paths."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from trocar.errors import InputError
from trocar.tasks import Episode

#: Level of the intervals. Source: our own choice.
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Evaluation:
    """Summary of the episodes of a policy.

    Attributes:
        scene, policy: names
        episodes, successes: numbers
        interval: Wilson's interval of the ratio of successes
        time_s: mean time of the successes [s]; NaN without any
        force_n: mean and largest of the episodes' largest net contact force on an arm [N]
        grip_n: largest force of the weaker finger on an object [N]
        drops: of all episodes
        distance_m: mean length of the tips' paths, arms added [m]
        stalled_s: mean time for which an arm stayed though an action moves it, arms added [s]
        failures: {reason of the end: number of episodes}, the most frequent first
    """

    scene: str
    policy: str
    episodes: int
    successes: int
    interval: tuple[float, float]
    time_s: float
    force_n: tuple[float, float]
    grip_n: float
    drops: int
    distance_m: float
    stalled_s: float
    failures: dict[str, int]


def summarise(policy: str, episodes: Sequence[Episode]) -> Evaluation:
    """Return the summary of one policy's episodes.

    Args:
        policy: its name
        episodes: one or more, of one scene

    Raises:
        InputError: no episode
    """
    if not episodes:
        raise InputError(f"{policy}: got no episode; allowed: one or more")
    good = [one for one in episodes if one.success]
    forces = [max(one.force_n.values()) for one in episodes]
    reasons = Counter(one.reason for one in episodes if not one.success)
    return Evaluation(
        scene=episodes[0].scene,
        policy=policy,
        episodes=len(episodes),
        successes=len(good),
        interval=wilson(len(good), len(episodes)),
        time_s=float(np.mean([one.time_s for one in good])) if good else float("nan"),
        force_n=(float(np.mean(forces)), max(forces)),
        grip_n=max(max(one.grip_n.values()) for one in episodes),
        drops=sum(one.drops for one in episodes),
        distance_m=float(np.mean([sum(one.distance_m.values()) for one in episodes])),
        stalled_s=float(np.mean([sum(one.stalled_s.values()) for one in episodes])),
        failures=dict(reasons.most_common()),
    )


def wilson(good: int, count: int) -> tuple[float, float]:
    """Return the interval of a ratio that holds with 95 %.

    Source: Wilson, Journal of the American Statistical Association 22, 1927.
    """
    z = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2.0)
    middle = (good + z * z / 2.0) / (count + z * z)
    half = z / (count + z * z) * np.sqrt(good * (count - good) / count + z * z / 4.0)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))
