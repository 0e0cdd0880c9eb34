"""What a hand holds, wherever it comes from: a frozen reading of a master."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]


class MasterLostError(TrocarError):
    """A master that says nothing any longer, or cannot move.

    Attributes:
        master: its name
        reason: what became of it
    """

    def __init__(self, master: str, reason: str) -> None:
        self.master, self.reason = master, reason
        super().__init__(f"{master}: {reason}")


@dataclass(frozen=True, eq=False)
class Reading:
    """A master at a moment.

    Attributes:
        T: pose of the handle in the surgeon's frame: x left, y up, z away from the eyes, (4, 4)
        gripper: its opening, None without one [rad]
        present: whether a hand is known to be there; else it has to move gripper or roll
        turning: whether it is being aligned, so that it is no hand that turns it
    """

    T: Array
    gripper: float | None = None
    present: bool = False
    turning: bool = False


class Master(Protocol):
    """What moves a slave. Everything is called in the loop's thread.

    Attributes:
        name: "MTMR", ...
    """

    name: str

    def why_not_ready(self, world: World) -> str:
        """Return what keeps it from being used, "" when nothing does."""
        ...

    def get_ready(self, world: World) -> None:
        """Ask it to become usable; that may take a while."""
        ...

    def read(self, world: World) -> Reading:
        """Return where it is.

        Raises:
            MasterLostError: it says nothing any longer
        """
        ...

    def align(self, world: World, R: Array) -> str:
        """Turn towards an orientation (3, 3) where it is; return what keeps it from that, or ""."""
        ...

    def meet(self, gripper: float) -> None:
        """Learn which opening fits the jaw's [rad]; one that has no fingers takes it."""
        ...

    def give_way(self) -> None:
        """Learn that the slave cannot follow; one that is moved by speeds goes back a step."""
        ...

    def let_go(self, world: World, *, locked: bool) -> None:
        """Let the hand move it freely; locked: all but its orientation."""
        ...

    def hold(self, world: World) -> None:
        """Stay where it is."""
        ...
