"""A gamepad on this machine, by SDL's names of its sticks and buttons."""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from trocar.apps.teleoperation.drive import Drive
from trocar.apps.teleoperation.mapping import from_pad
from trocar.errors import InputError, MissingExtraError

#: SDL's axes run so far. Source: SDL_GameController.
FULL = 32767.0
#: SDL's buttons in the order of the standard layout, None for the triggers, which are axes.
#: Source: SDL_GameControllerButton (A 0, B 1, X 2, Y 3, back 4, start 6, sticks 7 and 8, shoulders
#: 9 and 10, cross 11 to 14); W3C Gamepad.
BUTTONS = (0, 1, 2, 3, 9, 10, None, None, 4, 6, 7, 8, 11, 12, 13, 14)
STICKS, TRIGGERS = (0, 1, 2, 3), (4, 5)


class Gamepad:
    """The first gamepad that SDL knows; one that is unplugged may come back.

    Raises:
        MissingExtraError: the library is not installed
        InputError: no gamepad is plugged in, or SDL cannot use it
    """

    def __init__(self) -> None:
        if find_spec("pygame") is None:
            raise MissingExtraError("pygame", "gamepad", "--device gamepad")
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
        os.environ.setdefault("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")
        self._sdl: Any = import_module("pygame._sdl2.controller")
        self._pygame: Any = import_module("pygame")
        self._one: Any = None
        try:
            self.open()
        except OSError as problem:
            raise InputError(
                f"--device gamepad: SDL cannot use it ({problem}); plug it in again, or let a "
                "browser read it: --device keyboard takes gamepads of the page"
            ) from problem
        if self._one is None:
            raise InputError(
                "--device gamepad: no gamepad is plugged in; a browser may know one: "
                "--device keyboard takes those of the page"
            )
        self.close()

    def open(self) -> None:
        """Take hold of the first one that is there.

        Raises:
            OSError: SDL cannot use it
        """
        try:
            self._pygame.display.init()
            self._sdl.init()
            self._find()
        except self._pygame.error as problem:
            raise OSError(str(problem)) from problem

    def look(self) -> Drive | None:
        """Return what sticks and buttons ask for; None while it is unplugged.

        Raises:
            OSError: SDL cannot read it, as in the moment in which it is unplugged
        """
        try:
            return self._read()
        except self._pygame.error as problem:
            raise OSError(str(problem)) from problem

    def close(self) -> None:
        """Let go."""
        self._one = None
        self._sdl.quit()

    def _read(self) -> Drive | None:
        self._pygame.event.pump()
        if self._one is None or not self._one.attached():
            self._find()
        if self._one is None:
            return None
        axes = [self._one.get_axis(index) / FULL for index in (*STICKS, *TRIGGERS)]
        buttons = [0.0 if b is None else float(self._one.get_button(b)) for b in BUTTONS]
        return from_pad(axes, buttons)

    def _find(self) -> None:
        self._one = None
        for index in range(self._sdl.get_count()):
            if self._sdl.is_controller(index):
                self._one = self._sdl.Controller(index)
                return
