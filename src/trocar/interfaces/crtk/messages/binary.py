"""Messages as bytes: ROS 1's serialisation, and CDR as ROS 2 sends it (XCDR1, little endian)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from trocar.interfaces.crtk.messages.catalogue import MessageType, message_type
from trocar.interfaces.crtk.messages.checking import Message, check
from trocar.interfaces.crtk.messages.errors import MessageError, shown
from trocar.interfaces.crtk.messages.reading import write_decoder
from trocar.interfaces.crtk.messages.wire import CDR, ROS1, Wire
from trocar.interfaces.crtk.messages.writing import write_encoder

# What wrong values and wrong bytes make Python raise in the written lines.
WRONG = (
    struct.error,
    KeyError,
    TypeError,
    ValueError,  # UnicodeError and WireError too
    AttributeError,
    OverflowError,
    IndexError,
)
Key = str | MessageType

_ros1_encoders: dict[Key, Callable[[Message], bytes]] = {}
_ros1_decoders: dict[Key, Callable[[bytes], Message]] = {}
_cdr_encoders: dict[Key, Callable[[Message], bytes]] = {}
_cdr_decoders: dict[Key, Callable[[bytes], Message]] = {}


def ros1_encode(kind: Key, message: Message) -> bytes:
    """Write a message as ROS 1 does, without the length that goes before it on a socket.

    Raises:
        MessageError: the message is none of the type
    """
    encode = _ros1_encoders.get(kind) or _made(_ros1_encoders, kind, _encoder, ROS1)
    return encode(message)


def ros1_decode(kind: Key, data: bytes | bytearray | memoryview) -> Message:
    """Read a message that ROS 1 wrote; every byte must belong to it.

    Raises:
        MessageError: the bytes are none of the type
    """
    decode = _ros1_decoders.get(kind) or _made(_ros1_decoders, kind, _decoder, ROS1)
    return decode(data if isinstance(data, bytes) else bytes(data))


def cdr_encode(kind: Key, message: Message) -> bytes:
    """Write a message as ROS 2 does: four bytes that say how, then CDR, not rounded up.

    Raises:
        MessageError: the message is none of the type
    """
    encode = _cdr_encoders.get(kind) or _made(_cdr_encoders, kind, _encoder, CDR)
    return encode(message)


def cdr_decode(kind: Key, data: bytes | bytearray | memoryview) -> Message:
    """Read a message that ROS 2 wrote; up to three bytes that round it up may follow.

    Raises:
        MessageError: the bytes are none of the type
    """
    decode = _cdr_decoders.get(kind) or _made(_cdr_decoders, kind, _decoder, CDR)
    return decode(data if isinstance(data, bytes) else bytes(data))


def _made(codecs: dict[Key, Any], kind: Key, make: Callable[..., Any], wire: Wire) -> Any:
    known = message_type(kind)
    codec = codecs.get(known) or make(known, wire)
    codecs[known] = codecs[known.name] = codecs[known.ros2_name] = codec
    return codec


def _encoder(kind: MessageType, wire: Wire) -> Callable[[Message], bytes]:
    run, script = write_encoder(kind, wire)
    label = f"encoder of {kind.name}"

    def encode(message: Message) -> bytes:
        try:
            return run(message)
        except WRONG as error:
            check(kind, message)
            path = script.path_at(error, label)
            raise MessageError(kind.name, path, f"cannot be written: {error}") from None

    return encode


def _decoder(kind: MessageType, wire: Wire) -> Callable[[bytes], Message]:
    run, script = write_decoder(kind, wire)
    label = f"decoder of {kind.name}"

    def decode(data: bytes) -> Message:
        if not data.startswith(wire.prefix[:2]):
            allowed = f"{wire.prefix[:2].hex(' ')} (CDR, little endian)"
            raise MessageError(kind.name, "", f"begins with {shown_bytes(data)}, not {allowed}")
        try:
            return run(data)
        except WRONG as error:
            problem = f"{shown(data)} that are no such message: {error}"
            raise MessageError(kind.name, script.path_at(error, label), problem) from None

    return decode


def shown_bytes(data: bytes) -> str:
    """The first bytes, for people."""
    return data[:4].hex(" ") or "nothing"
