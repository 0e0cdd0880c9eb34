"""Homing: to the home pose, and there the joints must be where they are told to be."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.motion import Motion

Array = NDArray[np.float64]

#: How near measured positions must be. Source: mtsIntuitiveResearchKitPSM.cpp (3 degrees); our own
#: choice for slides. [rad], [m]
NEAR_RAD = float(np.deg2rad(3.0))
NEAR_M = 0.003
#: How long they may take after the set-points arrived. Source: our own choice. [s]
PATIENCE_S = 2.0


class Homing:
    """A homing under way.

    Attributes:
        motion: what the caller waits for
        way: the move of the set-points
    """

    def __init__(self, motion: Motion, way: Motion, slides: NDArray[np.bool_]) -> None:
        self.motion = motion
        self.way = way
        self._near = np.where(slides, NEAR_M, NEAR_RAD)
        self._arrived = np.inf

    def look(self, measured: Array, time: float) -> Literal["", "home", "stopped", "late"]:
        """Tell how it ended, "" while it has not. `measured` is (n,) [rad or m]."""
        if not self.way.done:
            return ""
        if not self.way.goal_reached:
            return "stopped"
        self._arrived = min(self._arrived, time)
        if not self.far(measured).any():
            return "home"
        return "late" if time - self._arrived > PATIENCE_S else ""

    def far(self, measured: Array) -> NDArray[np.bool_]:
        """Tell which joints are not home, (n,)."""
        return np.abs(measured - self.way.goal) > self._near
