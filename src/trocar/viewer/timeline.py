"""The folder of the timeline: a slider over the last minute, single steps, and branches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from trocar.live.inbox import Command
from trocar.live.state import LoopState
from trocar.live.timeline import PERIOD_S
from trocar.simulation.journal import WORLD
from trocar.viewer.help import hint
from trocar.viewer.look_back import LookBack
from trocar.viewer.server import Buttons, when_touched

if TYPE_CHECKING:
    from trocar.viewer.desk import Desk

BACK, FORTH, STEP = "-0.1 s", "+0.1 s", "+1 ms"
CONTINUE, NOW = "Continue from here", "Now"


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
