"""What is published: bytes written once, then handed to each subscriber without waiting.

rospy writes to its subscribers one after the other and waits for each; one that has stopped
reading would stop all. Here a subscriber that does not take its bytes has them kept for it, a few
messages at most; older ones are then dropped, and it alone is late.
"""

from __future__ import annotations

import socket
import struct
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from trocar.interfaces.crtk.messages import message_type, ros1_encode
from trocar.interfaces.crtk.transports.ros1.classes import message_class

if TYPE_CHECKING:
    from trocar.interfaces.crtk.topics import Topic
    from trocar.interfaces.crtk.transports.ros1.library import Library

NO_WAIT = getattr(socket, "MSG_DONTWAIT", 0)


class Arrears:
    """What one subscriber has not taken yet: the rest of a message, and whole ones behind it."""

    def __init__(self, rest: memoryview, depth: int) -> None:
        self._rest = rest
        self._whole: deque[bytes] = deque(maxlen=depth)

    def add(self, packet: bytes) -> bool:
        """Keep a message; return False when the oldest had to go for it."""
        full = len(self._whole) == self._whole.maxlen
        self._whole.append(packet)
        return not full

    def pay(self, write: Callable[[memoryview], int]) -> bool:
        """Write what can be written; return whether nothing is left."""
        while True:
            self._rest = self._rest[write(self._rest) :]
            if self._rest:
                return False
            if not self._whole:
                return True
            self._rest = memoryview(self._whole.popleft())


class Outlet:
    """A topic that is published."""

    def __init__(self, library: Library, topic: Topic) -> None:
        self.topic = topic
        self._kind = message_type(topic.type)
        self._class = message_class(library, self._kind)
        #: What subscribers have not taken yet, by connection.
        self._arrears: dict[Any, Arrears] = {}
        publisher = library.rospy.Publisher(
            f"/{topic.name}", self._class, latch=topic.latched, queue_size=1
        )
        self._impl = publisher.impl
        self._impl.set_queue_size(None)  # no thread for each subscriber

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes."""
        return bool(self._impl.connections)

    @property
    def late(self) -> bool:
        """Whether a subscriber has not taken all of its bytes."""
        return bool(self._arrears)

    def descriptors(self) -> list[int]:
        """Return the file descriptors of subscribers that are late."""
        found = [connection.fileno() for connection in self._arrears]
        return [descriptor for descriptor in found if descriptor is not None and descriptor >= 0]

    def send(self, message: dict[str, Any] | bytes) -> int:
        """Hand a message, or its bytes, to every subscriber; return how many were dropped."""
        if not self._impl.connections and not self.topic.latched:
            return 0
        data = message if isinstance(message, bytes) else ros1_encode(self._kind, message)
        packet = struct.pack("<I", len(data)) + data
        if not self.topic.latched:
            return sum(self._offer(c, packet) for c in self._impl.connections)
        with self._impl.publock:  # held while a newcomer is handed the message of before
            self._impl.latch = self._class(data)
            return sum(self._offer(c, packet) for c in self._impl.connections)

    def catch_up(self) -> None:
        """Write to those who are behind what they can take now."""
        for connection, arrears in list(self._arrears.items()):
            if connection.done or arrears.pay(lambda rest, c=connection: self._write(c, rest)):
                self._arrears.pop(connection, None)

    def _offer(self, connection: Any, packet: bytes) -> int:
        """Write a message to a subscriber; return how many were dropped."""
        arrears = self._arrears.get(connection)
        if arrears is not None:
            if not connection.done:
                return 0 if arrears.add(packet) else 1
            del self._arrears[connection]
            return 0
        whole = memoryview(packet)
        written = self._write(connection, whole)
        if written < len(packet):
            self._arrears[connection] = Arrears(whole[written:], max(self.topic.depth, 1))
        else:
            connection.stat_num_msg += 1
        return 0

    def _write(self, connection: Any, data: memoryview) -> int:
        """Write what fits now; a connection that is broken takes everything, and is closed."""
        try:
            written = connection.socket.send(data, NO_WAIT)
        except BlockingIOError:
            return 0
        except (OSError, AttributeError):  # vanished; rospy has forgotten its socket
            with suppress(Exception):
                connection.close()
            return len(data)
        connection.stat_bytes += written
        return written
