"""Which parts of a world act before or after which physics step."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

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


class Schedule:
    """Acts of a world's parts, in the order of their entries; drawn up when parts attach.

    Physics runs from one multiple to the next without a look at any part.

    Attributes:
        due: each `before` that is to be called before the next physics step
        next: the next physics step at which any entry is due
    """

    def __init__(self, entries: Iterable[ScheduleEntry]) -> None:
        found = [*entries]
        self._before = [(one.every, one.before) for one in found if one.before is not None]
        self._looks = [(one.every, one.look) for one in found if one.look is not None]
        self._periods = sorted({one.every for one in found})
        self.seek(0)

    def seek(self, step: int) -> None:
        """Go on from where so many physics steps were made since the reset."""
        self.due = tuple([act for every, act in self._before if step % every == 0])
        self.next = min([step - step % every + every for every in self._periods])

    def look(self, step: int) -> None:
        """Call each `look` that is due once `step`, which is `next`, is reached."""
        for every, look in self._looks:
            if step % every == 0:
                look()
        self.seek(step)

    def begin(self) -> None:
        """Call each `before` that is due, once."""
        due, self.due = self.due, ()
        for act in due:
            act()
