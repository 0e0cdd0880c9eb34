"""Commands to a world and events in it, as entries for listeners.

Every public call that changes anything is one command, so that a list of them, each repeated before
the same physics step, is the same motion again.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, ParamSpec, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")
#: Source of commands and events that concern no single arm or object.
WORLD = "world"
#: Commands and numbers in them that `Past` keeps at most. Source: our own choice.
MOST_COMMANDS = 4096
MOST_NUMBERS = 30_000


@dataclass(frozen=True, eq=False)
class Entry:
    """One command or event.

    Attributes:
        period: physics steps since the last reset; a command comes before that one is stepped
        time: simulation time [s]
        kind: "command" or "event"
        source: an arm's or an object's name, or "world"
        name: a verb ("servo_jp", "jaw.move_jp", "reset") or an event ("operating_state",
            "goal_reached", "warning", "error", "status")
        values: the verb's arguments by name, or those of the event; copies
    """

    period: int
    time: float
    kind: Literal["command", "event"]
    source: str
    name: str
    values: Mapping[str, Any]


Listener = Callable[[Entry], None]
#: Values that need no copy.
PLAIN = (float, int, str, bool, type(None))


class Journal:
    """Hands entries to listeners, and keeps the commands that led to the present state while few.

    Attributes:
        period, time: where the world is; the world keeps them up to date
        listeners: called with every entry
        revision: counts commands and events; nothing but motion changes between two
        streamed: how many of them were streamed set-points (`JointControl.stream`), which change
            nothing else
        inside: how many commands are under way; those that a command gives itself make no entry
        past: commands that lead here, from which a recording that begins later is repeated
    """

    def __init__(self) -> None:
        self.period, self.time = 0, 0.0
        self.listeners: list[Listener] = []
        self.revision = self.streamed = 0
        self.inside = 0
        self.past = Past()

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` with every entry from now on; call what is returned to stop."""
        self.listeners.append(listener)

        def stop() -> None:
            if listener in self.listeners:
                self.listeners.remove(listener)

        return stop

    def event(self, source: str, name: str, **values: object) -> None:
        """Enter an event."""
        self.revision += 1
        if self.listeners:
            self._send("event", source, name, {k: _copied(v) for k, v in values.items()})

    def command(self, source: str, name: str, values: dict[str, object]) -> None:
        """Enter a command, and keep it."""
        for key, value in values.items():
            kind = type(value)
            if kind is np.ndarray:
                values[key] = value.copy()  # type: ignore[attr-defined]
            elif kind not in PLAIN:
                values[key] = _copied(value)
        if not self.past.incomplete:
            self.past.keep(self.period, self.time, source, name, values)
        if self.listeners:
            self._send("command", source, name, values)

    def _send(
        self,
        kind: Literal["command", "event"],
        source: str,
        name: str,
        values: Mapping[str, object],
    ) -> None:
        entry = Entry(self.period, self.time, kind, source, name, values)
        for listener in tuple(self.listeners):
            listener(entry)


class Past:
    """The commands that lead from a new world to the present state, kept while they are few.

    Attributes:
        incomplete: why commands are missing; "" while all are kept
        rows: period, time, source, name and values of each, or streamed set-points of an arm in
            place of the last two: positions, velocities and the number of its own joints
        commands, numbers: how many are kept, and the numbers in them
    """

    def __init__(self) -> None:
        self.incomplete = ""
        self.rows: list[
            tuple[int, float, str, str, Mapping[str, object]]
            | tuple[int, float, str, list[float], list[float], int]
        ] = []
        self.commands = self.numbers = 0

    @property
    def entries(self) -> list[Entry]:
        """The commands, oldest first."""
        found: list[Entry] = []
        for kept in self.rows:
            if len(kept) == 5:
                period, time, source, name, values = kept
                found.append(Entry(period, time, "command", source, name, values))
                continue
            period, time, source, q, v, own = kept
            for name, part in (("servo_jp", slice(own)), ("jaw.servo_jp", slice(own, None))):
                if len(q[part]):
                    values = {"q": np.array(q[part]), "v": np.array(v[part])}
                    found.append(Entry(period, time, "command", source, name, values))
        return found

    def keep(
        self, period: int, time: float, source: str, name: str, values: Mapping[str, object]
    ) -> None:
        """Keep a command; its values belong to this from now on."""
        self.rows.append((period, time, source, name, values))
        for value in values.values():
            self.numbers += value.size if isinstance(value, np.ndarray) else _numbers(value)
        self.commands += 1
        if self.commands > MOST_COMMANDS or self.numbers > MOST_NUMBERS:
            self.forget_many()

    def forget_many(self) -> None:
        """Keep no more: they became too many."""
        self.forget(
            f"it began after more than {MOST_COMMANDS} commands or {MOST_NUMBERS} numbers in"
            " them; begin it earlier"
        )

    def forget(self, why: str) -> None:
        """Keep no commands until the next `restart`, for this reason."""
        self.incomplete = why
        self.rows.clear()

    def restart(self, commands: Iterable[tuple[str, str, Mapping[str, object]]]) -> None:
        """Keep these commands instead of all before, since they lead here by themselves.

        Args:
            commands: source, name and values of each; a new world takes them before its first step
        """
        self.incomplete = ""
        self.rows.clear()
        self.commands = self.numbers = 0
        for source, name, values in commands:
            if not self.incomplete:
                self.keep(0, 0.0, source, name, values)


