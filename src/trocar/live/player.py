"""Player of a recording: it puts the loop's world where the recording has it, while time stands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from trocar.live.inbox import Command
from trocar.live.state import Elapsed
from trocar.simulation.journal import WORLD

if TYPE_CHECKING:
    from trocar.live.loop import Loop
    from trocar.simulation import World

BUDGET_S = 0.03
"""Wall time of one call of `Playable.show` [s]. Source: our own choice, a refresh of the page."""

BEHIND_S = 0.2
"""Wall time by which a slow recording may lag before playing waits for it [s]. Source: our own
choice, longer than the rows of published logs are apart."""


class Playable(Protocol):
    """A recording from which any moment is shown in a world; used in the loop's thread.

    Attributes:
        name: of the recording
        start_s, end_s: time of the first and of the last moment [s]
        period_s: usual time between two moments [s]
        continues: whether the world's motion goes on from a moment as it was recorded
        notes: remarks for the person who watches
    """

    @property
    def name(self) -> str: ...  # noqa: D102  see the class

    @property
    def start_s(self) -> float: ...  # noqa: D102

    @property
    def end_s(self) -> float: ...  # noqa: D102

    @property
    def period_s(self) -> float: ...  # noqa: D102

    @property
    def continues(self) -> bool: ...  # noqa: D102

    @property
    def notes(self) -> tuple[str, ...]: ...  # noqa: D102

    def nearest(self, time_s: float) -> float:
        """Return the time of the moment nearest to a time [s]; from any thread."""
        ...

    def show(self, world: World, moment_s: float, budget_s: float) -> float:
        """Put the world at a moment, or on the way to it.

        Args:
            world: of the recording; not moved otherwise since the last call, but for `forget`
            moment_s: time of a moment, as of `nearest` [s]
            budget_s: wall time after which to return [s]

        Returns:
            time of the moment at which the world stands [s]
        """
        ...

    def forget(self) -> None:
        """Note that the world was moved otherwise."""
        ...


class Player:
    """Play a recording in a loop's world; a watcher of the loop, which stays paused meanwhile.

    As soon as time flows, the recording is left: motion goes on from the moment that is shown.

    Args:
        loop: of the recording's world
        source: the recording

    Attributes:
        source: as given
        time_s: time of the moment that is shown [s]
        playing: whether time of the recording flows
        speed: recorded seconds a second
        active: whether the recording is shown; False once it is left
        seeks: whether the requested moment is not shown yet
    """

    def __init__(self, loop: Loop, source: Playable) -> None:
        self._loop, self.source = loop, source
        self.time_s = self._goal_s = source.start_s
        self.playing, self.speed = False, 1.0
        self.active = self.seeks = True
        self._last_s = loop.now

    # Called from other threads.

    def play(self) -> None:
        """Let the recording's time flow, from the beginning when it is at its end."""
        if self.time_s >= self.source.end_s:
            self.seek(self.source.start_s)
        self.playing = True

    def pause(self) -> None:
        """Let the recording's time stand."""
        self.playing = False

    def seek(self, time_s: float) -> None:
        """Go to the moment nearest to a time [s]."""
        self._goal_s = self.source.nearest(time_s)
        self.seeks = True

    def leave(self) -> None:
        """Let the world go on from the moment that is shown: a branch."""
        self._loop.post(Command(WORLD, "resume"))

    def come_back(self) -> None:
        """Pause the world, and show the recording at the moment at which it was left."""
        self._loop.post(Command(WORLD, "pause"))
        self._loop.post(Command(WORLD, "recording", act=self._show_again))

    # Called in the loop's thread.

    def _show_again(self, world: World) -> None:  # noqa: ARG002  as of a command
        self.source.forget()
        self.active = True
        self.seek(self.time_s)

    def ticked(self, elapsed: Elapsed) -> None:
        """Move on in the recording."""
        now_s, before_s = self._loop.now, self._last_s
        self._last_s = now_s
        if not elapsed.paused:
            self.active = self.playing = False
        if not self.active:
            return
        source = self.source
        if self.playing and not self.seeks:
            ahead = self._goal_s + (now_s - before_s) * self.speed
            self._goal_s = min(ahead, self.time_s + BEHIND_S * self.speed, source.end_s)
        moment = source.nearest(self._goal_s)
        if self.seeks or moment != self.time_s:
            self.time_s = source.show(self._loop.world, moment, BUDGET_S)
        if self.time_s == source.nearest(self._goal_s):
            self.seeks = False
            self.playing = self.playing and self.time_s < source.end_s

    def patience(self) -> int:
        """Return after how many ticks to be called again."""
        return 1

    def refused(self, command: Command, reason: str) -> None:
        """Ignore rejected commands."""
