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

SETTLED = 4
"""Looks at the arm without a touch after which typing is over. Source: most of a second at 5 Hz."""


class ModeChoice:
    """Which control mode is in force, for the whole arm or for one joint of it."""

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet, now: ArmSnapshot) -> None:
        self._loop, self._sheet = loop, sheet
        self._names = [joint.name for joint in sheet.joints if not joint.is_gripper]
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
        self._loop, self._arm = loop, sheet.name
        self._untouched = SETTLED
        self._box = gui.add_checkbox("Gravity comp.", sheet.gravity_compensation)
        when_touched(self._box, self._switched)

    def follow(self, sheet: ArmSheet) -> None:
        """Show what is in force, but not what was in force before the last touch."""
        self._untouched += 1
        if self._untouched >= SETTLED:
            self._box.value = sheet.gravity_compensation

    def _switched(self, on: bool) -> None:
        self._untouched = 0
        self._loop.post(SetGravityCompensation(self._arm, on))


class GainsTable:
    """Three numbers per joint: P, I, D.

    A number that is being typed passes through others (on the way to 120 it is 1 and 12), and an
    arm with P = 1 drops. So gains are posted when the typing has settled.
    """

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet) -> None:
        self._loop, self._arm = loop, sheet.name
        self._typed: dict[str, tuple[float, float, float]] = {}
        self._untouched = SETTLED
        self._rows = {j.name: self._row(gui, j) for j in sheet.joints if not j.is_gripper}

    def follow(self, sheet: ArmSheet) -> None:
        """Post what was typed, or show what is in force."""
        self._untouched += 1
        if self._untouched < SETTLED:
            return
        if self._typed:
            self._post_typed()
            return
        for joint in sheet.joints:
            if joint.name in self._rows:
                self._rows[joint.name].value = joint.gains

    def _post_typed(self) -> None:
        for joint, (p, i, d) in self._typed.items():
            self._loop.post(SetGains(self._arm, joint, p=p, i=i, d=d))
        self._typed.clear()
        self._untouched = 0

    def _row(self, gui: viser.GuiApi, joint: JointSheet) -> viser.GuiVector3Handle:
        unit = joint.unit.gain_text
        hint = f"P [{unit}], I [{unit} per second], D [{unit} times second]"
        row = gui.add_vector3(joint.name, joint.gains, min=(0.0, 0.0, 0.0), step=0.01, hint=hint)
        when_touched(row, lambda gains: self._changed(joint.name, gains))
        return row

    def _changed(self, joint: str, gains: tuple[float, float, float]) -> None:
        self._typed[joint] = gains
        self._untouched = 0


class BrakeButtons:
    """Release and lock the brakes of a setup arm."""

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet) -> None:
        buttons = gui.add_button_group("Brakes", (RELEASE, "Lock"))

        when_pressed(buttons, lambda name: loop.post(Brakes(sheet.name, name == RELEASE)))


def _title(mode: str) -> str:
    return next(title for title, name in MODES.items() if name == mode)
