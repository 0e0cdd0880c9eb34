"""The jaw after the gripper: not faster than it may, and slowly until it has caught up."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: Gripper and jaw have met. Source: SAW mtsIntuitiveResearchKit.h, ToleranceBackFromClutch. [rad]
CAUGHT_UP = math.radians(2.0)
#: The jaw's opening at the gripper's widest. Source: facts of the dVRK: 60 deg of both. [rad]
WIDE = math.radians(60.0)


@dataclass(frozen=True)
class JawRule:
    """How the jaw's opening follows from the gripper's.

    Attributes:
        zero, widest: the gripper at which the jaw is just shut, and open at `WIDE` [rad]
        rate, rate_at_first: fastest that the gripper is followed, and until it is met [rad/s]
        lower, upper: of the jaw [rad]
    """

    zero: float
    widest: float
    rate: float
    rate_at_first: float
    lower: float
    upper: float

    def jaw(self, gripper: float) -> float:
        """Return the jaw's opening for the gripper's, within the jaw's limits [rad]."""
        opening = (gripper - self.zero) * WIDE / (self.widest - self.zero)
        return min(max(opening, self.lower), self.upper)

    def gripper(self, jaw: float) -> float:
        """Return the gripper's opening for the jaw's [rad]."""
        return self.zero + jaw * (self.widest - self.zero) / WIDE


class JawFollower:
    """A ghost of the gripper that goes after it, beginning where the jaw is.

    Source: SAW mtsTeleOperationPSM.cpp, RunEnabled.

    Args:
        rule: how openings go together
        jaw: where the jaw is told to be [rad]
    """

    def __init__(self, rule: JawRule, jaw: float) -> None:
        self._rule = rule
        self._ghost = rule.gripper(jaw)
        self._met = False

    def follow(self, gripper: float, period_s: float) -> float:
        """Return the jaw's opening after a period [rad]."""
        self._met = self._met or abs(gripper - self._ghost) < CAUGHT_UP
        most = (self._rule.rate if self._met else self._rule.rate_at_first) * period_s
        self._ghost += min(max(gripper - self._ghost, -most), most)
        jaw = self._rule.jaw(self._ghost)
        if self._rule.gripper(jaw) != self._ghost:  # no windup beyond the jaw's limits
            at_limit = jaw in (self._rule.lower, self._rule.upper)
            self._ghost = self._rule.gripper(jaw) if at_limit else self._ghost
        return jaw
