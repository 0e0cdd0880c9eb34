"""Looking back: a slider over the last minute, single steps, and a branch from a moment."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import viser

from trocar.live.inbox import Command
from trocar.live.loop import Loop
from trocar.live.state import LoopState
from trocar.live.timeline import PERIOD_S, Moment, Timeline
from trocar.simulation.journal import WORLD
from trocar.viewer.help import hint
from trocar.viewer.server import Buttons, when_touched

if TYPE_CHECKING:
    from trocar.viewer.desk import Desk

_log = logging.getLogger("trocar")

BACK, FORTH, STEP = "-0.1 s", "+0.1 s", "+1 ms"
CONTINUE, NOW = "Continue from here", "Now"
SPEEDS = {"0.1 x": 0.1, "0.2 x": 0.2, "0.5 x": 0.5, "real time": 1.0, "2 x": 2.0, "max": None}


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
        """Show the moment at a time [s], and pause; the present where there is none later."""
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
        """Let the world go on from the moment that is shown: paused, the policy stopped."""
        moment, self.looked = self.looked, None
        if moment is None:
            return
        self._leave()
        self.continued_s = moment.time
        self.loop.post(Command(WORLD, "pause"))
        self.loop.post(Command(WORLD, "load", {"state": moment.state}))
        _log.warning(
            "continued from %.2f s: this is a branch; its count begins anew, and a recording has"
            " both ways",
            moment.time,
        )

    def shown(self, state: LoopState) -> LoopState:
        """Return the state that the page shows."""
        if self.looked is None:
            return state
        resumed, self._paused = self._paused and not state.paused, state.paused
        if resumed or state.snapshot.build != self.looked.snapshot.build:
            self.looked = None  # somebody let time flow, or exchanged a tool
            return state
        return replace(state, snapshot=self.looked.snapshot)


class TimelineFolder:
    """The folder, in the container that is open.

    Args:
        desk: of the browser
        past: the moment that all browsers show
    """

    def __init__(self, desk: Desk, past: LookBack) -> None:
        self._desk, self._past = desk, past
        gui: viser.GuiApi = desk.browser.gui
        with gui.add_folder("Timeline"):
            self._slider = gui.add_slider(
                "Look back s", min=-PERIOD_S, max=0.0, step=PERIOD_S, initial_value=0.0,
                hint=hint("Look back"),
            )  # fmt: skip
            self._steps = Buttons(gui, "Step", (BACK, STEP, FORTH), self._press, hint("Step"))
            self._branch = Buttons(gui, "Moment", (CONTINUE, NOW), self._press, hint("Moment"))
            self._text = gui.add_html("")
        self._shown = ""
        when_touched(self._slider, self._look)
        self._show_moment()

    def show(self, state: LoopState) -> None:
        """Show how far back it goes, and what is shown."""
        past, desk = self._past, self._desk
        moments = past.timeline.moments
        now = past.loop.latest.time
        first = moments[0].time if moments else now
        low = -max(PERIOD_S, round((now - first) / PERIOD_S) * PERIOD_S)
        if abs(self._slider.min - low) > 0.5 * PERIOD_S:
            self._slider.min = low
        back = 0.0 if past.looked is None else past.looked.time - now
        value = min(max(round(back / PERIOD_S) * PERIOD_S, low), 0.0)
        if abs(self._slider.value - value) > 0.5 * PERIOD_S:
            self._slider.value = value
        blocked = bool(desk.seat)
        if self._slider.disabled != blocked:
            self._slider.disabled = blocked
        steps = (BACK, STEP, FORTH) if past.looked is None else (BACK, FORTH)
        self._steps.show(steps, disabled=blocked or not state.paused)
        self._show_moment()
        text = ""
        if past.looked is not None:
            text = f"shown: {past.looked.time:.2f} s; the simulation stands at {now:.2f} s"
        elif past.continued_s is not None:
            text = f"continued from {past.continued_s:.2f} s"
        if text != self._shown:
            self._shown = text
            self._text.content = (
                f'<div class="trocar" data-trocar="timeline">{text}</div>' if text else ""
            )

    def close(self) -> None:
        """Do nothing: it has no nodes in the scene."""

    def _show_moment(self) -> None:
        self._branch.set_visible(visible=self._past.looked is not None)
        self._branch.show((CONTINUE, NOW), disabled=bool(self._desk.seat))

    def _look(self, back_s: float) -> None:
        if not self._desk.seat:
            self._past.look(self._past.loop.latest.time + back_s)

    def _press(self, name: str) -> None:
        past = self._past
        if self._desk.seat:
            return
        at = past.loop.latest.time if past.looked is None else past.looked.time
        if name == BACK:
            past.look(at - PERIOD_S)
        elif name == FORTH and past.looked is not None:
            past.look(at + PERIOD_S)
        elif name in (FORTH, STEP) and past.looked is None:
            seconds = PERIOD_S if name == FORTH else past.loop.world.timestep
            periods = max(1, round(seconds / past.loop.world.timestep))
            past.loop.post(Command(WORLD, "step", {"periods": periods}))
        elif name == CONTINUE:
            past.branch()
        elif name == NOW:
            past.now()
