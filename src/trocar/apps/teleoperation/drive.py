"""What a hand asks of a tool through a device that has no pose: speeds, and choices."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Of the tip while a key is held. Source: our own choice: a block of the pegs is crossed in two
#: seconds, and a tap moves less than a millimetre. [m/s, rad/s]
SPEED, TURN = 0.01, radians(30.0)
#: Of the gripper. Source: our own choice: shut from wide open in a second. [rad/s]
GRIP = radians(60.0)
#: How much slower and faster. Source: our own choice.
FINE, FAST = 0.2, 3.0
#: Of a stick or a cap that is pushed as far as it goes, which has no key to be faster. Source: our
#: own choice, half way from usual to fast.
STICK = FAST**0.5


@dataclass(frozen=True)
class Drive:
    """What is asked for now.

    Attributes:
        move: of the tip: right, up, away, -1 to 1 each
        turn: about the same axes, as a screw is turned to move along them, -1 to 1 each
        grip: above 0 opens, -1 to 1
        pace: factor of all speeds
        tool: which instrument to use from now on, counted from 1; 0: the same
        step: by how many instruments to go on from the one that is used
        camera: whether the endoscope is dragged in place of a tool
    """

    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    grip: float = 0.0
    pace: float = 1.0
    tool: int = 0
    step: int = 0
    camera: bool = False

    @property
    def linear(self) -> Array:
        """Velocity as the surgeon's frame has it: x left, y up, z away, (3,) [m/s]."""
        right, up, away = self.move
        return self.pace * SPEED * np.array([-right, up, away])

    @property
    def angular(self) -> Array:
        """Angular velocity in the same axes, (3,) [rad/s]."""
        right, up, away = self.turn
        return self.pace * TURN * np.array([-right, up, away])

    @property
    def opening(self) -> float:
        """How fast the gripper opens [rad/s]."""
        return self.pace * GRIP * self.grip


STILL = Drive()
