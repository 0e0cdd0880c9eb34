"""The schedule of a world's parts: acts before and after physics steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

Act = Callable[[], object]


@dataclass(frozen=True, eq=False)
class ScheduleEntry:
    """One part of a world, and how often it acts.

    Attributes:
        every: physics steps, counted from the reset
        before: called before the step that leaves each multiple of `every`, after the commands
            that were given there; None: nothing
        look: called after the step that reaches each multiple of `every`; None: nothing
    """

    every: int
    before: Act | None = None
    look: Act | None = None


class Phase(NamedTuple):
    """Acts that are due at one step of the common cycle of all entries.

    Attributes:
        looks: called once such a step is reached
        due: called before the step that leaves it
        gap: physics steps until any entry is due
    """

    looks: tuple[Act, ...]
    due: tuple[Act, ...]
    gap: int


class Schedule:
    """Acts of a world's parts, in the order of their entries; drawn up when parts attach.

    Physics runs from one multiple to the next without a look at any part. Whoever steps calls what
    is `due` once, and once `next` is reached the looks of its phase, and brings both up to date:
    `World.step` does so in place, which takes no call.

    Attributes:
        phases: of the physics steps of a cycle, made when first asked for
        cycle: physics steps after which phases come again
        due: each `before` that is to be called before the next physics step
        next: the next physics step at which any entry is due
    """

    def __init__(self, entries: Iterable[ScheduleEntry]) -> None:
        made = tuple(entries)
        self.phases = _Phases(made)
        self.cycle = math.lcm(*(one.every for one in made))
        self.due: tuple[Act, ...] = ()
        self.next = 0
        self.seek(0)

    def seek(self, step: int) -> None:
        """Go on from where so many physics steps were made since the reset."""
        _, self.due, gap = self.phases[step % self.cycle]
        self.next = step + gap


class _Phases(dict[int, Phase]):
    """The phase of each physics step of a cycle."""

    def __init__(self, entries: tuple[ScheduleEntry, ...]) -> None:
        super().__init__()
        self._entries = entries

    def __missing__(self, step: int) -> Phase:
        here = [one for one in self._entries if step % one.every == 0]
        found = self[step] = Phase(
            tuple([one.look for one in here if one.look is not None]),
            tuple([one.before for one in here if one.before is not None]),
            min(one.every - step % one.every for one in self._entries),
        )
        return found
