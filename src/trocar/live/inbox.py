"""Commands, and the inbox in which they wait for the next tick: the only thread boundary."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from trocar.simulation.journal import Entry, apply_command
from trocar.simulation.rate_limit import RateLimit

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

_log = logging.getLogger("trocar")

CAPACITY = 64
"""Moves and states of an arm that may wait. Source: our own choice, many ticks of orders."""

BUDGET_S = 0.0005
"""Part of each tick for commands that came by topics; an overrun is paid back by the next ticks, so
that a flood of valid commands does not stop time. Source: our own choice, half a tick. [s]"""

STREAMS = {
    **dict.fromkeys(
        ("servo_jp", "servo_jf", "servo_jv", "servo_cp", "servo_cf", "servo_ci"), "arm"
    ),
    **dict.fromkeys(("jaw.servo_jp", "jaw.servo_jf"), "jaw"),
    "gripper.squeeze_to": "gripper",
    "servo_jr": "servo_jr",
}
"""Verbs that set a point, and the stream of set-points of which only the newest counts. One
servo_jr for each tick counts: a subscriber of the robot's software keeps one message (cisst-ros
73aca61, mtsROSBridge.h:296). servo_cr, which the robot has not, adds up."""

AT_ONCE = ("disable", "pause")
"""Verbs that neither homing nor waiting commands hold up."""


class Command(msgspec.Struct, frozen=True):
    """A verb of an arm, an object or the world, with its arguments; applied between two ticks.

    Args:
        arm: name of the arm or object; "world" for the verbs of the world, and for those
            of the loop: "pause", "resume", and "step" (while paused)
        verb: "servo_jp", "jaw.move_jp", "reset", ...
        kwargs: arguments by name (SI units and radians)
        topic: name of the topic that brought it; such a command waits while its arm homes
        stream: of those with the same arm and stream only the newest counts; "": as of `STREAMS`
        act: what it does, where that is no verb
        note: a warning about the message that brought it
    """

    arm: str
    verb: str
    kwargs: Mapping[str, Any] = {}
    topic: str = ""
    stream: str = ""
    act: Callable[[Any], object] | None = None
    note: str = ""

    def apply(self, world: World) -> None:
        """Call the verb.

        Raises:
            InputError: the arm, object or world has no such verb
            TrocarError: as the verb raises
        """
        if self.act is not None:
            self.act(world)
            return
        apply_command(
            world, Entry(world.periods, world.time, "command", self.arm, self.verb, self.kwargs)
        )


class Inbox:
    """Keep commands in order of arrival; of each stream of set-points only the newest.

    Other commands are bounded for each arm: beyond the capacity a new one is rejected, so that a
    flood for one arm does not block another.

    A client that sends enable, home and move_jp in one burst means the move to follow the homing,
    which takes seconds. So commands from topics wait while their arm homes; set-points do not: they
    are worthless when the arm is home.

    Args:
        now: wall time [s]
        capacity: commands of an arm that may wait

    Attributes:
        rejected: how many commands were turned away
        drop: called with the first and the number of the commands that a reset overtook
    """

    def __init__(
        self, now: Callable[[], float] = time.perf_counter, capacity: int = CAPACITY
    ) -> None:
        self._now, self._capacity = now, capacity
        self._lock = threading.Lock()
        self._posted: dict[object, Command] = {}
        self._count = 0
        self._ordered: Counter[str] = Counter()
        self._rate_limit = RateLimit()
        self._held: dict[str, deque[Command]] = {}
        self._used_s, self._periods = 0.0, 0
        self.rejected = 0
        self.drop: Callable[[Command, int], None] = lambda first, count: None  # noqa: ARG005

    def post(self, command: Command) -> bool:
        """Queue a command, from any thread; return False when too many wait."""
        arm, stream = command.arm, command.stream or STREAMS.get(command.verb)
        with self._lock:
            if stream:
                key = arm, stream
                self._posted.pop(key, None)
                self._posted[key] = command
                return True
            if self._ordered[arm] + len(self._held.get(arm, ())) < self._capacity:
                self._count += 1
                self._ordered[arm] += 1
                self._posted[self._count] = command
                return True
            self.rejected += 1
        if not command.topic and self._rate_limit.due(arm, self._now()) is not None:
            # the transport reports commands that came over a topic
            text = "rejected %s of %s: %d commands pending"
            _log.warning(text, command.verb, arm, self._capacity)
        return False

    def __len__(self) -> int:
        """Return the number of commands that were posted and not taken."""
        return len(self._posted)

    def drain(self) -> list[Command]:
        """Take everything that was posted, oldest first."""
        with self._lock:
            posted = list(self._posted.values())
            self._posted.clear()
            self._ordered.clear()
        return posted

    def due(self, world: World) -> Iterator[Command]:
        """Take what may be applied in this tick, each when the one before it was applied.

        To be called every tick, in the loop's thread.
        """
        self._used_s = max(0.0, self._used_s - BUDGET_S)
        if self._held and world.periods < self._periods:
            for queue in self._held.values():
                self.drop(queue[0], len(queue))
            self._held.clear()
        for arm in tuple(self._held):
            yield from self._released(world, arm)
        for command in self.drain():
            arm = command.arm
            if not command.topic or arm not in world.arms:
                yield command
                continue
            queue = self._held.get(arm)
            streamed = bool(command.stream or command.verb in STREAMS)
            if command.verb in AT_ONCE:
                yield command
                yield from self._released(world, arm)
            elif streamed and (not queue or homing(world.arm(arm))):
                yield command
            elif queue and streamed and queue[-1].verb == command.verb:
                queue[-1] = command
            elif queue or self._used_s > BUDGET_S or homing(world.arm(arm)):
                self._held.setdefault(arm, deque()).append(command)
            else:
                yield from self._timed(command)
        self._periods = world.periods

    @property
    def held(self) -> frozenset[str]:
        """Arms for which commands wait; in the loop's thread."""
        return frozenset(self._held)

    @property
    def restless(self) -> bool:
        """Whether the next tick matters."""
        return bool(self._held) or self._used_s > 0.0

    def _released(self, world: World, arm: str) -> Iterator[Command]:
        queue = self._held.get(arm)
        if queue is None:
            return
        before = len(queue)
        while queue and self._used_s <= BUDGET_S and not homing(world.arm(arm)):
            yield from self._timed(queue.popleft())
        if len(queue) != before:
            del self._held[arm]
            if queue:  # the other arms' turn comes first
                self._held[arm] = queue

    def _timed(self, command: Command) -> Iterator[Command]:
        began = self._now()
        yield command
        self._used_s += self._now() - began


def homing(arm: Arm) -> bool:
    """Return whether an arm is on its way home."""
    return arm.operating_state().phase == "HOMING"
