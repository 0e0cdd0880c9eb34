"""The only thread boundary: commands wait here until the next tick."""

from __future__ import annotations

import logging
import threading
from collections import Counter

from trocar.interfaces.commands import (
    Command,
    GripperSqueezeTo,
    JawServo,
    JawServoJf,
    ServoJf,
    ServoJp,
    Verb,
)
from trocar.interfaces.state import Question

_log = logging.getLogger("trocar")

CAPACITY = 64
"""How many moves and states of an arm may wait. Source: our own choice, many ticks of orders."""

SUPERSEDING = {"servo_jp", "servo_jf", "servo_cp", "servo_cf", "servo_ci", "squeeze_to"}
"""Set-points of which only the newest counts; servo_jr and servo_cr add up, so each counts."""


class Inbox:
    """Keep commands in the order in which they came; of set-points only the newest per arm.

    A stream of set-points (servo) may come faster than ticks: an older one that still waits is
    worthless, so the newer takes its place at the end of the queue. Moves and states all count
    and are bounded for each arm: when too many wait, a new one is refused with a warning, the
    first of many. What somebody floods one arm with keeps nobody from another.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._lock = threading.Lock()
        self._waiting: dict[object, Command] = {}
        self._posted = 0
        self._ordered: Counter[str] = Counter()
        self._said = False
        self.refused = 0

    def post(self, command: Command) -> bool:
        """Queue a command; return False when it was refused because too many wait."""
        key, arm = stream(command), getattr(command, "arm", "")
        with self._lock:
            full = key is None and self._ordered[arm] >= self._capacity
            if full:
                self.refused += 1
                say, self._said = not self._said, True
            else:
                say = False
                self._put(key, arm, command)
        if say:
            _log.warning("%d commands wait already: refused %r", self._capacity, command)
        return not full

    def drain(self) -> list[Command]:
        """Take everything that waits, oldest first."""
        with self._lock:
            taken = list(self._waiting.values())
            self._waiting.clear()
            self._ordered.clear()
            self._said = False
        return taken

    def dismiss(self) -> None:
        """Throw away what waits; whoever waits for an answer learns that none will come."""
        for command in self.drain():
            if isinstance(command, Question):
                command.answer.cancel()

    def _put(self, key: tuple[str, str] | None, arm: str, command: Command) -> None:
        self._posted += 1
        if key is None:
            self._ordered[arm] += 1
            self._waiting[self._posted] = command
        else:
            self._waiting.pop(key, None)
            self._waiting[key] = command


def stream(command: Command) -> tuple[str, str] | None:
    """Name the stream of set-points that a command belongs to, or None for moves and states."""
    if isinstance(command, ServoJp | ServoJf):
        return command.arm, "arm"
    if isinstance(command, JawServo | JawServoJf):
        return command.arm, "jaw"
    if isinstance(command, Verb):
        *part, verb = command.name.split(".")
        if verb in SUPERSEDING:
            return command.arm, part[0] if part else "arm"
    if isinstance(command, GripperSqueezeTo):
        return command.arm, "gripper"
    return getattr(command, "stream", None)
