"""The jaw of an instrument: the arm's verbs for its last joint."""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.simulation.journal import Journal, command
from trocar.simulation.motion import Motion
from trocar.simulation.records import JointState

Array = NDArray[np.float64]
R = TypeVar("R")


class Owner(Protocol):
    """What a jaw needs to know of its arm."""

    name: str
    lower: Array
    upper: Array
    journal: Journal

    def tell_state(self) -> None:
        """Tell the journal of the operating state, when it changed."""
        ...


class PartVerbs(Protocol):
    """What a jaw needs of its arm: the verbs for some of its joints."""

    def state(self, part: slice, setpoint: bool) -> JointState:
        """Return measured values or set-points."""
        ...

    def servo(self, q: ArrayLike, v: ArrayLike | None, part: slice, verb: str) -> bool:
        """Set positions now."""
        ...

    def servo_effort(self, effort: ArrayLike, part: slice, verb: str) -> bool:
        """Set efforts."""
        ...

    def servo_relative(self, dq: ArrayLike, part: slice, verb: str) -> bool:
        """Add to the set-points."""
        ...

    def move(self, q: ArrayLike, part: slice, verb: str) -> Motion:
        """Move to a goal."""
        ...

    def move_relative(self, dq: ArrayLike, part: slice, verb: str) -> Motion:
        """Add to the goal."""
        ...


class NoJaw:
    """The verbs of a jaw that is still held when the mounted tool has none: each says so."""

    def __init__(self, arm: str) -> None:
        self._arm = arm

    def _refuse(self) -> InputError:
        return InputError(f"{self._arm} has no jaw with this tool")

    def state(self, part: slice, setpoint: bool) -> JointState:  # noqa: ARG002  as PartVerbs
        """Refuse."""
        raise self._refuse()

    def servo(self, q: ArrayLike, v: ArrayLike | None, part: slice, verb: str) -> bool:  # noqa: ARG002
        """Refuse."""
        raise self._refuse()

    def servo_effort(self, effort: ArrayLike, part: slice, verb: str) -> bool:  # noqa: ARG002
        """Refuse."""
        raise self._refuse()

    def servo_relative(self, dq: ArrayLike, part: slice, verb: str) -> bool:  # noqa: ARG002
        """Refuse."""
        raise self._refuse()

    def move(self, q: ArrayLike, part: slice, verb: str) -> Motion:  # noqa: ARG002
        """Refuse."""
        raise self._refuse()

    def move_relative(self, dq: ArrayLike, part: slice, verb: str) -> Motion:  # noqa: ARG002
        """Refuse."""
        raise self._refuse()


class Jaw:
    """The verbs of an arm's jaw; positions are the full opening angle [rad]."""

    #: Source: dvrk_python psm.py, close and open of the jaw. [rad]
    CLOSED = float(np.deg2rad(-20.0))
    OPEN = float(np.deg2rad(60.0))

    def __init__(self, owner: Owner, verbs: PartVerbs, index: int) -> None:
        self._journal, self._source, self._prefix = owner.journal, owner.name, "jaw."
        self._owner = owner
        self.fit(verbs, index)

    def fit(self, verbs: PartVerbs, index: int) -> None:
        """Take the verbs and limits of the tool that is mounted now."""
        self._verbs = verbs
        self._part = slice(index, index + 1)
        self._lower, self._upper = float(self._owner.lower[index]), float(self._owner.upper[index])

    def measured_js(self) -> JointState:
        """Return the measured opening, its velocity and effort."""
        return self._verbs.state(self._part, setpoint=False)

    def setpoint_js(self) -> JointState:
        """Return the opening that the servo follows; below 0 it is grip."""
        return self._verbs.state(self._part, setpoint=True)

    @command
    def servo_jp(self, q: ArrayLike, v: ArrayLike | None = None) -> bool:
        """Set the opening now, (1,) [rad]."""
        return self._told(self._verbs.servo(q, v, self._part, "jaw.servo_jp"))

    @command
    def servo_jr(self, dq: ArrayLike) -> bool:
        """Add to the opening's set-point now, (1,) [rad]."""
        return self._told(self._verbs.servo_relative(dq, self._part, "jaw.servo_jr"))

    @command
    def servo_jf(self, effort: ArrayLike) -> bool:
        """Set the jaw's effort, (1,) [N m]; it persists until the next command."""
        return self._told(self._verbs.servo_effort(effort, self._part, "jaw.servo_jf"))

    @command
    def move_jp(self, q: ArrayLike) -> Motion:
        """Move the opening to a goal, (1,) [rad]."""
        return self._told(self._verbs.move(q, self._part, "jaw.move_jp"))

    @command
    def move_jr(self, dq: ArrayLike) -> Motion:
        """Move on from the opening's goal or set-point, (1,) [rad]."""
        return self._told(self._verbs.move_relative(dq, self._part, "jaw.move_jr"))

    @command
    def close(self) -> Motion:
        """Close with grip: to -20 deg, or as far below 0 as the limits allow."""
        return self.move_jp([max(self.CLOSED, self._lower)])

    @command
    def open(self) -> Motion:
        """Open to 60 deg, or as far as the limits allow."""
        return self.move_jp([min(self.OPEN, self._upper)])

    def _told(self, answer: R) -> R:
        """Tell the arm's state, which the jaw's moves are part of."""
        self._owner.tell_state()
        return answer
