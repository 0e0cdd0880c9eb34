"""What a package of your own can add to trocar; pyproject.toml registers each of these names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from trocar.simulation.controllers import Action, TipState

FOLDER = Path(__file__).parent
#: Files in the formats of docs/descriptions.md.
LONG_PSM = FOLDER / "long_psm.toml"
BLUNT_DRIVER = FOLDER / "blunt_driver.toml"
BENCH = FOLDER / "bench.toml"
DUMBBELL = FOLDER / "dumbbell.toml"


@dataclass
class Float:
    """A controller: joint efforts against velocity, so that the arm floats as in honey.

    Attributes:
        damping: effort per speed of every joint [N m s/rad or N s/m]
    """

    damping: float = 1.0

    def act(self, now: TipState) -> Action:
        """Return the efforts of the next step, (n,) [N m or N]."""
        return Action(-self.damping * now.qd)


class Lift:
    """A task: done when the dumbbell is higher than 50 mm."""

    def done(self, world) -> bool:
        """Return whether the dumbbell has been lifted."""
        return bool(world.object("dumbbell").measured_cp().matrix[2, 3] > 0.05)
