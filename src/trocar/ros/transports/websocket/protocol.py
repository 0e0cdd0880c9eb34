"""The rosbridge protocol (version 2.1) and rosapi: requests in, frames out, no sockets.

A server's frames are not masked and nothing is compressed, so a message is encoded once and the
same bytes go to every subscriber.

Source: https://github.com/RobotWebTools/rosbridge_suite/blob/ros1/ROSBRIDGE_PROTOCOL.md
"""

from __future__ import annotations

import json as standard_json
import re
import reprlib
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal, cast, get_args

import msgspec
import numpy as np
from msgspec import Meta, Struct, json

from trocar.errors import InputError
from trocar.messages import MessageType, message_type, service_type
from trocar.ros.topic import Direction, Service, Topic

Id = str | None
Level = Literal["none", "error", "warning", "info"]
#: Levels of status messages; each includes those before it.
LEVELS: tuple[Level, ...] = get_args(Level)
#: Longest name of a topic, service or request. Source: our own choice. [characters]
LONGEST_NAME = 256
#: No control characters, and no halves of characters, which JSON has.
PRINTABLE = r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]*$"
Name = Annotated[str, Meta(min_length=1, max_length=LONGEST_NAME, pattern=PRINTABLE)]
#: Longest period of a throttled topic: an hour. Source: our own choice. [ms]
Period = Annotated[float, Meta(ge=0.0, le=3_600_000.0)]

# ---------------------------------------------------------------------- requests


class RequestError(InputError):
    """A request that is not valid; `id` is its own, if it has one."""

    def __init__(self, text: str, id: Id = None) -> None:  # noqa: A002  the protocol's word
        super().__init__(text)
        self.id = id


class Request(Struct, tag_field="op", tag=str.lower, kw_only=True):
    """The fields of every request."""

    id: Annotated[str, Meta(max_length=LONGEST_NAME, pattern=PRINTABLE)] | None = None


class Advertise(Request):
    """Announce messages on a topic."""

    topic: Name
    type: Name


class Unadvertise(Request):
    """Announce that no more messages follow on a topic."""

    topic: Name


class Publish(Request):
    """Publish one message; its fields are checked against the topic's type later."""

    topic: Name
    msg: dict[str, Any]


class Subscribe(Request):
    """Request a topic's messages, at most one each `throttle_rate` milliseconds."""

    topic: Name
    type: Name | None = None
    throttle_rate: Period | None = None


class Unsubscribe(Request):
    """End the subscription with this id, or all to the topic without one."""

    topic: Name


class CallService(Request, tag="call_service"):
    """Call a service, with arguments by name or in the order of its fields."""

    service: Name
    args: dict[str, Any] | list[Any] | None = None


class SetLevel(Request, tag="set_level"):
    """Set the lowest level of status messages to send."""

    level: Level


class Status(Request):
    """A remark of the client, which needs no answer."""


class Auth(Request):
    """A login of rosauth, which needs no answer: tokens are checked on connection."""


AnyRequest = (
    Advertise
    | Unadvertise
    | Publish
    | Subscribe
    | Unsubscribe
    | CallService
    | SetLevel
    | Status
    | Auth
)
_NO_SERVERS = "services and actions offered by clients are not supported"
_NO_ACTIONS = "actions are not supported; use topics and services"
#: Operations of the protocol that are not supported, and why.
UNSUPPORTED: Mapping[str, str] = {
    "fragment": "fragments are not understood: send the message in one piece",
    "advertise_service": _NO_SERVERS,
    "unadvertise_service": _NO_SERVERS,
    "service_response": _NO_SERVERS,
    "advertise_action": _NO_SERVERS,
    "send_action_goal": _NO_ACTIONS,
    "cancel_action_goal": _NO_ACTIONS,
}
_A_NAME = f"up to {LONGEST_NAME} printable characters"
#: Values of the fields that may be wrong.
ALLOWED: Mapping[str, str] = {
    **dict.fromkeys(("id", "topic", "type", "service"), _A_NAME),
    "msg": "an object",
    "args": "an object or a list",
    "throttle_rate": "0 to 3600000 ms",
    "level": ", ".join(LEVELS),
}
OPERATIONS = tuple(str(kind.__struct_config__.tag) for kind in get_args(AnyRequest))
_decoder = json.Decoder(AnyRequest)


def read_request(text: str | bytes) -> AnyRequest:
    """Read one message of a client.

    Raises:
        RequestError: what is wrong with it, in words for the client's author
    """
    if not isinstance(text, str):
        raise RequestError("got a binary message; allowed: JSON text")
    try:
        return _decoder.decode(text)
    except (msgspec.DecodeError, UnicodeEncodeError, RecursionError):
        pass
    try:  # the standard library reads more: NaN, and halves of characters
        document = standard_json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"invalid JSON: {error}") from error
    try:
        return msgspec.convert(document, AnyRequest)
    except (msgspec.ValidationError, UnicodeEncodeError, RecursionError) as error:
        raise _rejected(document, error) from error


