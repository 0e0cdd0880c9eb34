"""One message on its way to many: encoded when the first client wants it, then handed on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.interfaces.crtk.messages import to_json
from trocar.interfaces.crtk.messages.forms import Packing
from trocar.interfaces.crtk.topics import Topic
from trocar.interfaces.crtk.transport import Message
from trocar.interfaces.crtk.transports.websocket.replies import as_json, publication


def encode(kind: str, message: Message) -> bytes:
    """Write a message.

    Raises:
        MessageError: the message does not fit its type
    """
    return as_json(to_json(kind, message, arrays=True))


def _stamp(seconds: int, rest: int) -> bytes:
    return as_json({"secs": seconds, "nsecs": rest, "sec": seconds, "nanosec": rest})


def _source(stamp: tuple[int, int], table: NDArray[np.float64]) -> list[bytes]:
    return [_stamp(*stamp), *as_json(table.tolist())[1:-1].split(b",")]


PACKING = Packing(encode, _stamp, as_json, _source, lambda a, b: [*range(1 + a, 1 + b)])


class Parcel:
    """A message of a topic, with the bytes that were made of it so far."""

    def __init__(self, topic: Topic, message: Message | bytes) -> None:
        self.topic = topic
        self._message = message
        self._frames: dict[str, bytes] = {}

    @property
    def replaceable(self) -> bool:
        """Whether a newer message of the topic makes this one worthless."""
        return self.topic.rate != "event"

    def frame(self, name: str) -> bytes:
        """Return the bytes for clients that spell the topic like this.

        Raises:
            MessageError: the message does not fit its type
        """
        found = self._frames.get(name)
        if found is None:
            if not isinstance(self._message, bytes):
                self._message = encode(self.topic.type, self._message)
            found = self._frames[name] = publication(name, self._message)
        return found
