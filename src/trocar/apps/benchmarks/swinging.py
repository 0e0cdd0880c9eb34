"""Instruments in motion: of what stands still no picture is drawn anew."""

from __future__ import annotations

import time

import numpy as np

from trocar.interfaces.loop import Loop
from trocar.simulation import World

#: What moves, by how much, and so long to and so long fro. Source: our own choice. [rad or m, s]
INSTRUMENTS = "PSM1", "PSM2", "PSM3"
MOVE, TURN_S = np.array([0.05, 0.05, -0.005, 0.6, 0.3, -0.3]), 0.5


def swing(loop: Loop, end_s: float) -> None:
    """Move the instruments to and fro until then, a time of `perf_counter`."""
    home = loop.ask(lambda w: {k: w.arm(k).setpoint_js().position for k in INSTRUMENTS}).result()

    def send(world: World, way: float) -> None:
        for name, position in home.items():
            world.arm(name).move_jp(position + way * MOVE)

    away = 1.0
    while (left := end_s - time.perf_counter()) > 0.0:
        loop.ask(lambda world, way=away: send(world, way)).result()
        time.sleep(min(TURN_S, left))
        away = 1.0 - away
