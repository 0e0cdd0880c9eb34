"""The commands that a world was given before anybody recorded it: what its state came from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

import numpy as np

from trocar.simulation.journal import Entry

if TYPE_CHECKING:
    from trocar.simulation.world import World

#: What is kept at most. A recording that begins later cannot be repeated. Source: our own choice.
MOST_COMMANDS = 4096
MOST_NUMBERS = 30_000


class Past:
    """Keeps the first commands of a world, as long as they are few."""

    def __init__(self, world: World) -> None:
        self.entries: list[Entry] = []
        self._numbers = 0
        self.why_not = ""
        self._deaf = world.listen(self._hear)

    @property
    def complete(self) -> bool:
        """Whether these are all commands so far."""
        return not self.why_not

    def _hear(self, entry: Entry) -> None:
        if entry.kind != "command":
            return
        self.entries.append(entry)
        self._numbers += _numbers(entry.values)
        if len(self.entries) > MOST_COMMANDS or self._numbers > MOST_NUMBERS:
            self.why_not = (
                f"it began after more than {MOST_COMMANDS} commands or {MOST_NUMBERS} numbers in"
                " them; begin it earlier"
            )
            self.entries.clear()
            self._deaf()


def _numbers(value: object) -> int:
    """Return how many numbers are kept for a value."""
    if isinstance(value, np.ndarray):
        return value.size
    if isinstance(value, Mapping):
        return sum(map(_numbers, cast(Mapping[object, object], value).values()))
    if isinstance(value, list | tuple):
        return sum(map(_numbers, cast(list[object], value)))
    return 1
