"""Time of a physics step of one tree, beside bare `mj_step` of the same model in the same state.

    PYTHONPATH=TREE/src python -P benchmarks/steps.py psm psm:cad full_cart

builds a world per RIG[:DYNAMICS] and prints one line of JSON: the package's folder and the cases
that this tree has. Each line "CASE COUNT" on stdin is answered by a line of JSON: time of
step(1), of `mj_step`, and of a step in step(20) [us], over COUNT steps each.

Any tree runs this file: it uses public names, and the private ones of trees that had none.
"""

from __future__ import annotations

import inspect
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco

try:
    from trocar import World
except ImportError:  # before World was exported there
    from trocar.simulation import World

#: Steps until arms are at rest and caches are warm. Source: our own choice.
WARM_UP = 500
#: Physics steps of one call of the longer kind.
MANY = 20


def cases(names: Sequence[str]) -> dict[str, tuple[Any, Any]]:
    """Build two worlds of each case: one to step, one whose model and data MuJoCo steps.

    Args:
        names: RIG or RIG:DYNAMICS; those with dynamics are left out where World has no such choice
    """
    found: dict[str, tuple[Any, Any]] = {}
    for name in names:
        rig, _, dynamics = name.partition(":")
        if dynamics and "dynamics" not in inspect.signature(World).parameters:
            continue
        choice: dict[str, Any] = {"dynamics": dynamics} if dynamics else {}
        worlds = World(rig, **choice), World(rig, **choice)
        for world in worlds:
            world.step(WARM_UP)
        found[name] = worlds
    return found


def measured(worlds: tuple[Any, Any], count: int) -> tuple[float, float, float]:
    """Return the time of a step(1), an `mj_step`, and a step in a step(20) [us].

    Args:
        worlds: of a case
        count: physics steps of each
    """
    world, bare = worlds
    model = bare.mj_model if hasattr(bare, "mj_model") else bare._model
    data = bare.mj_data if hasattr(bare, "mj_data") else bare._data
    single = _timed(lambda: world.step(1), count)
    alone = _timed(lambda: mujoco.mj_step(model, data), count)
    many = _timed(lambda: world.step(MANY), max(1, count // MANY)) / MANY
    return single, alone, many


def _timed(step: Callable[[], object], count: int) -> float:
    """Return the processor time of a call [us]: other programs do not count."""
    before = time.thread_time_ns()
    for _ in range(count):
        step()
    return 1e-3 * (time.thread_time_ns() - before) / count


def main(names: Sequence[str]) -> None:
    """Build the cases, then measure what stdin names."""
    built = cases(names)
    package = Path(str(sys.modules["trocar"].__file__)).parent
    print(json.dumps({"package": str(package), "cases": list(built)}), flush=True)
    for line in sys.stdin:
        name, count = line.split()
        print(json.dumps(measured(built[name], int(count))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
