"""The folder of a recording: play, a slider over all of it, single steps, and branches."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import viser

from trocar.live.player import Player
from trocar.live.state import LoopState
from trocar.viewer.help import hint
from trocar.viewer.server import Buttons, when_touched

if TYPE_CHECKING:
    from trocar.viewer.desk import Desk

PLAY, PAUSE, CONTINUE, RETURN = "Play", "Pause", "Continue from here", "Back to the recording"
BACK, BACK_ONE, FORTH_ONE, FORTH = "-0.1 s", "-1", "+1", "+0.1 s"
STEP_S = 0.1
SPEEDS = {"0.1 x": 0.1, "0.2 x": 0.2, "0.5 x": 0.5, "real time": 1.0, "2 x": 2.0, "5 x": 5.0}


class PlaybackFolder:
    """The folder, in the container that is open.

    Args:
        desk: of the browser
        player: of the recording, the same for all browsers
    """

    def __init__(self, desk: Desk, player: Player) -> None:
        self._desk, self._player = desk, player
        source = player.source
        gui: viser.GuiApi = desk.browser.gui
        self._length_s = max(source.end_s - source.start_s, STEP_S)
        with gui.add_folder("Recording"):
            self._slider = gui.add_slider(
                "Moment s", min=0.0, max=round(self._length_s, 3), step=0.001, initial_value=0.0,
                hint=hint("Moment s"),
            )  # fmt: skip
            self._acts = Buttons(gui, "Recording", (PLAY,), self._press, hint("Recording"))
            self._steps = Buttons(
                gui, "Moment by moment", (BACK, BACK_ONE, FORTH_ONE, FORTH), self._step,
                hint("Moment by moment"),
            )  # fmt: skip
            speed = gui.add_dropdown(
                "Speed", tuple(SPEEDS), initial_value="real time", hint=hint("Speed")
            )
            self._text = gui.add_html("")
        self._speed = speed
        self._shown = ""
        when_touched(self._slider, self._seek)
        when_touched(speed, self._set_speed)

    def show(self, state: LoopState) -> None:  # noqa: ARG002  as of a folder
        """Show the moment, and what may be done."""
        player, source = self._player, self._player.source
        blocked = bool(self._desk.watching)
        at = round(min(player.time_s - source.start_s, self._slider.max), 3)
        if not player.seeks and self._slider.value != at:
            self._slider.value = at
        still = blocked or not player.active
        if self._slider.disabled != still:
            self._slider.disabled = self._speed.disabled = still
        speed = next(name for name, factor in SPEEDS.items() if factor == player.speed)
        if self._speed.value != speed:
            self._speed.value = speed
        begin = PAUSE if player.playing else PLAY
        acts = (begin, *((CONTINUE,) if source.continues else ())) if player.active else (RETURN,)
        self._acts.show(acts, disabled=blocked)
        self._steps.show(self._steps.names, disabled=still)
        self._write()

    def close(self) -> None:
        """Do nothing: it has no nodes in the scene."""

    def _write(self) -> None:
        player, source = self._player, self._player.source
        at, length = player.time_s - source.start_s, source.end_s - source.start_s
        if not player.active:
            text = f"continued from {at:.3f} s: this is a branch"
        elif player.seeks:
            text = f"on the way: {at:.3f} of {length:.3f} s"
        else:
            text = f"{at:.3f} of {length:.3f} s"
        lines = [source.name, text, *source.notes]
        html = "<br>".join(map(escape, lines))
        if html != self._shown:
            self._shown = html
            self._text.content = f'<div class="trocar" data-trocar="recording">{html}</div>'

    def _seek(self, at_s: float) -> None:
        if not self._desk.watching and self._player.active:
            self._player.seek(self._player.source.start_s + at_s)

    def _set_speed(self, name: str) -> None:
        if not self._desk.watching:
            self._player.speed = SPEEDS[name]

    def _step(self, name: str) -> None:
        player = self._player
        if self._desk.watching or not player.active:
            return
        period = player.source.period_s
        by = {BACK: -STEP_S, BACK_ONE: -period, FORTH_ONE: period, FORTH: STEP_S}[name]
        player.pause()
        player.seek(player.time_s + by)

    def _press(self, name: str) -> None:
        player = self._player
        if self._desk.watching:
            return
        act = {PLAY: player.play, PAUSE: player.pause, CONTINUE: player.leave}
        act.get(name, player.come_back)()
