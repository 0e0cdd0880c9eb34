"""A master that is no arm: a pose that a keyboard, a gamepad or a puck moves at some speed."""

from __future__ import annotations

from collections.abc import Callable
from math import radians
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.apps.teleoperation.drive import STILL, Drive
from trocar.apps.teleoperation.reading import MasterLostError, Reading
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import transform, translation

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]

#: A device that said nothing for this long is gone. Source: our own choice: ten times the pause
#: between two words of a page. [s]
SILENCE_S = 0.5
#: Where its handle is at first, in the surgeon's frame. Source: our own choice. [m]
PLACE = (0.0, 0.0, 0.3)
#: Widest that its gripper opens. Source: as a master's. [rad]
WIDEST = radians(60.0)
#: A picture is dragged so much faster than a tool. Source: our own choice.
CAMERA_PACE = 3.0
#: Hands on a picture, from the middle between them. Source: our own choice. [m]
APART = 0.1


class VirtualMaster:
    """A handle in the air.

    Args:
        name: of the device: "KEYBOARD"
        now: wall time [s]
        scale: factor of all its speeds

    Attributes:
        name: as given
        drive: what is asked for now
        scale: as given
    """

    def __init__(self, name: str, now: Callable[[], float], scale: float = 1.0) -> None:
        self.name, self._now = name, now
        self.scale = scale
        self.drive = STILL
        self._heard: float | None = None
        self._T = self._before = translation(PLACE)
        self._gripper = WIDEST
        self._read_at = -1.0

    @property
    def alive(self) -> bool:
        """Whether the device said something a moment ago."""
        return self._heard is not None and self._now() - self._heard <= SILENCE_S

    def hear(self, drive: Drive) -> None:
        """Take what the device says."""
        self.drive, self._heard = drive, self._now()

    def forget(self) -> None:
        """Note that the device is put aside: it is not expected to say anything."""
        self.drive, self._heard = STILL, None

    # ------------------------------------------------------------------ as a master

    def why_not_ready(self, world: World) -> str:  # noqa: ARG002  as every master
        """Return what keeps it from being used."""
        return "" if self.alive else f"{self.name} says nothing"

    def get_ready(self, world: World) -> None:
        """Begin where a hand would."""
        self._T = transform(self._T[:3, :3], PLACE)
        self._read_at = world.time

    def read(self, world: World) -> Reading:
        """Return where it is by now.

        Raises:
            MasterLostError: the device has said nothing for a while
        """
        if self._heard is not None and not self.alive:
            self.forget()
            raise MasterLostError(self.name, f"said nothing for {SILENCE_S:g} s")
        period = world.time - self._read_at
        self._read_at = world.time
        if period > 0.0:
            self._go_on(self.scale * period)
        return Reading(self._T, self._gripper, present=True)

    def _go_on(self, period: float) -> None:
        """Move as the device asks for, for a period at full scale [s]."""
        drive, pace = self.drive, CAMERA_PACE if self.drive.camera else 1.0
        turn = matrix_from_rotation_vector(pace * period * drive.angular)
        place = self._T[:3, 3] + pace * period * drive.linear
        self._before, self._T = self._T, transform(turn @ self._T[:3, :3], place)
        self._gripper = min(max(self._gripper + period * drive.opening, 0.0), WIDEST)

    def align(self, world: World, R: Array) -> str:  # noqa: ARG002  as every master
        """Turn at once: nothing is in the way."""
        self._T = transform(R, self._T[:3, 3])
        return ""

    def meet(self, gripper: float) -> None:
        """Take the opening that fits the jaw's."""
        self._gripper = min(max(gripper, 0.0), WIDEST)

    def give_way(self) -> None:
        """Go back to where it was at the reading before."""
        self._T = self._before

    def let_go(self, world: World, *, locked: bool) -> None:
        """Do nothing: nothing holds it."""

    def hold(self, world: World) -> None:
        """Do nothing: it does not move by itself."""


class HandOf:
    """One of two hands that a virtual master has on the picture.

    Args:
        master: moves both
        left: which
    """

    def __init__(self, master: VirtualMaster, *, left: bool) -> None:
        self.name = f"{master.name}_{'LEFT' if left else 'RIGHT'}"
        self._master = master
        self._offset = np.array([APART if left else -APART, 0.0, 0.0])

    def why_not_ready(self, world: World) -> str:
        """Return what keeps the master from being used."""
        return self._master.why_not_ready(world)

    def get_ready(self, world: World) -> None:
        """Begin anew, upright."""
        self._master.get_ready(world)
        self._master.align(world, np.eye(3))

    def read(self, world: World) -> Reading:
        """Return where the hand is.

        Raises:
            MasterLostError: as the master does
        """
        T = self._master.read(world).T
        return Reading(transform(T[:3, :3], T[:3, 3] + T[:3, :3] @ self._offset), present=True)

    def align(self, world: World, R: Array) -> str:  # noqa: ARG002  as every master
        """Do nothing: hands on a picture are not aligned."""
        return ""

    def meet(self, gripper: float) -> None:
        """Do nothing: the picture has no jaw."""

    def give_way(self) -> None:
        """Do nothing: the endoscope stops at its limits by itself."""

    def let_go(self, world: World, *, locked: bool) -> None:
        """Do nothing: nothing holds it."""

    def hold(self, world: World) -> None:
        """Do nothing: it does not move by itself."""
