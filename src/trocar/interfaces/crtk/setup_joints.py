"""Setup joints that are told to go somewhere: their brakes give way, and hold again after.

Real setup joints have no motors. The dVRK's own simulation moves them by servo_jp and move_jp, and
so do these, by the servos that hold them while their brakes are released.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

#: Brakes hold again when the joints are this near to where they are told to be and this slow, or
#: this long after the last command or the end of the move. Source: our own choice. [rad or m, s]
NEAR, SLOW, PATIENCE_S = 1e-3, 1e-3, 1.0
VERBS = ("servo_jp", "move_jp")


@dataclass
class _Loose:
    """An arm whose brakes a command released, which of them, and since when it is at rest."""

    joints: tuple[str, ...]
    since: float


class SetupJoints:
    """Releases brakes for a command and locks them again; used in the loop's thread only."""

    def __init__(self) -> None:
        self._loose: dict[str, _Loose] = {}

    def before(self, arm: Arm, verb: str) -> None:
        """Release the brakes of an arm that is about to be told to move."""
        if verb == "lock_brakes":
            self._loose.pop(arm.name, None)
        if arm.type != "SUJ" or verb not in VERBS or not arm.operating_state().ready:
            return
        now = arm.operating_state().time
        loose = self._loose.get(arm.name)
        if loose is not None:
            loose.since = now
            return
        locked = tuple(name for name, on in arm.brakes.items() if on)
        if locked:
            arm.release_brakes(locked)
            self._loose[arm.name] = _Loose(locked, now)

    @property
    def restless(self) -> bool:
        """Whether the next tick matters."""
        return bool(self._loose)

    def tick(self, world: World) -> None:
        """Lock the brakes of arms that have arrived; to be called every tick."""
        for name, loose in tuple(self._loose.items()):
            arm = world.arm(name)
            if arm.busy:
                loose.since = world.time
            elif world.time < loose.since:  # a reset came between, which locks every brake
                del self._loose[name]
            elif at_rest(arm) or world.time - loose.since > PATIENCE_S:
                arm.lock_brakes(loose.joints)
                del self._loose[name]


def at_rest(arm: Arm) -> bool:
    """Tell whether an arm is where it is told to be."""
    measured, told = arm.measured_js(), arm.setpoint_js()
    near = np.abs(measured.position - told.position) < NEAR
    return bool(near.all() and (np.abs(measured.velocity) < SLOW).all())
