"""What the loop shows to its readers, and how they ask for more."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from trocar.errors import TrocarError

if TYPE_CHECKING:
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
class Question:
    """A question about the world that the loop's thread answers between two ticks.

    Args:
        ask: a function that only reads
        answer: where what it returns, or the TrocarError that it raises, is put
    """

    ask: Callable[[World], Any]
    answer: Future[Any]

    def apply(self, world: World) -> None:
        """Ask, and put down the answer."""
        try:
            self.answer.set_result(self.ask(world))
        except TrocarError as error:
            self.answer.set_exception(error)
