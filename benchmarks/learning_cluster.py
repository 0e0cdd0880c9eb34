"""Wall time of the same episodes in one process, in two, and on a local Ray cluster of two."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec

from benchmarks.learning import Row, figures
from trocar.robot.verification.figures import Figure
from trocar.tasks import Episode, play

Watch = Callable[[str], None]

#: Scene, and numbers of episodes: of a short collection, of a longer one; and with --short.
SCENE, EPISODES, FEW = "needle-pick", (24, 240), (8,)


def cluster(watch: Watch, short: bool = False) -> list[Figure]:
    """Play scripted episodes in three ways, in turn; results are the same."""
    rows: list[Row] = []
    ways = {
        "one process": (1, ""),
        "two processes": (2, ""),
        "Ray, local, two workers": (2, "local"),
    }
    for count in FEW if short else EPISODES:
        first: list[str] = []
        for way, (workers, address) in ways.items():
            label = f"{count} episodes of {SCENE}: {way}"
            watch(label)
            if address and find_spec("ray") is None:
                rows.append((label, None, "s", ""))
                continue
            begin = time.monotonic()
            found: list[Episode] = list(play(SCENE, range(count), workers, address))
            rows.append((label, time.monotonic() - begin, "s", ""))
            digests = [one.digest for one in found]
            if first and digests != first:
                raise RuntimeError(f"{label}: other results than in one process")
            first = digests
    return figures(rows)
