"""What is served beside the arms by somebody who knows the core, but whom the core need not know.

An app makes a `Component` and gives it to the core: rows of topics, what their messages do, and
how those that are told every period are made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from trocar.interfaces.crtk.fields import Message
from trocar.interfaces.crtk.publishing import Figure
from trocar.interfaces.crtk.topics import Topic

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core

#: Does what a message asks for, in a thread of a transport; raises InputError where it cannot.
Handler = Callable[[Topic, Message], None]


@dataclass(frozen=True)
class Component:
    """Rows beside those of arms, and who stands behind them.

    Attributes:
        topics: by name; rows of the same name that come `later` are then there
        handlers: {topic that is listened to: what a message does}
        hears: {topic: who learns of its messages, beside what they do anyhow}
        makers: {topic that is told every period: how to make its message}
        begin: called when the core begins; returns what ends it
    """

    topics: Mapping[str, Topic]
    handlers: Mapping[str, Handler]
    begin: Callable[[Core], Callable[[], None]]
    hears: Mapping[str, Handler] = field(default_factory=dict[str, Handler])
    makers: Mapping[str, Figure] = field(default_factory=dict[str, Figure])


@dataclass(frozen=True)
class Merged:
    """The rows of several components, and how their messages are made; by name."""

    topics: Mapping[str, Topic]
    makers: Mapping[str, Figure]


def merged(components: Sequence[Component]) -> Merged:
    """Return what components bring beside the rig's own rows."""
    return Merged(
        {name: row for part in components for name, row in part.topics.items()},
        {name: make for part in components for name, make in part.makers.items()},
    )


def served(topics: Sequence[Topic]) -> dict[str, Topic]:
    """Return topics by name, none of them for later."""
    return {topic.name: replace(topic, later=False) for topic in topics}


def install(components: Sequence[Component], handlers: dict[str, Handler]) -> None:
    """Let components take messages; those that they only hear are done first."""
    for component in components:
        handlers.update(component.handlers)
        for name, hear in component.hears.items():
            handlers[name] = _both(handlers[name], hear) if name in handlers else hear


def _both(first: Handler, then: Handler) -> Handler:
    def act(topic: Topic, message: Message) -> None:
        first(topic, message)
        then(topic, message)

    return act
