"""The inputs of all servos side by side: position, velocity, and effort fed forward."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Inputs of a servo in `ctrl`; modeling/arm_model.py builds them.
INPUTS = 3


class ServoInputs:
    """A view of `ctrl` as (n_servos, 3), with the two efforts that the third column adds up.

    Attributes:
        table: position, velocity and fed-forward effort of each servo, (n_servos, 3), a view
        commanded: efforts of joints under open-loop control, (n_servos,) [N m or N]
        balanced: which servos get gravity compensation, (n_servos,) 0 or 1
        tolerance: tracking errors that are allowed, inf where none counts, (n_servos,) [rad or m]
        holding: efforts that hold every motor's load, computed last, (n_servos,) [N m or N]
        revision: counts the changes of modes, gains, brakes and effort limits
    """

    def __init__(self, data: mujoco.MjData) -> None:
        self.table: Array = data.ctrl.reshape(-1, INPUTS)
        count = len(self.table)
        self.commanded = np.zeros(count)
        self.balanced = np.zeros(count)
        self.tolerance = np.full(count, np.inf)
        self.holding = np.zeros(count)
        self.revision = 0
        self._balancing = np.zeros(count)
        self._efforts = self.table[:, 2]

    def write_efforts(self) -> None:
        """Write commanded and balancing efforts into the servos."""
        np.multiply(self.balanced, self.holding, self._balancing)
        np.add(self.commanded, self._balancing, self._efforts)
