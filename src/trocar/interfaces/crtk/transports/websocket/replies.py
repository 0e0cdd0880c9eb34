"""What the server says in the rosbridge protocol: facts in, bytes for the wire out.

A server's frames are not masked and nothing is compressed, so one message is encoded once and the
same bytes go to everybody who wants it.
"""

from __future__ import annotations

import json as standard_json
import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from msgspec import json

from trocar.interfaces.crtk.transports.websocket.requests import Id, Level

# The first byte of a frame that is whole. Source: RFC 6455, section 5.2.
TEXT, BINARY = 0x81, 0x82


def _plain(value: Any) -> Any:
    """Return an array's numbers, or numpy's number as Python's."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


_encoder = json.Encoder(enc_hook=_plain)


def frame(payload: bytes, kind: int = TEXT) -> bytes:
    """Wrap UTF-8 text (or bytes) for the wire. Source: RFC 6455, section 5.2."""
    size = len(payload)
    if size < 126:
        return struct.pack("!BB", kind, size) + payload
    if size < 1 << 16:
        return struct.pack("!BBH", kind, 126, size) + payload
    return struct.pack("!BBQ", kind, 127, size) + payload


def as_json(document: object) -> bytes:
    """Write a document; what is no number becomes null."""
    try:
        return _encoder.encode(document)
    except UnicodeEncodeError:  # half a character, as JSON may bring: only escaped can it leave
        return standard_json.dumps(document).encode()


def publication(topic: str, message: bytes) -> bytes:
    """Return the frame of one message on a topic.

    Args:
        topic: the name as the subscriber spelled it
        message: the message, in JSON
    """
    return frame(b"%b%b}" % (_heading(topic), message))


@lru_cache(maxsize=4096)
def _heading(topic: str) -> bytes:
    return b'{"op":"publish","topic":%b,"msg":' % json.encode(topic)


def answer(service: str, id: Id, values: Mapping[str, Any]) -> bytes:  # noqa: A002
    """Return the frame of a service's answer."""
    return _response(service, id, values, result=True)


def failure(service: str, id: Id, reason: str) -> bytes:  # noqa: A002
    """Return the frame that says why a service did not answer."""
    return _response(service, id, reason, result=False)


def status(level: Level, text: str, id: Id = None) -> bytes:  # noqa: A002
    """Return the frame of a remark about the conversation itself."""
    named = {} if id is None else {"id": id}
    return frame(as_json({"op": "status", "level": level, "msg": text, **named}))


def _response(service: str, id: Id, values: object, *, result: bool) -> bytes:  # noqa: A002
    named = {} if id is None else {"id": id}
    document = {"op": "service_response", "service": service, **named, "values": values}
    return frame(as_json({**document, "result": result}))
