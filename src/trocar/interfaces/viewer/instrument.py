"""Which instrument an arm has, and the choice of another."""

from __future__ import annotations

import viser

from trocar.interfaces.commands import ExchangeTool
from trocar.interfaces.loop import Loop
from trocar.interfaces.viewer.own_thread import when_touched
from trocar.interfaces.viewer.sheet import ArmSheet
from trocar.interfaces.viewer.tuning import SETTLED

NONE = "none"


class InstrumentChoice:
    """A list of the instruments that fit; choosing one mounts it."""

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet) -> None:
        self._loop, self._arm = loop, sheet.name
        self._untouched = SETTLED
        mounted = sheet.tool or NONE
        names = dict.fromkeys((*sheet.tools, mounted, NONE))  # one of one's own among them
        self._choice = gui.add_dropdown("Instrument", list(names), initial_value=mounted)
        when_touched(self._choice, self._chosen)

    def follow(self, sheet: ArmSheet) -> None:
        """Show what is mounted, but not what was mounted before the last touch."""
        self._untouched += 1
        mounted = sheet.tool or NONE
        if self._untouched >= SETTLED and self._choice.value != mounted:
            self._choice.value = mounted

    def _chosen(self, tool: str) -> None:
        self._untouched = 0
        self._loop.post(ExchangeTool(self._arm, tool))
