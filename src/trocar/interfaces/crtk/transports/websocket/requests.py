"""What a client of the rosbridge protocol (version 2.1) may ask: text in, frozen records out.

Source: https://github.com/RobotWebTools/rosbridge_suite/blob/ros1/ROSBRIDGE_PROTOCOL.md
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeGuard, get_args

from trocar.errors import InputError

Compression = Literal["none", "cbor"]
Level = Literal["error", "warning", "info", "none"]
Id = str | None

LONGEST_NAME = 256
"""Characters of a name of a topic, service or request. Source: our own choice."""

A_NAME = f"up to {LONGEST_NAME} printable characters"

LONGEST_THROTTLE_MS = 3_600_000.0
"""Longest time between two messages of a throttled topic: an hour. Source: our own choice."""


class RequestError(InputError):
    """A client asked for what cannot be read; `id` is the request's own, if it had one."""

    def __init__(self, text: str, id: Id = None) -> None:  # noqa: A002  the protocol's word
        super().__init__(text)
        self.id = id


@dataclass(frozen=True)
class Advertise:
    """Announce messages on a topic."""

    id: Id
    topic: str
    type: str


@dataclass(frozen=True)
class Unadvertise:
    """Announce that no more messages will come on a topic."""

    id: Id
    topic: str


@dataclass(frozen=True)
class Publish:
    """Bring one message on a topic; what is in it is not checked yet."""

    id: Id
    topic: str
    msg: Mapping[str, Any]


@dataclass(frozen=True)
class Subscribe:
    """Ask for a topic's messages.

    Args:
        throttle_s: shortest time between two messages [s]
        compression: how messages are packed; what is not known here is sent as "none"
    """

    id: Id
    topic: str
    type: str | None = None
    throttle_s: float = 0.0
    compression: Compression = "none"


@dataclass(frozen=True)
class Unsubscribe:
    """Ask for no more messages: of the subscription with this id, or of all to the topic."""

    id: Id
    topic: str


@dataclass(frozen=True)
class CallService:
    """Call a service; arguments come by name, or as a list in the order of its fields."""

    id: Id
    service: str
    args: Mapping[str, Any] | list[Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SetLevel:
    """Say from which level on the client wants status messages."""

    id: Id
    level: Level


@dataclass(frozen=True)
class Nothing:
    """A request that needs no answer: the client is let in by its token already."""

    id: Id


Request = (
    Advertise | Unadvertise | Publish | Subscribe | Unsubscribe | CallService | SetLevel | Nothing
)


def read_request(text: str | bytes) -> Request:
    """Read one message of a client.

    Raises:
        RequestError: what is wrong with it, in words for the client's author
    """
    if not isinstance(text, str):
        raise RequestError("binary messages are not understood: send JSON as text")
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"no JSON: {error}") from error
    if not isinstance(document, dict):
        raise RequestError(f"got {reprlib.repr(document)}; allowed: an object with an 'op'")
    id = document.get("id")  # noqa: A001  the protocol's word
    if id is not None and not _is_name(id):
        raise RequestError(f"id: got {reprlib.repr(id)}; allowed: {A_NAME}")
    op = document.get("op")
    reader = READERS.get(op) if isinstance(op, str) else None
    if reader is None:
        raise RequestError(f"op: got {reprlib.repr(op)}; allowed: {', '.join(READERS)}", id)
    return reader(_Fields(document, id))


def _is_name(value: object) -> TypeGuard[str]:
    """Whether a value is short text; halves of characters are none, though JSON has them."""
    return isinstance(value, str) and len(value) <= LONGEST_NAME and value.isprintable()


class _Fields:
    """The fields of one request, each read with its check."""

    def __init__(self, document: dict[str, Any], id: Id) -> None:  # noqa: A002
        self._document, self.id = document, id

    def name(self, key: str) -> str:
        value = self._document.get(key)
        if value and _is_name(value):
            return value
        raise self._wrong(key, A_NAME)

    def name_or_none(self, key: str) -> str | None:
        return None if self._document.get(key) is None else self.name(key)

    def mapping(self, key: str) -> dict[str, Any]:
        value = self._document.get(key)
        if isinstance(value, dict):
            return value
        raise self._wrong(key, "an object")

    def arguments(self, key: str) -> dict[str, Any] | list[Any]:
        value = self._document.get(key)
        if value is None:
            return {}
        if isinstance(value, dict | list):
            return value
        raise self._wrong(key, "an object or a list")

    def milliseconds(self, key: str) -> float:
        value = self._document.get(key)
        if value is None:
            return 0.0
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if is_number and 0 <= value <= LONGEST_THROTTLE_MS:
            return float(value)
        raise self._wrong(key, f"0 to {LONGEST_THROTTLE_MS:.0f} ms")

    def compression(self) -> Compression:
        return "cbor" if self._document.get("compression") == "cbor" else "none"

    def level(self) -> Level:
        value = self._document.get("level")
        if isinstance(value, str) and value in get_args(Level):
            return value  # pyright: ignore[reportReturnType]  one of them
        raise self._wrong("level", ", ".join(get_args(Level)))

    def _wrong(self, key: str, allowed: str) -> RequestError:
        got = reprlib.repr(self._document[key]) if key in self._document else "nothing"
        return RequestError(
            f"{self._document['op']}: {key}: got {got}; allowed: {allowed}", self.id
        )


def _refused(why: str) -> Callable[[_Fields], Request]:
    def refuse(fields: _Fields) -> Request:
        raise RequestError(why, fields.id)

    return refuse


_NO_SERVERS = "clients cannot offer services or actions here: only trocar's own can be called"
_NO_FRAGMENTS = "fragments are not understood: send the message in one piece"

READERS: Mapping[str, Callable[[_Fields], Request]] = {
    "advertise": lambda f: Advertise(f.id, f.name("topic"), f.name("type")),
    "unadvertise": lambda f: Unadvertise(f.id, f.name("topic")),
    "publish": lambda f: Publish(f.id, f.name("topic"), f.mapping("msg")),
    "subscribe": lambda f: Subscribe(
        f.id,
        f.name("topic"),
        f.name_or_none("type"),
        1e-3 * f.milliseconds("throttle_rate"),
        f.compression(),
    ),
    "unsubscribe": lambda f: Unsubscribe(f.id, f.name("topic")),
    "call_service": lambda f: CallService(f.id, f.name("service"), f.arguments("args")),
    "set_level": lambda f: SetLevel(f.id, f.level()),
    "status": lambda f: Nothing(f.id),
    "auth": lambda f: Nothing(f.id),
    "fragment": _refused(_NO_FRAGMENTS),
    "advertise_service": _refused(_NO_SERVERS),
    "unadvertise_service": _refused(_NO_SERVERS),
    "service_response": _refused(_NO_SERVERS),
    "advertise_action": _refused(_NO_SERVERS),
    "send_action_goal": _refused("there are no actions here: use topics and services"),
    "cancel_action_goal": _refused("there are no actions here: use topics and services"),
}
"""What each `op` is read by."""
