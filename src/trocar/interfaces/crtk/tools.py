"""Instruments put on and taken off as if by hand, and what is known of endoscopes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trocar.errors import InputError
from trocar.interfaces.crtk.console import Tell

if TYPE_CHECKING:
    from trocar.simulation import World

BARE = "none"


class Tools:
    """Which arms have a sterile adapter, and which tool they had; in the loop's thread only.

    A tool that is taken off is remembered, so that the same one comes back.

    Args:
        tell: says on a topic what happened
    """

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._bare: set[str] = set()
        self._last: dict[str, str] = {}

    def mount(self, world: World, name: str, tool: str) -> None:
        """Mount a tool; the one that is on already stays as it is."""
        arm = world.arm(name)
        if (arm.tool or BARE) == tool:
            return
        if tool != BARE:
            self._check_adapter(name)
        arm.set_tool_type(tool)

    def put_on(self, world: World, name: str, on: bool) -> None:
        """Put the last tool on again, or take the tool off."""
        arm = world.arm(name)
        if on and not arm.tool:
            self._check_adapter(name)
            if name not in self._last:
                self._tell(f"{name}/tool_type_request", {})
                return
            self.mount(world, name, self._last[name])
        elif not on and arm.tool:
            self._last[name] = arm.tool
            self.mount(world, name, BARE)

    def adapt(self, world: World, name: str, on: bool) -> None:
        """Put a sterile adapter on, or take it off with the tool that it holds."""
        if not on:
            self.put_on(world, name, False)
        if on == (name in self._bare):
            (self._bare.discard if on else self._bare.add)(name)
            self.show_adapter(name)

    def show_adapter(self, name: str) -> None:
        """Say whether an arm has a sterile adapter."""
        self._tell(f"{name}/IO/adapter", {"axes": [], "buttons": [int(name not in self._bare)]})

    def _check_adapter(self, name: str) -> None:
        if name in self._bare:
            raise InputError(
                f"{name}: no sterile adapter is on; put one on first (emulate_adapter_present)"
            )
