"""Real-time factor of the Si's patient cart against the Classic's."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from trocar.robot.verification.figures import Figure
from trocar.simulation import World

#: Rigs, and the steps of a pass. Source: our own choice.
RIGS, STEPS, SETTLE = ("full_cart", "full_cart_si"), 400, 300
#: At least: links in series cost less than closed loops. Source: our own choice.
LEAST = 1.0


def carts(watch: Callable[[str], None], passes: int = 31) -> list[Figure]:
    """Measure both carts at rest on one core, in turn: processor time of `World.step`.

    Args:
        watch: called with the name of each pass
        passes: of each cart
    """
    worlds = [World(rig) for rig in RIGS]
    for world in worlds:
        world.step(SETTLE)
    spent = np.zeros((passes, len(worlds)))
    for number, row in enumerate(spent):
        watch(f"pass {number + 1} of {passes}")
        for k, world in enumerate(worlds):
            begin = time.thread_time()
            world.step(STEPS)
            row[k] = time.thread_time() - begin
    simulated = STEPS * worlds[0].timestep
    found = [
        Figure(f"carts: real-time factor of {rig}", simulated / float(middle), "")
        for rig, middle in zip(RIGS, np.median(spent, axis=0), strict=True)
    ]
    ratio = float(np.median(spent[:, 0] / spent[:, 1]))
    return [*found, Figure("carts: full_cart_si / full_cart", ratio, "", lower=LEAST)]
