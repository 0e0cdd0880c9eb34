"""Disturbance observers of servos: what they add to the PID's efforts, one physics step at a time.

Source: sawControllers@f98b6a8 mtsPID.cpp:565-600, at the physics' rate in place of 1.5 kHz.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.modeling.joints import JointTable

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class DisturbanceObservers:
    """The disturbance observers of a rig's joints; arrays are (..., K), of those that have one.

    With the effort u that PID and observer called for at the last step, the velocity v, the nominal
    mass M and the cut-off g, the state x and the effort d that is added now are

        x += (u + M g v - x) g dt,   d = x - M g v

    so that d grows until u moves the joint; where u is within its limits, x is g times the integral
    of the PID's effort.

    Args:
        table: the joints
        timestep: physics step [s]

    Attributes:
        rows: joints of the table that have an observer, (K,)
        dof: degree of freedom that each motor drives, (K,)
    """

    def __init__(self, table: JointTable, timestep: float) -> None:
        self.rows: Index = np.flatnonzero(table.observer[:, 1] > 0.0)
        self.dof: Index = abs(table.rate[self.rows]).argmax(axis=1)
        mass, cutoff = table.observer[self.rows].T
        self._damping = mass * cutoff * table.rate[self.rows, self.dof]
        self._rate = cutoff * timestep

    def observe(self, state: Array, effort: Array, rates: Array) -> Array:
        """Return the effort to add now, and go on with the state in place.

        Args:
            state: x [N m or N]
            effort: u [N m or N]; overwritten
            rates: of the degrees of freedom now [rad/s or m/s]; overwritten
        """
        rates *= self._damping
        effort += rates
        effort -= state
        effort *= self._rate
        state += effort
        np.subtract(state, rates, out=rates)
        return rates
