"""What was asked of a world, and what happened in it, told to whoever listens.

Every public call that changes anything is one command, so that a list of them, each repeated before
the same physics period, is the same motion again.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, ParamSpec, Protocol, TypeVar, cast

import numpy as np

from trocar.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")
#: Who commands and events come from that concern no single arm or object.
WORLD = "world"


@dataclass(frozen=True, eq=False)
class Entry:
    """One command or event.

    Attributes:
        period: physics periods since the last reset; a command comes before that one is stepped
        time: simulation time [s]
        kind: "command" or "event"
        source: an arm's or an object's name, or "world"
        name: a verb ("servo_jp", "jaw.move_jp", "reset") or an event ("operating_state",
            "goal_reached", "warning", "error", "status")
        values: the verb's arguments by name, or what the event says; copies
    """

    period: int
    time: float
    kind: Literal["command", "event"]
    source: str
    name: str
    values: Mapping[str, Any]


Listener = Callable[[Entry], None]


class Journal:
    """Hands entries to listeners; without any it costs next to nothing."""

    def __init__(self, now: Callable[[], tuple[int, float]]) -> None:
        self._now = now
        self._listeners: list[Listener] = []
        self._inside = 0

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` with every entry from now on; call what is returned to stop."""
        self._listeners.append(listener)

        def stop() -> None:
            if listener in self._listeners:
                self._listeners.remove(listener)

        return stop

    def event(self, source: str, name: str, **values: object) -> None:
        """Tell that something happened."""
        self._tell("event", source, name, values)

    def command(self, source: str, name: str, values: Mapping[str, object]) -> None:
        """Tell what was asked, unless another command asked it."""
        if not self._inside:
            self._tell("command", source, name, values)

    def enter(self) -> None:
        """Begin a command: those that it gives itself are not told."""
        self._inside += 1

    def leave(self) -> None:
        """End a command."""
        self._inside -= 1

    @property
    def heard(self) -> bool:
        """Whether anybody listens."""
        return bool(self._listeners)

    def _tell(
        self,
        kind: Literal["command", "event"],
        source: str,
        name: str,
        values: Mapping[str, object],
    ) -> None:
        if not self._listeners:
            return
        period, time = self._now()
        entry = Entry(period, time, kind, source, name, {k: _copied(v) for k, v in values.items()})
        for listener in tuple(self._listeners):
            listener(entry)


class Commanded(Protocol):
    """Something with verbs: a world, an arm, a jaw."""

    #: Where its commands are told, its arm's name or "world", and what comes before its verbs.
    _journal: Journal
    _source: str
    _prefix: str


def command(verb: Callable[P, R]) -> Callable[P, R]:
    """Mark a method of something `Commanded` as a verb that the journal tells of."""
    signature = inspect.signature(verb)

    @functools.wraps(verb)
    def told(*args: P.args, **kwargs: P.kwargs) -> R:
        owner = cast(Commanded, args[0])
        journal = owner._journal
        if journal.heard:
            values = dict(signature.bind(*args, **kwargs).arguments)
            del values["self"]
            journal.command(owner._source, owner._prefix + verb.__name__, values)
        journal.enter()
        try:
            return verb(*args, **kwargs)
        finally:
            journal.leave()

    told.is_command = True  # type: ignore[attr-defined]
    return told


def apply_command(world: object, entry: Entry) -> None:
    """Repeat a command.

    Raises:
        InputError: it is none that a world or an arm has
        TrocarError: as the verb raises
    """
    target: Any = _commanded(cast(Any, world), entry.source)
    *parts, verb = entry.name.split(".")
    for part in parts:
        target = None if part.startswith("_") else getattr(target, part, None)
    method = None if target is None else getattr(target, verb, None)
    if not getattr(method, "is_command", False):
        raise InputError(f"{entry.source}: got the command {entry.name!r}, which it does not have")
    cast(Any, method)(**entry.values)


def _commanded(world: Any, source: str) -> Any:
    """Return who a command is for: the world, an object or an arm."""
    if source == WORLD:
        return world
    return world.object(source) if source in world.objects else world.arm(source)


def _copied(value: object) -> object:
    """Return a copy that later changes of the original do not reach."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, Mapping):
        return {k: _copied(v) for k, v in cast(Mapping[Any, object], value).items()}
    if isinstance(value, list):
        return [_copied(v) for v in cast(list[object], value)]
    return value