def _rejected(document: object, error: Exception) -> RequestError:
    """Return the error of a request that is JSON, with its id."""
    if not isinstance(document, dict):
        return RequestError(f"got {reprlib.repr(document)}; allowed: an object with an 'op'")
    fields: dict[str, object] = document  # pyright: ignore[reportUnknownVariableType]  checked below
    op, id = fields.get("op"), fields.get("id")  # noqa: A001
    id = id if isinstance(id, str) and len(id) <= LONGEST_NAME and id.isprintable() else None  # noqa: A001
    if isinstance(op, str) and op in UNSUPPORTED:
        return RequestError(UNSUPPORTED[op], id)
    if op not in OPERATIONS:
        known = ", ".join(OPERATIONS)
        return RequestError(f"op: got {reprlib.repr(op)}; allowed: {known}", id)
    key = next((key for key in ALLOWED if re.search(rf"\b{key}`", str(error))), "")
    if not key:
        return RequestError(f"{op}: {error}", id)
    got = reprlib.repr(fields[key]) if key in fields else "nothing"
    return RequestError(f"{op}: {key}: got {got}; allowed: {ALLOWED[key]}", id)


# ---------------------------------------------------------------------- frames

# The first byte of a frame that is whole. Source: RFC 6455, section 5.2.
TEXT = 0x81


def frame(payload: bytes) -> bytes:
    """Wrap UTF-8 text for the wire: websockets' own takes eight times as long.

    Source: RFC 6455, section 5.2.
    """
    size = len(payload)
    if size < 126:
        return struct.pack("!BB", TEXT, size) + payload
    if size < 1 << 16:
        return struct.pack("!BBH", TEXT, 126, size) + payload
    return struct.pack("!BBQ", TEXT, 127, size) + payload


def _plain(value: Any) -> Any:
    """Return an array's numbers, or numpy's number as Python's."""
    if isinstance(value, np.ndarray | np.generic):
        return cast(Any, value).tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


_encoder = json.Encoder(enc_hook=_plain)


def as_json(document: object) -> bytes:
    """Write a document; NaN and infinity become null."""
    try:
        return _encoder.encode(document)
    except UnicodeEncodeError:  # half a character, as JSON may bring: only escaped can it leave
        return standard_json.dumps(document).encode()


def publication(topic: str, message: bytes) -> bytes:
    """Return the frame of one message on a topic.

    Args:
        topic: the name as the subscriber spells it
        message: the message, in JSON
    """
    return frame(b"%b%b}" % (_heading(topic), message))


@lru_cache(maxsize=4096)
def _heading(topic: str) -> bytes:
    return b'{"op":"publish","topic":%b,"msg":' % json.encode(topic)


def response(service: str, id: Id, values: object, *, result: bool) -> bytes:  # noqa: A002
    """Return the frame of a service's answer, or with `result` False of the reason for none."""
    named = {} if id is None else {"id": id}
    document = {"op": "service_response", "service": service, **named, "values": values}
    return frame(as_json({**document, "result": result}))


def status(level: Level, text: str, id: Id = None) -> bytes:  # noqa: A002
    """Return the frame of a remark about the conversation itself."""
    named = {} if id is None else {"id": id}
    return frame(as_json({"op": "status", "level": level, "msg": text, **named}))


# ---------------------------------------------------------------------- names


def plain(name: str) -> str:
    """Return the name of a topic or service without its leading slash."""
    return name.removeprefix("/")


def same_type(requested: str, own: str) -> bool:
    """Whether two names of a type mean the same: "a/msg/B" is ROS 2's word for "a/B"."""
    return requested.replace("/msg/", "/", 1).replace("/srv/", "/", 1) == own


# ---------------------------------------------------------------------- rosapi

PREFIX = "rosapi/"
NODE = "/trocar"
Values = dict[str, Any]


