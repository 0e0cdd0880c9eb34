"""Whether a hand is at the master: it has moved the gripper or rolled the handle."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Hand:
    """Notice a hand by how far gripper and roll went to and fro.

    Source: SAW mtsTeleOperationPSM.cpp, TransitionAligningMTM.

    Args:
        gripper, roll: how far is far enough; 0 of either: a hand is there at once [rad]
    """

    def __init__(self, gripper: float, roll: float) -> None:
        self._enough = (gripper, roll)
        self.there = False
        self.look_again()

    def look_again(self) -> None:
        """Forget how far both went."""
        self._least = [math.inf, math.inf]
        self._most = [-math.inf, -math.inf]

    def look(self, gripper: float | None, offset: Array | None) -> bool:
        """Return whether a hand is there.

        Args:
            gripper: its opening, None without one [rad]
            offset: rotation from the handle to where it is turned to, while that is small, (3, 3)
        """
        if min(self._enough) <= 0.0:
            self.there = True
        roll = None if offset is None else math.atan2(offset[1, 0], offset[0, 0])
        for index, value in enumerate((gripper, roll)):
            if value is None:
                continue
            self._least[index] = min(self._least[index], value)
            self._most[index] = max(self._most[index], value)
            if self._most[index] - self._least[index] >= self._enough[index]:
                self.there = True
        return self.there
