"""Attack a simulator with seeded programs, each of which counts what it tried and what failed.

Each module of this package with `attack(seed, seconds) -> Tally` is an attack, named as its file.
An attack that measures times of a running simulator sets `ALONE = True`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

#: A scene whose rig, objects and task are attacked, too: a grasp that is passed between two arms.
SCENE = "needle-handover"


@dataclass
class Tally:
    """Counts of one attack.

    Attributes:
        name: of the attack
        tried: cases
        failed: a line for each case that failed: what was sent, what came of it
        table: rows of the attack's own findings, the head first; none for most
    """

    name: str
    tried: int = 0
    failed: list[str] = field(default_factory=list[str])
    table: list[list[str]] = field(default_factory=list[list[str]])

    @property
    def clean(self) -> int:
        """Cases that did not fail."""
        return self.tried - len(self.failed)
