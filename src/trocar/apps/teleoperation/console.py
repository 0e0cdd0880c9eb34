"""The surgeon's console: which components are used, and when they follow.

Switched on and with an operator present the selected tools follow; while the camera pedal is
pressed the endoscope does. Source: SAW mtsIntuitiveResearchKitConsole.cpp, UpdateTeleopState.
"""

from __future__ import annotations

from collections.abc import Mapping

from trocar.apps.teleoperation.component import Component
from trocar.apps.teleoperation.states import ALIGNING, DISABLED, ENABLED, Tell, nowhere
from trocar.errors import InputError, UnknownNameError


class Console:
    """Switches components by what the surgeon does; in the loop's thread.

    Args:
        components: by name, in the order in which they are preferred

    Attributes:
        enabled: whether teleoperation is switched on
        present, camera: whether an operator is there, and the camera pedal is pressed
        selected: names of the components that are used; no arm is in two that move tools
        tell: takes what changes
    """

    def __init__(self, components: Mapping[str, Component]) -> None:
        self._components = components
        self.enabled = self.present = self.camera = False
        self.selected: list[str] = []
        self.scale = min((c.scale for c in components.values()), default=0.2)
        self.tell: Tell = nowhere
        for name in components:
            if not self._rivals(name):
                self.selected.append(name)

    def enable(self, on: bool) -> None:
        """Switch teleoperation."""
        self.enabled = on
        self.tell("enabled", on)
        self._update()

    def see_operator(self, present: bool) -> None:
        """Note whether somebody sits there."""
        self.present = present
        self._update()

    def press_camera(self, pressed: bool) -> None:
        """Press or release the camera pedal."""
        self.camera = pressed
        self._update()

    def press_clutch(self, pressed: bool) -> None:
        """Press or release the clutch of every component."""
        for component in self._components.values():
            component.press_clutch(pressed)

    def select(self, name: str) -> None:
        """Use a component; those that move tools with an arm of it are used no longer.

        Raises:
            UnknownNameError: no such component
        """
        self._check(name)
        for rival in self._rivals(name):
            self.unselect(rival)
        if name not in self.selected:
            self.selected.append(name)
        self.tell("selected", name)
        self._update()

    def unselect(self, name: str) -> None:
        """Use a component no longer.

        Raises:
            UnknownNameError: no such component
        """
        self._check(name)
        if name in self.selected:
            self.selected.remove(name)
        self._want(self._components[name], DISABLED)
        self.tell("unselected", name)
        self._update()

    def set_scale(self, scale: float) -> None:
        """Change the scale of every component.

        Raises:
            InputError: not above 0 to 1
        """
        if not 0.0 < scale <= 1.0:
            raise InputError(f"got a scale of {scale:g}; allowed: above 0 to 1")
        self.scale = scale
        for component in self._components.values():
            component.set_scale(scale)
        self.tell("scale", scale)

    def _update(self) -> None:
        """Want of each component what follows from switch, operator and pedal."""
        for name in self.selected:
            component = self._components[name]
            scope = component.says.kind == "ecm"
            if not self.enabled:
                self._want(component, DISABLED)
            elif not self.present:
                self._want(component, DISABLED if scope else ALIGNING)
            else:
                self._want(component, ENABLED if scope == self.camera else DISABLED)

    def _want(self, component: Component, state: str) -> None:
        if component.desired != state:
            component.desire(state)

    def _rivals(self, name: str) -> list[str]:
        """Return the selected components that move tools with an arm of this one."""
        mine = self._components[name].says
        if mine.kind == "ecm":
            return []
        return [
            other
            for other in self.selected
            if other != name
            and self._components[other].says.kind == "psm"
            and {mine.slave, *mine.masters}
            & {self._components[other].says.slave, *self._components[other].says.masters}
        ]

    def _check(self, name: str) -> None:
        if name not in self._components:
            raise UnknownNameError("component", name, self._components, "teleoperation")
