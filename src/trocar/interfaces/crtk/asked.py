"""What a client asked of an arm, in the order in which it is obeyed.

A client that sends `enable, home, move_jp` in one burst means the move to follow the homing, which
takes seconds. So while an arm homes, whatever is ordered waits for it, each arm's in a queue of its
own; `disable` and `pause` never wait. Set-points that are streamed do not wait either: when the arm
is home they are worthless, so they meet the arm as it is, which refuses them.

The same queues hold what comes faster than it can be obeyed.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from trocar.errors import DivergedError, TrocarError
from trocar.interfaces.commands import Verb
from trocar.interfaces.inbox import CAPACITY, SUPERSEDING

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

_log = logging.getLogger("trocar")

Warn = Callable[[str, str, str], None]

#: So much of each tick is for obeying what is ordered; what took longer is paid back by the next
#: ticks, so that a flood of commands that all can be obeyed does not stop time. Source: our own
#: choice, half a tick. [s]
BUDGET_S = 0.0005
#: What an arm obeys at once, whatever waits.
AT_ONCE = ("disable", "pause")


@dataclass(frozen=True)
class Asked(Verb):
    """A verb that a client asked for; `turn` says when and how it is applied.

    Args:
        arm, name, values: as of a `Verb`
        topic: the topic that it came by
        turn: the queue of the arms
    """

    topic: str = ""
    turn: Turns | None = field(default=None, repr=False, compare=False)

    def apply(self, world: World) -> None:
        """Let the queue apply it now, or keep it."""
        if self.turn is None:
            super().apply(world)
        else:
            self.turn.take(world, self)

    def do(self, world: World) -> None:
        """Apply it now."""
        super().apply(world)

    @property
    def streamed(self) -> bool:
        """Whether only the newest of its kind counts."""
        return self.name.rpartition(".")[2] in SUPERSEDING


@dataclass(frozen=True)
class Call(Asked):
    """A verb that is none of the arm's own: a function of the world, called in its turn."""

    act: Callable[[World], None] | None = field(default=None, repr=False, compare=False)

    def do(self, world: World) -> None:
        """Call the function."""
        if self.act is not None:
            self.act(world)


class Turns:
    """The commands that wait for their turn; used in the loop's thread only.

    Args:
        warn: called with (arm, topic, reason) for each command that could not be obeyed
        before: called with (world, command) right before a command is applied
        free: called with an arm for which nothing waits any longer
        now: wall time [s]
        capacity: how many may wait for an arm
    """

    def __init__(
        self,
        warn: Warn,
        before: Callable[[World, Asked], None],
        free: Callable[[str], None],
        now: Callable[[], float],
        capacity: int = CAPACITY,
    ) -> None:
        self._warn, self._before, self._free = warn, before, free
        self._now, self._capacity = now, capacity
        self._used_s = 0.0
        self._waiting: dict[str, deque[Asked]] = {}
        self._periods = 0

    @property
    def waiting(self) -> Mapping[str, int]:
        """How many commands wait, of arms for which some do."""
        return {arm: len(queue) for arm, queue in self._waiting.items()}

    def waits(self, arm: str) -> bool:
        """Tell whether commands wait for an arm."""
        return arm in self._waiting

    @property
    def restless(self) -> bool:
        """Whether the next tick matters."""
        return bool(self._waiting) or self._used_s > 0.0

    def take(self, world: World, asked: Asked) -> None:
        """Apply a command, or keep it until its turn comes."""
        queue, home = self._waiting.get(asked.arm), homing(world.arm(asked.arm))
        if asked.name in AT_ONCE:
            self._do(world, asked)
            self._go_on(world, asked.arm)
        elif asked.streamed and (home or not queue):
            self._do(world, asked)
        elif queue and asked.streamed and queue[-1].name == asked.name:
            queue[-1] = asked
        elif queue and len(queue) >= self._capacity:
            self._warn(asked.arm, asked.topic, f"{self._capacity} commands wait already: refused")
        elif queue or home or self._used_s > BUDGET_S:
            self._waiting.setdefault(asked.arm, deque()).append(asked)
        else:
            self._do(world, asked)

    def tick(self, world: World) -> None:
        """Apply what no longer has to wait; to be called every tick."""
        self._used_s = max(0.0, self._used_s - BUDGET_S)
        if self._waiting and world.periods < self._periods:  # a reset came between
            self._drop()
        for arm in tuple(self._waiting):
            self._go_on(world, arm)
        self._periods = world.periods

    def _go_on(self, world: World, arm: str) -> None:
        queue = self._waiting.get(arm)
        before = 0 if queue is None else len(queue)
        while queue and self._used_s <= BUDGET_S and not homing(world.arm(arm)):
            self._do(world, queue.popleft())
        if queue is None or len(queue) == before:
            return
        del self._waiting[arm]
        if queue:  # the other arms' turn comes first
            self._waiting[arm] = queue
        else:
            self._free(arm)

    def _do(self, world: World, asked: Asked) -> None:
        began = self._now()
        try:
            self._before(world, asked)
            asked.do(world)
        except DivergedError:
            raise
        except TrocarError as problem:
            self._warn(asked.arm, asked.topic, str(problem))
        except Exception as problem:  # noqa: BLE001  one command must not end the simulation
            _log.debug("%s %s", asked.arm, asked.name, exc_info=problem)
            self._warn(asked.arm, asked.topic, f"{type(problem).__name__}: {problem}")
        if not asked.streamed:
            self._used_s += self._now() - began

    def _drop(self) -> None:
        for arm, queue in tuple(self._waiting.items()):
            topic = queue[0].topic
            self._warn(arm, topic, f"{len(queue)} commands waited as the world was reset: dropped")
            del self._waiting[arm]
            self._free(arm)


def homing(arm: Arm) -> bool:
    """Tell whether an arm is on its way home: nothing else keeps one busy that is not homed."""
    state = arm.operating_state()
    return state.is_busy and not state.is_homed