@dataclass(frozen=True)
class Rosapi:
    """The services of rosbridge's rosapi node, which describe topics, services and types.

    Source: rosbridge_suite, rosapi_msgs (ROS 1 and 2 agree in the fields that stand here).

    Args:
        topics: by name without a leading slash, in the order of the table
        services: likewise
        now: returns the time of the newest stamp, (s, ns)
    """

    topics: Mapping[str, Topic]
    services: Mapping[str, Service]
    now: Callable[[], tuple[int, int]]

    def call(self, service: str, args: Mapping[str, Any] | list[Any]) -> Values:
        """Answer one of the services.

        Args:
            service: name without a leading slash, such as "rosapi/topics"
            args: by name, or in a list; each takes one at most

        Raises:
            InputError: there is no such service or type
        """
        found = ROSAPI.get(service.removeprefix(PREFIX))
        if found is None:
            known = ", ".join(PREFIX + name for name in ROSAPI)
            raise InputError(f"unknown service {service!r}; known in rosapi: {known}")
        key, reply = found
        value = args.get(key, "") if isinstance(args, Mapping) else next(iter(args), "")
        if not isinstance(value, str):
            raise InputError(f"{service}: {key}: got a {type(value).__name__}; allowed: a name")
        return reply(self, value)

    def list_topics(self) -> Values:
        """Return every topic with its type."""
        types = [topic.type for topic in self.topics.values()]
        return {"topics": [f"/{name}" for name in self.topics], "types": types}

    def list_services(self) -> list[str]:
        """Return every service, those of rosapi included."""
        return [f"/{name}" for name in (*self.services, *(PREFIX + name for name in ROSAPI))]

    def directed(self, direction: Direction) -> list[str]:
        """Return the topics of one direction."""
        return [f"/{name}" for name, t in self.topics.items() if t.direction == direction]

    def node_details(self, node: str) -> Values:
        """Return the topics and services of the one node."""
        own = plain(node) == plain(NODE)
        return {
            "subscribing": self.directed("sub") if own else [],
            "publishing": self.directed("pub") if own else [],
            "services": self.list_services() if own else [],
        }

    def nodes_of(self, name: str, direction: Direction) -> list[str]:
        """Return the nodes that publish or subscribe to a topic."""
        topic = self.topics.get(plain(name))
        return [NODE] if topic is not None and topic.direction == direction else []

    def time(self) -> Values:
        """Return the time of the newest stamp."""
        seconds, nanoseconds = self.now()
        return {"time": {"secs": seconds, "nsecs": nanoseconds}}


def _type_of(rows: Mapping[str, Topic] | Mapping[str, Service], name: str) -> Values:
    row = rows.get(plain(name))
    return {"type": "" if row is None else row.type}


def _of_type(rows: Mapping[str, Topic] | Mapping[str, Service], kind: str) -> list[str]:
    return [f"/{name}" for name, row in rows.items() if same_type(kind, row.type)]


def typedefs(kind: MessageType) -> Values:
    """Describe a type field by field, and every type inside it, each once."""
    found: dict[str, Values] = {}
    waiting = [kind]
    while waiting:
        one = waiting.pop(0)
        if one.name in found:
            continue
        fields = [field for field in one.fields if not field.only_ros1]
        found[one.name] = {
            "type": one.name,
            "fieldnames": [field.ros1_name for field in fields],
            "fieldtypes": [field.type for field in fields],
            "fieldarraylen": [-1 if field.length is None else field.length for field in fields],
            "examples": ["[]" if f.length is not None else _example(f.type) for f in fields],
            "constnames": [],
            "constvalues": [],
        }
        waiting += [message_type(field.type) for field in one.fields if field.is_message]
    return {"typedefs": list(found.values())}


def _example(kind: str) -> str:
    if "/" in kind or kind in ("time", "duration"):
        return "{}"
    return {"string": "", "bool": "False", "float32": "0.0", "float64": "0.0"}.get(kind, "0")


#: Service -> the name of its argument ("" for none), and its answer.
ROSAPI: Mapping[str, tuple[str, Callable[[Rosapi, str], Values]]] = {
    "topics": ("", lambda of, _: of.list_topics()),
    "topics_and_raw_types": (
        "",
        lambda of, _: {
            **of.list_topics(),
            "typedefs_full_text": [message_type(t.type).text_ros1 for t in of.topics.values()],
        },
    ),
    "topics_for_type": ("type", lambda of, kind: {"topics": _of_type(of.topics, kind)}),
    "topic_type": ("topic", lambda of, name: _type_of(of.topics, name)),
    "publishers": ("topic", lambda of, name: {"publishers": of.nodes_of(name, "pub")}),
    "subscribers": ("topic", lambda of, name: {"subscribers": of.nodes_of(name, "sub")}),
    "services": ("", lambda of, _: {"services": of.list_services()}),
    "services_for_type": ("type", lambda of, kind: {"services": _of_type(of.services, kind)}),
    "service_type": ("service", lambda of, name: _type_of(of.services, name)),
    "service_node": (
        "service",
        lambda of, name: {"node": NODE if plain(name) in of.services else ""},
    ),
    "nodes": ("", lambda _of, _name: {"nodes": [NODE]}),
    "node_details": ("node", lambda of, node: of.node_details(node)),
    "message_details": ("type", lambda _, kind: typedefs(message_type(kind))),
    "service_request_details": ("type", lambda _, kind: typedefs(service_type(kind).request)),
    "service_response_details": ("type", lambda _, kind: typedefs(service_type(kind).response)),
    "action_servers": ("", lambda _of, _name: {"action_servers": []}),
    "get_param_names": ("", lambda _of, _name: {"names": []}),
    "has_param": ("name", lambda _of, _name: {"exists": False}),
    "get_param": ("name", lambda _of, _name: {"value": "null"}),
    "get_time": ("", lambda of, _: of.time()),
}
