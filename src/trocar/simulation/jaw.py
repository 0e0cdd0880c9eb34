"""The jaw of an instrument: the arm's verbs for its last joint."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from trocar.errors import InputError
from trocar.simulation.control import JointControl
from trocar.simulation.journal import Journal, command
from trocar.simulation.moves import Motion
from trocar.simulation.records import JointState

R = TypeVar("R")


class Jaw:
    """The verbs of an arm's jaw; positions are the full opening angle [rad]."""

    #: Source: dvrk_python psm.py, close and open of the jaw. [rad]
    CLOSED = float(np.deg2rad(-20.0))
    OPEN = float(np.deg2rad(60.0))

    def __init__(self, name: str, journal: Journal, report_state: Callable[[], None]) -> None:
        self._journal, self._source, self._prefix = journal, name, "jaw."
        self._report_state = report_state
        self._joints: JointControl | None = None

    def __repr__(self) -> str:
        if self._joints is None:
            return f"<Jaw of {self._source!r}: none mounted>"
        angle, goal = (float(js.position[0]) for js in (self.measured_js(), self.setpoint_js()))
        return f"<Jaw of {self._source!r}: {angle:.4f} rad, set-point {goal:.4f} rad>"

    def fit(self, control: JointControl | None) -> None:
        """Set the joints of the mounted tool, None where it has no jaw."""
        self._joints = control
        if control is not None:
            self._part = slice(len(control.joint_names) - 1, len(control.joint_names))
            self._lower, self._upper = float(control.lower[-1]), float(control.upper[-1])

    def measured_js(self) -> JointState:
        """Return the measured opening, its velocity and effort."""
        return self._control.measured(self._part)

    def setpoint_js(self) -> JointState:
        """Return the opening that the servo follows; below 0 it is grip."""
        return self._control.setpoint(self._part)

    @command
    def servo_jp(self, q: ArrayLike, v: ArrayLike | None = None) -> bool:
        """Set the opening now, (1,) [rad]."""
        return self._reported(self._control.servo(q, v, self._part, "jaw.servo_jp"))

    @command
    def servo_jr(self, dq: ArrayLike) -> bool:
        """Add to the opening's set-point now, (1,) [rad]."""
        return self._reported(self._control.servo_relative(dq, self._part, "jaw.servo_jr"))

    @command
    def servo_jf(self, effort: ArrayLike) -> bool:
        """Set the jaw's effort, (1,) [N m]; it persists until the next command."""
        return self._reported(self._control.servo_effort(effort, self._part, "jaw.servo_jf"))

    @command
    def move_jp(self, q: ArrayLike) -> Motion:
        """Move the opening to a goal, (1,) [rad]."""
        return self._reported(self._control.move(q, [self._part], "jaw.move_jp"))

    @command
    def move_jr(self, dq: ArrayLike) -> Motion:
        """Move on from the opening's goal or set-point, (1,) [rad]."""
        return self._reported(self._control.move_relative(dq, self._part, "jaw.move_jr"))

    @command
    def close(self) -> Motion:
        """Close with grip: to -20 deg, or as far below 0 as the limits allow."""
        return self.move_jp([max(self.CLOSED, self._lower)])

    @command
    def open(self) -> Motion:
        """Open to 60 deg, or as far as the limits allow."""
        return self.move_jp([min(self.OPEN, self._upper)])

    @property
    def _control(self) -> JointControl:
        if self._joints is None:
            raise InputError(f"{self._source} has no jaw with this tool")
        return self._joints

    def _reported(self, answer: R) -> R:
        """Report the arm's state, which the jaw's moves are part of; return the answer."""
        self._report_state()
        return answer
