"""A moment of before that the page shows in place of the present, and branches from it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from trocar.errors import RecordingError
from trocar.live.inbox import Command
from trocar.live.loop import Loop
from trocar.live.state import LoopState
from trocar.live.timeline import PERIOD_S, Moment, Timeline
from trocar.recording import recorder_of
from trocar.simulation.journal import WORLD

if TYPE_CHECKING:
    from trocar.simulation import World

_log = logging.getLogger("trocar")


class LookBack:
    """The moment that the page shows in place of the present; the same in all browsers.

    Args:
        loop: of the world
        timeline: keeps the moments
        leave: takes the arms from a policy that drives them; called before a branch

    Attributes:
        looked: the moment that is shown; None: the present
        continued_s: when the world was last continued from a moment [s]; None: never
    """

    def __init__(
        self, loop: Loop, timeline: Timeline, leave: Callable[[], object] = lambda: None
    ) -> None:
        self.loop, self.timeline = loop, timeline
        self._leave = leave
        self.looked: Moment | None = None
        self._paused = False
        self.continued_s: float | None = None

    def look(self, time_s: float) -> None:
        """Pause, and show the moment nearest to a time [s]: the present at its end."""
        state = self.loop.state
        if time_s > state.snapshot.time - 0.5 * PERIOD_S:
            self.looked = None
            return
        moment = self.timeline.at(time_s)
        if moment is None or moment.snapshot.build != state.snapshot.build:
            return
        if not state.paused:
            self.loop.post(Command(WORLD, "pause"))
        self.looked, self._paused = moment, state.paused

    def now(self) -> None:
        """Show the present again."""
        self.looked = None

    def branch(self) -> None:
        """Let the world go on from the moment that is shown: paused, the policy stopped.

        A recorder closes its file, which so has one course of time.
        """
        moment, self.looked = self.looked, None
        if moment is None:
            return
        self._leave()
        self.continued_s = moment.time
        self.loop.post(Command(WORLD, "pause"))
        self.loop.ask(_close_recording)
        self.loop.post(Command(WORLD, "load", {"state": moment.state}))
        _log.warning(
            "continued from %.2f s: this is a branch, and its count begins anew", moment.time
        )

    def sets_back_to(self, time_s: float) -> bool:
        """Whether a branch, and not a reset, set time back to this [s]."""
        return self.continued_s is not None and time_s >= self.continued_s

    def shown(self, state: LoopState) -> LoopState:
        """Return the state that the page shows."""
        if self.looked is None:
            return state
        resumed, self._paused = self._paused and not state.paused, state.paused
        if resumed or state.snapshot.build != self.looked.snapshot.build:
            self.looked = None  # somebody let time flow, or exchanged a tool
            return state
        return replace(state, snapshot=self.looked.snapshot)


def _close_recording(world: World) -> None:
    recorder = recorder_of(world)
    if recorder is None:
        return
    try:
        recorder.stop()
    except RecordingError as problem:
        _log.error("%s", problem)
    else:
        _log.warning("%s is closed: it ends where a branch begins", recorder.file)
