"""One message on its way to many: encoded when the first client wants it, then handed on."""

from __future__ import annotations

from trocar.interfaces.crtk.messages import to_json
from trocar.interfaces.crtk.topics import Topic
from trocar.interfaces.crtk.transport import Message
from trocar.interfaces.crtk.transports.websocket.replies import as_json, publication


class Parcel:
    """A message of a topic, with the bytes that were made of it so far."""

    def __init__(self, topic: Topic, message: Message) -> None:
        self.topic = topic
        self._message = message
        self._json: bytes | None = None
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
            if self._json is None:
                self._json = as_json(to_json(self.topic.type, self._message, arrays=True))
            found = self._frames[name] = publication(name, self._json)
        return found
