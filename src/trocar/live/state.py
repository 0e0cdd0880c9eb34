"""State of the loop, published for its readers at a monitor's rate."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from trocar.live.inbox import Command
from trocar.live.pace import Clock, Speedometer
from trocar.simulation.records import Health, Snapshot

if TYPE_CHECKING:
    from trocar.simulation import World

SNAPSHOT_PERIOD_S = 1 / 60
"""Wall time between two published snapshots [s]. Source: our own choice, a monitor's rate."""

LOOKED_AT_S = 0.25
"""Time after the last read until which snapshots are made [s]. Source: our own choice, several
times the period at which the web viewer reads."""

FRESH_S = 0.1
"""Longest wait of a reader for a new state after a pause [s]. Source: our own choice, longer than
a tick takes."""

HEALTH_PERIOD_S = 1.0
"""Wall time between two health checks of one arm [s]; arms take turns, since a check takes as long
as a tick or two. Source: our own choice: people read it."""

PATIENT = 1000
"""Ticks until the next call of an idle watcher. Source: our own choice."""


@dataclass(frozen=True)
class LoopState:
    """The published state of a loop, replaced as a whole.

    Args:
        ticks: ticks since the loop began (a reset does not set them back)
        snapshot: where everything is
        health: how well the linkages close
        paused: True while time does not flow
        real_time_factor: simulated seconds per second, over the last two seconds
        refused: how many commands were turned away
    """

    ticks: int
    snapshot: Snapshot
    health: Health
    paused: bool
    real_time_factor: float
    refused: int


@dataclass(frozen=True)
class Elapsed:
    """Simulated and skipped time of a loop since it began.

    Args:
        simulated_s: simulated time, which a reset does not set back [s]
        let_go_s: wall time that the loop was behind and gave up catching up [s]
        paused: True while time does not flow
        stepped: physics periods that were stepped while it did not
        due_s: when the last tick was due by the loop's clock; None while ticks are not paced [s]
    """

    simulated_s: float
    let_go_s: float
    paused: bool
    stepped: int = 0
    due_s: float | None = None


class Watcher(Protocol):
    """An observer in the loop's thread, whose time is taken from the physics."""

    def ticked(self, elapsed: Elapsed) -> None:
        """Observe the world after one or several ticks; while paused, after the same time."""
        ...

    def patience(self) -> int:
        """Return after how many ticks to be called again, 1 at least; sooner does no harm."""
        ...

    def refused(self, command: Command, reason: str) -> None:
        """Learn of a command that raised an error when it was applied."""
        ...


class StatePublisher:
    """Replace the loop's state for its readers, at a monitor's rate however fast the ticks come.

    Snapshots without readers are not made: one takes as long as several ticks.

    Args:
        world: what is looked at, in the loop's thread only
        clock: wall time
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self._world, self._clock = world, clock
        self._speedometer = Speedometer()
        self._state_due = self._health_due = clock.now()
        self._read_s = self._made_s = clock.now()
        self._turn = 0
        self._fresh = threading.Event()
        self._thread: int | None = None
        self._state = self._look(world.health(), 0, False, 0)

    def begin(self) -> None:
        """Publish from the calling thread from now on."""
        self._thread = threading.get_ident()

    def end(self) -> None:
        """Publish no longer: readers get what there is."""
        self._thread = None

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per second over the last two seconds."""
        return self._speedometer.factor

    def read(self) -> LoopState:
        """Return the newest state, from any thread; an outdated one is renewed first."""
        now = self._clock.now()
        self._read_s = now
        old = now - self._made_s > 2.0 * SNAPSHOT_PERIOD_S
        if old and self._thread not in (None, threading.get_ident()):
            self._fresh.clear()
            self._fresh.wait(FRESH_S)
        return self._state

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
        if now - self._read_s > LOOKED_AT_S or self._read_s < self._made_s:
            return  # nobody looks, or the newest one was not looked at yet
        self._show(self._look(self._next_health(now), ticks, paused, refused))

    def publish(self, ticks: int, paused: bool, refused: int) -> None:
        """Show the newest state now."""
        self._show(self._look(self._world.health(), ticks, paused, refused))

    def _next_health(self, now: float) -> Health:
        """Check the health of the arm whose turn it is, when it is due."""
        health = self._state.health
        names = tuple(health.per_arm)
        if not names or now < self._health_due:
            return health
        self._health_due = now + HEALTH_PERIOD_S / len(names)
        name = names[self._turn % len(names)]
        self._turn += 1
        return Health.of({**health.per_arm, name: self._world.arm(name).joints.health()})

    def _show(self, state: LoopState) -> None:
        self._state, self._made_s = state, self._clock.now()
        self._fresh.set()

    def _look(self, health: Health, ticks: int, paused: bool, refused: int) -> LoopState:
        return LoopState(
            ticks=ticks,
            snapshot=self._world.snapshot(),
            health=health,
            paused=paused,
            real_time_factor=self._speedometer.factor,
            refused=refused,
        )
