"""How an arm is controlled: mode, gravity compensation, gains, brakes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from trocar.interfaces.commands import (
    Brakes,
    Mode,
    SetGains,
    SetGravityCompensation,
    SetMode,
)
from trocar.interfaces.loop import Loop
from trocar.interfaces.viewer.own_thread import when_pressed, when_touched
from trocar.interfaces.viewer.sheet import ArmSheet, JointSheet

if TYPE_CHECKING:
    from trocar.simulation.records import ArmSnapshot

MODES: dict[str, Mode] = {
    "position (PID)": "position",
    "effort (open loop)": "effort",
    "set (kinematic)": "set",
}
ALL_JOINTS = "all joints"
RELEASE = "Release"


class ModeChoice:
    """Which control mode is in force, for the whole arm or for one joint of it."""

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet, now: ArmSnapshot) -> None:
        self._loop, self._sheet = loop, sheet
        self._names = [joint.name for joint in sheet.joints]
        self._mode = gui.add_dropdown("Mode", list(MODES), initial_value=_title(now.modes[0]))
        self._scope = gui.add_dropdown("Applies to", [ALL_JOINTS, *self._names])
        when_touched(self._mode, self._chosen)

    def follow(self, now: ArmSnapshot) -> None:
        """Show the mode in force."""
        scope = self._scope.value
        index = 0 if scope == ALL_JOINTS else self._names.index(scope)
        self._mode.value = _title(now.modes[index])

    def _chosen(self, title: str) -> None:
        scope = self._scope.value
        joints = None if scope == ALL_JOINTS else (scope,)
        self._loop.post(SetMode(self._sheet.name, MODES[title], joints))


class GravityChoice:
    """Whether motors carry the weight of the links."""

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet) -> None:
        self._box = gui.add_checkbox("Gravity comp.", sheet.gravity_compensation)

        when_touched(self._box, lambda on: loop.post(SetGravityCompensation(sheet.name, on)))

    def follow(self, sheet: ArmSheet) -> None:
        """Show what is in force."""
        self._box.value = sheet.gravity_compensation


class GainsTable:
    """Three numbers per joint: P, I, D."""

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet) -> None:
        self._rows = {joint.name: _gains_row(gui, loop, sheet, joint) for joint in sheet.joints}

    def follow(self, sheet: ArmSheet) -> None:
        """Show what is in force."""
        for joint in sheet.joints:
            self._rows[joint.name].value = joint.gains


class BrakeButtons:
    """Release and lock the brakes of a setup arm."""

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet) -> None:
        buttons = gui.add_button_group("Brakes", (RELEASE, "Lock"))

        when_pressed(buttons, lambda name: loop.post(Brakes(sheet.name, name == RELEASE)))


def _gains_row(
    gui: viser.GuiApi, loop: Loop, sheet: ArmSheet, joint: JointSheet
) -> viser.GuiVector3Handle:
    unit = joint.unit.gain_text
    hint = f"P [{unit}], I [{unit} per second], D [{unit} times second]"
    row = gui.add_vector3(joint.name, joint.gains, min=(0.0, 0.0, 0.0), step=0.01, hint=hint)

    def changed(gains: tuple[float, float, float]) -> None:
        p, i, d = gains
        loop.post(SetGains(sheet.name, joint.name, p=p, i=i, d=d))

    when_touched(row, changed)
    return row


def _title(mode: str) -> str:
    return next(title for title, name in MODES.items() if name == mode)
