"""What the loop shows to its readers, and how they ask for more."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from trocar.interfaces.commands import Command
    from trocar.simulation import World
    from trocar.simulation.records import Health, Snapshot


@dataclass(frozen=True)
class LoopState:
    """What the loop shows to its readers, replaced as a whole.

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
    """How time has passed in a loop since it began.

    Args:
        simulated_s: simulated time, which a reset does not set back [s]
        let_go_s: wall time that the loop was behind and gave up catching up [s]
        paused: True while time does not flow
        stepped: physics periods that were stepped while it did not
        due_s: when the last tick was due by the loop's clock; None where nobody waits for it [s]
    """

    simulated_s: float
    let_go_s: float
    paused: bool
    stepped: int = 0
    due_s: float | None = None


class Watcher(Protocol):
    """Looks on in the loop's thread; what it does there takes time from the physics."""

    def ticked(self, elapsed: Elapsed) -> None:
        """Look at the world after a tick or a few; while paused, after as long without one."""
        ...

    def patience(self) -> int:
        """Return after how many ticks to be called again, 1 at least; sooner does no harm."""
        ...

    def refused(self, command: Command, reason: str) -> None:
        """Learn of a command that raised an error when it was applied."""
        ...


@dataclass(frozen=True)
class Question:
    """A question about the world that the loop's thread answers between two ticks.

    Args:
        ask: a function that only reads
        answer: where what it returns, or the error that it raises, is put
    """

    ask: Callable[[World], Any]
    answer: Future[Any]

    def apply(self, world: World) -> None:
        """Ask, and put down the answer."""
        if not self.answer.set_running_or_notify_cancel():
            return
        try:
            found = self.ask(world)
        except Exception as error:  # noqa: BLE001  whoever asked the wrong thing learns of it
            self.answer.set_exception(error)
        else:
            self.answer.set_result(found)
