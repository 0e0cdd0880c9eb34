"""A slider per joint: a goal to move to, or an effort where the joint is driven open loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import viser

from trocar.interfaces.commands import GripperSqueezeTo, JawMove, JawServoJf, MoveJp, ServoJf
from trocar.interfaces.loop import Loop
from trocar.interfaces.viewer.own_thread import when_touched
from trocar.interfaces.viewer.sheet import ArmSheet, JointSheet

if TYPE_CHECKING:
    from trocar.simulation.records import ArmSnapshot

HANDS_OFF = 5
"""Looks without a touch after which the sliders follow the arm. Source: half a second at 10 Hz."""


class JointSliders:
    """The sliders of one arm, inside the GUI container that is open when it is made.

    A slider posts a move, so that the arm keeps its velocity limits however fast it is dragged.
    A touch changes the goal of its own joint only. While nobody touches them and the arm is at
    rest, or moves for another reason (a named pose, a script), the sliders follow the set-points.

    Args:
        gui: where to add them
        loop: where to post moves
        sheet: the arm
        now: the arm's state; the sliders start at its set-points
    """

    def __init__(self, gui: viser.GuiApi, loop: Loop, sheet: ArmSheet, now: ArmSnapshot) -> None:
        self._gui, self._loop, self._sheet = gui, loop, sheet
        self._goal = np.array(now.setpoint, dtype=float)
        self._effort = np.zeros_like(self._goal)
        self._mine = False
        self._untouched = 0
        self._folder = gui.add_folder(None)
        self._handles: list[viser.GuiSliderHandle[float]] = []
        self._modes: tuple[str, ...] = ()
        self._build(tuple(now.modes))

    def follow(self, now: ArmSnapshot) -> None:
        """Bring the sliders in line with the arm; to be called about ten times a second."""
        if tuple(now.modes) != self._modes:
            self._effort[:] = 0.0
            self._build(tuple(now.modes))
        for handle, locked in zip(self._handles, now.locked, strict=True):
            handle.disabled = locked  # a brake holds
        self._untouched += 1
        if self._untouched > HANDS_OFF and not now.busy:
            self._mine = False
        if not self._mine:
            self._goal[:] = now.setpoint
            self._show_goal()

    def let_go(self) -> None:
        """Follow the arm from now on: it was sent somewhere by other means than a slider."""
        self._mine = False

    def _build(self, modes: tuple[str, ...]) -> None:
        self._modes = modes
        for handle in self._handles:
            handle.remove()
        with self._folder:
            self._handles = [self._slider(k) for k in range(len(self._sheet.joints))]

    def _slider(self, k: int) -> viser.GuiSliderHandle[float]:
        joint = self._sheet.joints[k]
        if self._pushed(k):
            low, high, step = effort_range(joint)
            label, value = f"{joint.name} {joint.unit.effort_text}", float(self._effort[k])
        else:
            low, high, step = goal_range(joint)
            label, value = f"{joint.name} {joint.unit.text}", self._goal[k] * joint.unit.scale
        handle = self._gui.add_slider(
            label, min=low, max=high, step=step, initial_value=_shown(value, low, high, step)
        )
        when_touched(handle, lambda value: self._touched(k, value))
        return handle

    def _touched(self, k: int, value: float) -> None:
        joint = self._sheet.joints[k]
        self._untouched, self._mine = 0, True
        if self._pushed(k):
            self._effort[k] = value
            self._push(joint)
        else:
            self._goal[k] = np.clip(value / joint.unit.scale, joint.lower, joint.upper)
            self._move(joint)

    def _move(self, joint: JointSheet) -> None:
        arm = self._sheet.name
        if joint.is_gripper:
            self._loop.post(GripperSqueezeTo(arm, float(self._goal[-1])))
        elif joint.is_jaw:
            self._loop.post(JawMove(arm, float(self._goal[-1])))
        else:
            self._loop.post(MoveJp(arm, self._own(self._goal)))

    def _push(self, joint: JointSheet) -> None:
        arm = self._sheet.name
        if joint.is_jaw:
            self._loop.post(JawServoJf(arm, float(self._effort[-1])))
        else:
            self._loop.post(ServoJf(arm, self._own(self._effort)))

    def _pushed(self, k: int) -> bool:
        """Tell whether a slider is an effort; fingers have an opening whatever the mode."""
        return self._modes[k] == "effort" and not self._sheet.joints[k].is_gripper

    def _own(self, values: np.ndarray) -> tuple[float, ...]:
        joints = enumerate(self._sheet.joints)
        own = [k for k, joint in joints if not (joint.is_jaw or joint.is_gripper)]
        return tuple(float(values[k]) for k in own)

    def _show_goal(self) -> None:
        for k, handle in enumerate(self._handles):
            if self._pushed(k):
                continue
            value = self._goal[k] * self._sheet.joints[k].unit.scale
            if abs(value - handle.value) > 0.6 * handle.step:
                handle.value = _shown(value, handle.min, handle.max, handle.step)


def goal_range(joint: JointSheet) -> tuple[float, float, float]:
    """Choose a slider's ends and step in shown units: tenths, never beyond the limits."""
    step, scale = 0.1, joint.unit.scale
    low = np.ceil(joint.lower * scale / step - 1e-6) * step
    high = np.floor(joint.upper * scale / step + 1e-6) * step
    return round(float(low), 1), round(float(high), 1), step


def effort_range(joint: JointSheet) -> tuple[float, float, float]:
    """Choose an effort slider's ends and step [N m or N]: a step is a hundredth, rounded down."""
    high = joint.effort_max
    step = 10.0 ** np.floor(np.log10(high / 100.0))
    high = float(np.floor(high / step + 1e-6) * step)
    return -high, high, float(step)


def _shown(value: float, low: float, high: float, step: float) -> float:
    return float(np.clip(round(round(value / step) * step, 6), low, high))