def _numbers(value: object) -> int:
    """Return the count of numbers that are kept for a value."""
    if isinstance(value, PLAIN):
        return 1
    if isinstance(value, np.ndarray):
        return value.size
    if isinstance(value, Mapping):
        return sum(map(_numbers, cast(Mapping[object, object], value).values()))
    if isinstance(value, list | tuple):
        return sum(map(_numbers, cast(list[object], value)))
    return 1


class Commanded(Protocol):
    """Something with verbs: a world, an arm, a jaw.

    One that entries name may have `_verbs`, {name in entries: path of the method from it}, of
    methods that its parts have.
    """

    #: Receives its commands; its arm's name or "world"; what comes before its verbs.
    _journal: Journal
    _source: str
    _prefix: str


def command(verb: Callable[P, R]) -> Callable[P, R]:
    """Mark a method of something `Commanded` as a verb whose calls are entries of the journal."""
    return command_as(verb.__name__)(verb)


def command_as(name: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Mark a method as a verb, as `command` does, whose entries have a name of their own."""

    def mark(verb: Callable[P, R]) -> Callable[P, R]:
        parameters = list(inspect.signature(verb).parameters.values())[1:]
        names = [p.name for p in parameters if p.kind is p.POSITIONAL_OR_KEYWORD]

        @functools.wraps(verb)
        def journaled(*args: P.args, **kwargs: P.kwargs) -> R:
            owner: Any = args[0]  # something Commanded; this runs with every servo command
            journal: Journal = owner._journal
            if not journal.inside and (journal.listeners or not journal.past.incomplete):
                given = dict(zip(names, args[1:]))  # noqa: B905  too many: below
                # a call that Python rejects makes no entry: what is left of it might be accepted
                if len(args) <= 1 + len(names) and given.keys().isdisjoint(kwargs):
                    journal.command(owner._source, owner._prefix + name, given | kwargs)
            journal.inside += 1
            try:
                return verb(*args, **kwargs)
            finally:
                journal.inside -= 1
                journal.revision += 1

        journaled.is_command = True  # type: ignore[attr-defined]
        return journaled

    return mark


def apply_command(world: object, entry: Entry) -> None:
    """Repeat a command.

    Raises:
        InputError: neither a world nor an arm has this command
        TrocarError: as the verb raises
    """
    verb_of(_commanded(cast(Any, world), entry.source), entry.source, entry.name)(**entry.values)


def verb_of(owner: object, source: str, name: str) -> Callable[..., Any]:
    """Find the method that a verb calls, which a part of its owner may have.

    Args:
        owner: something `Commanded`
        source: its name
        name: of the verb, as entries have it

    Raises:
        InputError: no such verb
    """
    verbs: Mapping[str, str] = getattr(owner, "_verbs", {})
    *parts, verb = verbs.get(name, name).split(".")
    target: Any = owner
    for part in parts:
        target = None if part.startswith("_") else _member(target, part)
    method = _member(target, verb)
    if not getattr(method, "is_command", False):
        raise InputError(f"{source}: got the command {name!r}, which it does not have")
    return cast(Callable[..., Any], method)


def _member(owner: object, name: str) -> Any:
    """Return an attribute, None if it is missing; do not search for names that moved."""
    known = name in getattr(owner, "__dict__", ()) or hasattr(type(owner), name)
    return getattr(owner, name) if known else None


def _commanded(world: Any, source: str) -> Any:
    """Return the target of a command: the world, a part, an object or an arm."""
    if source == WORLD:
        return world
    if source in world.tissues:
        return world.tissues[source]
    if source in world.parts:
        return world.parts[source]
    return world.object(source) if source in world.objects else world.arm(source)


def _copied(value: object) -> object:
    """Return a copy that later changes of the original do not reach."""
    if isinstance(value, PLAIN):
        return value
    if isinstance(value, np.ndarray):
        return cast("NDArray[Any]", value).copy()
    if isinstance(value, Mapping):
        return {k: _copied(v) for k, v in cast(Mapping[Any, object], value).items()}
    if isinstance(value, list):
        return [_copied(v) for v in cast(list[object], value)]
    return value
