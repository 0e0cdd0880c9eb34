"""What comes in: messages to subscribed topics, and calls of services.

rospy reads as many bytes as a message claims to have before anybody looks at it, and greets one
newcomer after the other. Here a message has a largest size, and who connects and says nothing
keeps nobody waiting.
"""

from __future__ import annotations

import logging
import socket
import struct
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from trocar.errors import TrocarError
from trocar.interfaces.crtk.messages import (
    MessageError,
    message_type,
    ros1_decode,
    ros1_encode,
    service_type,
)
from trocar.interfaces.crtk.sorter import Sorter
from trocar.interfaces.crtk.transports.ros1.classes import message_class, service_class
from trocar.interfaces.crtk.transports.ros1.library import inner

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.topics import Service, Topic
    from trocar.interfaces.crtk.transports.ros1.library import Library

_log = logging.getLogger("trocar")

LARGEST = 1_000_000
"""Largest message that is read [bytes]. Source: our own choice; a JointState has a few hundred."""

LARGEST_HEADER = 65_536
"""Largest greeting [bytes]. Source: our own choice; it holds a message's definition."""

GREETING_S = 5.0
"""How long a newcomer may take to greet [s]. Source: our own choice."""

GREETINGS = 64
"""How many may be greeted at a time. Source: our own choice."""

ANSWER_S = 5.0
"""How long a service may take [s]. Source: our own choice; one takes milliseconds."""


def subscribe(library: Library, core: Core, topic: Topic, sorter: Sorter) -> Any:
    """Hand what is published to a topic to the core: set-points at once, the rest in order."""
    kind = message_type(topic.type)

    def take(message: Any) -> None:
        peer = str(getattr(message, "_connection_header", {}).get("callerid", ""))
        try:
            fields = ros1_decode(kind, message.data)
        except MessageError as error:
            core.refuse(topic, topic.name, str(error), peer)
            return
        stamp = fields["header"]["stamp"] if "header" in fields else None
        sorter.take(core, topic, fields, peer, stamp)

    subscriber = library.rospy.Subscriber(
        f"/{topic.name}",
        message_class(library, kind),
        queue_size=1 if topic.depth == 1 else None,
        tcp_nodelay=True,
    )
    _bound_topic(library, subscriber.impl, lambda why: core.refuse(topic, topic.name, why))
    subscriber.impl.add_callback(take, None)
    return subscriber


def serve(library: Library, core: Core, service: Service) -> Any:
    """Answer calls of a service."""
    kind = service_type(service.type)
    made = service_class(library, kind, service.type)

    def answer(request: Any) -> Any:
        try:
            asked = ros1_decode(kind.request, request.data)
            found = core.call(service.name, asked, ANSWER_S)
            return made._response_class(ros1_encode(kind.response, found))
        except (TrocarError, TimeoutError) as error:
            raise library.rospy.ServiceException(str(error)) from error

    served = library.rospy.Service(f"/{service.name}", made, answer)
    served.protocol.read_messages = _bounded(
        library, served.protocol, lambda why: _log.warning("refused: %s: %s", service.name, why)
    )
    return served


def _bound_topic(library: Library, impl: Any, refused: Callable[[str], None]) -> None:
    """Bound the messages of every publisher that will connect to a topic."""
    add = impl.add_connection

    def add_connection(connection: Any) -> Any:
        protocol = connection.protocol
        protocol.read_messages = _bounded(library, protocol, refused)
        return add(connection)

    impl.add_connection = add_connection


def _bounded(
    library: Library, protocol: Any, refused: Callable[[str], None]
) -> Callable[[Any, list[Any], Any], None]:
    """Return a reader that hangs up on messages that claim to be larger than `LARGEST`."""
    read = protocol.read_messages

    def read_messages(buffer: Any, queue: list[Any], sock: Any) -> None:
        (size,) = struct.unpack("<I", bytes(buffer.getbuffer()[:4]))
        if size > LARGEST:
            refused(f"got a message of {size} bytes; allowed: up to {LARGEST}")
            raise inner(library, "exceptions").TransportTerminated("message too large")
        read(buffer, queue, sock)

    return read_messages


def greet_in_threads(library: Library) -> None:
    """Let newcomers greet side by side, within a time and a size."""
    server = inner(library, "impl.tcpros_base")._tcpros_server
    server.start_server()
    places = threading.BoundedSemaphore(GREETINGS)

    def greet(sock: socket.socket, address: Any) -> None:
        if not places.acquire(blocking=False):
            sock.close()
            return

        def talk() -> None:
            try:
                if _polite(sock):
                    server._tcp_server_callback(sock, address)
                else:
                    sock.close()
            finally:
                places.release()

        threading.Thread(target=talk, name="trocar-ros1-greeting", daemon=True).start()

    server.tcp_ros_server.inbound_handler = greet


def _polite(sock: socket.socket) -> bool:
    """Tell whether a newcomer says within the time how long its greeting is, and means it."""
    sock.settimeout(GREETING_S)
    try:
        head = sock.recv(4, socket.MSG_PEEK | socket.MSG_WAITALL)
    except OSError:
        return False
    return len(head) == 4 and struct.unpack("<I", head)[0] <= LARGEST_HEADER
