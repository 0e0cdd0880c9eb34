"""Two masters that move the endoscope: both hands take hold of what is seen, and drag it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.teleoperation.component import TeleopComponent
from trocar.teleoperation.masters import MasterReading

if TYPE_CHECKING:
    from trocar.simulation.arm import Arm

Array = NDArray[np.float64]

ROLL = 3


@dataclass(frozen=True, eq=False)
class Hands:
    """Both hands as a steering wheel.

    Attributes:
        middle: between them, from the eyes, (3,) [m]
        up: normal to the line between them and to the line of sight, (3,)
    """

    middle: Array
    up: Array

    @staticmethod
    def of(readings: Sequence[MasterReading]) -> Hands:
        """Return the positions of two hands, the left one first."""
        left, right = (reading.T[:3, 3] for reading in readings)
        middle = 0.5 * (left + right)
        up = np.cross(right - left, middle)
        return Hands(middle, up / max(float(np.linalg.norm(up)), 1e-12))

    def moved(self, before: Hands, scale: float) -> Array:
        """Return the motion of the hands: right, up (as angles at the eyes), near, clockwise, (4,).

        Source: SAW mtsTeleOperationECM.cpp, RunEnabled.

        Args:
            before: where they were
            scale: ratio of the way towards the eyes that counts
        """
        was, now = before.middle, self.middle
        return np.array(
            [
                _angle(now[[2, 0]], was[[2, 0]]),
                _angle(was[[2, 1]], now[[2, 1]]),
                scale * (np.linalg.norm(was) - np.linalg.norm(now)),
                _angle(before.up[:2], self.up[:2]),
            ]
        )


def _angle(a: Array, b: Array) -> float:
    """Return the angle from a vector in a plane to another, (2,) each [rad]."""
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


class EcmTeleoperation(TeleopComponent):
    """An endoscope that both hands drag; there is nothing to align."""

    def goal(self, arm: Arm, hands: Hands) -> Array:
        """Return the joints that keep what was seen between the hands, within limits, (4,)."""
        right, up, near, clockwise = hands.moved(self._hands, self.scale)
        roll = self._joints[ROLL] - clockwise
        c, s = np.cos(roll), np.sin(roll)
        change = np.array([right * c + up * s, right * s - up * c, near, -clockwise])
        return np.clip(self._joints + change, arm.joints.lower, arm.joints.upper)

    def _align(self, readings: Sequence[MasterReading]) -> None:
        self._enable(readings)

    def _engage(self, readings: Sequence[MasterReading]) -> None:
        arm = self.world.arm(self.description.slave)
        self._hands = Hands.of(readings)
        self._joints = self._commanded = arm.joints.setpoints()[: arm.description.own_joints]

    def _follow(self, readings: Sequence[MasterReading], period_s: float) -> None:
        arm = self.world.arm(self.description.slave)
        q = self.goal(arm, Hands.of(readings))
        arm.servo_jp(q, (q - self._commanded) / period_s)
        self._commanded = q

    def _release_masters(self, *, clutch: bool) -> None:  # noqa: ARG002  locked in both cases
        for master in self.masters:
            master.release(self.world, locked=True)
