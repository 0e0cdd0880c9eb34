"""What the loop shows of itself, and how often."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trocar.interfaces.pace import Clock, Speedometer
from trocar.interfaces.state import LoopState

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.records import Health

SNAPSHOT_PERIOD_S = 1 / 60
"""Wall time between two published snapshots [s]. Source: our own choice, a monitor's rate."""

HEALTH_PERIOD_S = 0.2
"""Wall time between two looks at the loops' health [s]. Source: our own choice."""


class Publisher:
    """Replace the loop's state for its readers, at a monitor's rate however fast the ticks come.

    Args:
        world: what is looked at, in the loop's thread only
        clock: wall time
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self._world, self._clock = world, clock
        self._speedometer = Speedometer()
        self._state_due = self._health_due = clock.now()
        self.state = self._look(world.health(), 0, False, 0)

    def restart(self) -> None:
        """Measure the speed anew, after a pause or a reset."""
        self._speedometer.restart()

    def publish_if_due(self, ticks: int, run_s: float, paused: bool, refused: int) -> None:
        """Show the newest state if the last one is old; `run_s` is the simulated time so far."""
        now = self._clock.now()
        if now < self._state_due:
            return
        self._state_due = now + SNAPSHOT_PERIOD_S
        self._speedometer.mark(now, run_s)
        health = self.state.health
        if now >= self._health_due:
            self._health_due = now + HEALTH_PERIOD_S
            health = self._world.health()
        self.state = self._look(health, ticks, paused, refused)

    def publish(self, ticks: int, paused: bool, refused: int) -> None:
        """Show the newest state now."""
        self.state = self._look(self._world.health(), ticks, paused, refused)

    def _look(self, health: Health, ticks: int, paused: bool, refused: int) -> LoopState:
        return LoopState(
            ticks=ticks,
            snapshot=self._world.snapshot(),
            health=health,
            paused=paused,
            real_time_factor=self._speedometer.factor,
            refused=refused,
        )
