"""An arm's operating state, and the buttons that change it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from trocar.interfaces.commands import Verb
from trocar.interfaces.loop import Loop
from trocar.interfaces.viewer.own_thread import when_pressed

if TYPE_CHECKING:
    from trocar.simulation.records import ArmSnapshot

BUTTONS = {"Enable": "enable", "Home": "home", "Disable": "disable"}


class PowerButtons:
    """Shows the state that CRTK names, and enables, homes and disables."""

    def __init__(self, gui: viser.GuiApi, loop: Loop, name: str, now: ArmSnapshot) -> None:
        self._loop, self._name = loop, name
        self._state = gui.add_text("State", initial_value=state_line(now), disabled=True)
        buttons = gui.add_button_group("Power", tuple(BUTTONS))
        when_pressed(buttons, self._pressed)

    def follow(self, now: ArmSnapshot) -> None:
        """Show the state in force."""
        line = state_line(now)
        if line != self._state.value:
            self._state.value = line

    def _pressed(self, button: str) -> None:
        self._loop.post(Verb(self._name, BUTTONS[button]))


def state_line(now: ArmSnapshot) -> str:
    """Return the operating state in a few words."""
    words = [now.state, "homed" if now.homed else "not homed"]
    if now.busy:
        words.append("busy")
    return ", ".join(words)
