"""The last joint of an arm: the jaw of an instrument, or the gripper of a master."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from trocar.errors import InputError
from trocar.simulation.control import JointControl
from trocar.simulation.journal import Journal, command
from trocar.simulation.moves import Motion
from trocar.simulation.records import JointState
from trocar.simulation.servos import EFFORT, POSITION


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
        control = self._joints
        if control is None:
            raise InputError(f"{self._source} has no jaw with this tool")
        return control.servo(q, v, self._part, "jaw.servo_jp")

    @command
    def servo_jr(self, dq: ArrayLike) -> bool:
        """Add to the opening's set-point now, (1,) [rad]."""
        return self._control.servo_relative(dq, self._part, "jaw.servo_jr")

    @command
    def servo_jf(self, effort: ArrayLike) -> bool:
        """Set the jaw's effort, (1,) [N m]; it persists until the next command."""
        return self._control.servo_effort(effort, self._part, "jaw.servo_jf")

    @command
    def move_jp(self, q: ArrayLike) -> Motion:
        """Move the opening to a goal, (1,) [rad]; beyond a limit the set-point waits there."""
        return self._begun(self._control.move(q, self._part, "jaw.move_jp", beyond=True))

    @command
    def move_jr(self, dq: ArrayLike) -> Motion:
        """Move on from the opening's goal or set-point, (1,) [rad]."""
        return self._begun(self._control.move_relative(dq, self._part, "jaw.move_jr"))

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

    def _begun(self, motion: Motion) -> Motion:
        """Report the arm's state, which the jaw's moves are part of; return the move."""
        self._report_state()
        return motion


#: A gripper counts as closed below this opening. Source: our own choice; the dVRK's default is 0
#: on a potentiometer that is calibrated to pass it. [rad]
CLOSED_RAD = float(np.deg2rad(1.0))
#: Time for which it must stay closed or open before that is reported.
#: Source: SAW mtsIntuitiveResearchKitMTM.h, gripper_events.debounce_threshold. [s]
DEBOUNCE_S = 0.2


class Gripper:
    """The gripper of a master; positions are the opening angle [rad].

    It has no motor. What a person's fingers do is `squeeze`, `squeeze_to` and `release`.

    Attributes:
        closed: whether it is shut, once that has lasted 0.2 s
        pinches: how often it was shut since the last reset
        since: when it was found shut or open for the first time, until that counts [s]
    """

    def __init__(
        self, name: str, control: JointControl, journal: Journal, now: Callable[[], float]
    ) -> None:
        self._journal, self._source, self._prefix = journal, name, "gripper."
        self._now, self._control = now, control
        self._joint = control.motors.arm.joints[-1]
        self._part = slice(len(control.joint_names) - 1, len(control.joint_names))
        self.forget()

    def measured_js(self) -> JointState:
        """Return the opening, its velocity, and the effort of the fingers (opening is positive)."""
        return self._control.measured(self._part)

    @command
    def squeeze(self, effort: float) -> None:
        """Press the levers together with an effort that persists; 0.16 N m shuts them.

        Args:
            effort: [N m], from 0 to the most that fingers exert

        Raises:
            InputError: another effort
        """
        most = self._joint.effort_max
        self._set_effort(-self._checked("effort", effort, 0.0, most))

    @command
    def squeeze_to(self, angle: float) -> None:
        """Hold the levers at an opening, shut for 0.

        Args:
            angle: [rad], within the gripper's range

        Raises:
            InputError: another angle
        """
        opening = self._checked("angle", angle, self._joint.lower, self._joint.upper)
        spring = self._joint.spring
        against = 0.0 if spring is None else spring.stiffness * (opening - spring.rest)
        self._control.motors.finger(POSITION, opening, against)

    @command
    def release(self) -> None:
        """Release the fingers: the spring opens it."""
        self._set_effort(0.0)

    # ------------------------------------------------------------------ used by the world

    def forget(self) -> None:
        """Begin anew, open and with no pinch counted."""
        self.closed, self.pinches = False, 0
        self.since: float | None = None

    def watch(self) -> None:
        """Notice that it was shut or opened, once that has lasted; to be called every few ms."""
        shut = bool(self.measured_js().position[0] <= CLOSED_RAD)
        if shut == self.closed:
            self.since = None
            return
        if self.since is None:
            self.since = self._now()
        if self._now() - self.since < DEBOUNCE_S:
            return
        self.closed, self.since = shut, None
        self._journal.event(self._source, "gripper/closed", closed=shut)
        if shut:
            self.pinches += 1
            self._journal.event(self._source, "gripper/pinch")

    def _set_effort(self, effort: float) -> None:
        """Exert an effort on the levers, and nothing else."""
        motors = self._control.motors
        motors.finger(EFFORT, float(motors.position[-1]), effort)

    def _checked(self, what: str, value: float, least: float, most: float) -> float:
        number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)  # pyright: ignore[reportUnnecessaryIsInstance]  public input
        if not number or not least <= value <= most:
            raise InputError(
                f"{self._source}: gripper: got {what} {value!r}; allowed: {least:g} to {most:.6g}"
            )
        return float(value)
