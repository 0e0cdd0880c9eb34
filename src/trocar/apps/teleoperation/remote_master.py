"""A master that is somewhere else: a real MTM, or a program, that speaks over the same topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.teleoperation.reading import MasterLostError, Reading
from trocar.geometry.rotations import angle_between
from trocar.geometry.se3 import transform

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]

#: A master that said nothing for this long is gone. Source: our own choice: ten messages of the
#: dVRK's slowest usual rate. [s]
SILENCE_S = 0.1
#: Its goal is told again so often while it is aligned. Source: our own choice. [s]
AGAIN_S = 1.0
TURNED = np.deg2rad(0.2)

#: Called with a topic without the arm's name, and the fields of its message.
Publish = Callable[[str, Mapping[str, Any]], None]


class RemoteMaster:
    """Keeps what the topics of a master said last, and asks over them what is asked of it.

    Args:
        name: what stands before its topics: "MTMR"
        now: wall time [s]

    Attributes:
        name: as given
        publish: sends a message to it
    """

    def __init__(self, name: str, now: Callable[[], float]) -> None:
        self.name, self._now = name, now
        self.publish: Publish = lambda topic, fields: None  # noqa: ARG005  nobody listens yet
        self._T: Array | None = None
        self._gripper: float | None = None
        self._heard: float | None = None
        self._state: tuple[str, bool] = ("", False)
        self._wanted: Array | None = None
        self._asked = -np.inf

    # ------------------------------------------------------------------ what it says

    def hear_pose(self, T: Array) -> None:
        """Take where it is, in the frame of the stereo display, (4, 4)."""
        self._T, self._heard = T, self._now()

    def hear_gripper(self, opening: float) -> None:
        """Take how far its gripper is open [rad]."""
        self._gripper = opening

    def hear_state(self, state: str, homed: bool) -> None:
        """Take its operating state."""
        self._state = state, homed

    # ------------------------------------------------------------------ as a master

    def why_not_ready(self, world: World) -> str:  # noqa: ARG002  as every master
        """Return what keeps it from being used."""
        if self._T is None:
            return f"{self.name} says nothing"
        state, homed = self._state
        if state and (state != "ENABLED" or not homed):
            return f'{self.name} is not in state "ENABLED" and homed but "{state}"'
        return ""

    def get_ready(self, world: World) -> None:
        """Ask it to be enabled and homed, where it said that it is not."""
        self._wanted = None
        if self._T is not None and self.why_not_ready(world):
            self.publish("state_command", {"string": "home"})

    def read(self, world: World) -> Reading:  # noqa: ARG002  as every master
        """Return what it said last.

        Raises:
            MasterLostError: it has said nothing for a while
        """
        if self._T is None or self._heard is None:
            return Reading(np.eye(4))
        if self._now() - self._heard > SILENCE_S:
            self._T = self._heard = None
            raise MasterLostError(self.name, f"said nothing for {SILENCE_S:g} s")
        return Reading(self._T, self._gripper)

    def align(self, world: World, R: Array) -> str:  # noqa: ARG002  as every master
        """Ask it to turn where it is."""
        if self._T is None:
            return f"{self.name} says nothing"
        turned = self._wanted is None or angle_between(self._wanted, R) > TURNED
        if turned or self._now() - self._asked > AGAIN_S:
            self._wanted, self._asked = R.copy(), self._now()
            self.publish("move_cp", {"T": transform(R, self._T[:3, 3])})
        return ""

    def meet(self, gripper: float) -> None:
        """Do nothing: fingers hold the gripper, and the jaw comes to them."""

    def give_way(self) -> None:
        """Do nothing: the hand is where it is."""

    def let_go(self, world: World, *, locked: bool) -> None:  # noqa: ARG002  as every master
        """Ask it to exert nothing but what carries its links, as the dVRK does."""
        self._wanted = None
        self.publish("use_gravity_compensation", {"data": True})
        self.publish("body/servo_cf", {})
        if locked and self._T is not None:
            self.publish("lock_orientation", {"T": self._T})
        else:
            self.publish("unlock_orientation", {})

    def hold(self, world: World) -> None:  # noqa: ARG002  as every master
        """Ask it to stay where it is."""
        self._wanted = None
        if self._T is not None:
            self.publish("hold", {})
