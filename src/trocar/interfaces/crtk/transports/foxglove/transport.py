"""The core's published rows as channels of Foxglove: ROS 2's messages in CDR, with their texts.

core's publishing thread --send--> CDR --> SDK --bounded queue, oldest lost--> each client
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from trocar.errors import InputError
from trocar.interfaces.crtk.messages import cdr_encode, message_type
from trocar.interfaces.crtk.transports.foxglove import library
from trocar.interfaces.crtk.transports.foxglove.listener import Listener

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.topics import Topic
    from trocar.interfaces.crtk.transport import Batch, Message

#: Where Foxglove looks by itself. Source: its SDK's default.
PORT = 8765
#: The SDK lets every page of the web connect, so nobody beyond this machine may. Source: tried.
HOST = "127.0.0.1"
#: Messages that wait for one client; the SDK drops the oldest beyond. Source: the SDK's default.
BACKLOG = 1024
#: How long ending may take [s]: the SDK waits for clients that do not read. Source: our own choice.
FAREWELL_S = 1.0
#: Written when somebody asks for it only: it takes seconds to make.
DESCRIPTION = "robot_description"
IMAGE = "sensor_msgs/Image"
SECOND = 1_000_000_000


class FoxgloveTransport:
    """Serve the Foxglove WebSocket protocol on this machine, for viewing only.

    Args:
        port: port to listen on; 0 takes any free one
        record: MCAP file to write all topics but images to; none is written over
        images: whether compressed images are written, too

    Attributes:
        port: the one that is listened on, once started

    Raises:
        MissingExtraError: the extra `foxglove` is not installed
        InputError: no such port
    """

    name = "foxglove"
    packing = None

    def __init__(
        self, port: int = PORT, record: str | None = None, *, images: bool = False
    ) -> None:
        if not 0 <= port <= 65535:
            raise InputError(f"port {port} does not exist; allowed: 0 (any free one) to 65535")
        self._sdk = library.load()
        self.port, self._record, self._images = port, record, images
        self._listener = Listener()
        self._channels: dict[str, Any] = {}
        self._always: frozenset[str] = frozenset()
        self._simulated = False
        self._context: Any = None
        self._server: Any = None
        self._writer: Any = None

    @property
    def greeting(self) -> str:
        """What is printed when time flows."""
        written = f", written to {self._record}" if self._record is not None else ""
        return f"ws://{HOST}:{self.port}  (Foxglove, view only{written})"

    # ------------------------------------------------------------------ life

    def start(self, core: Core) -> None:
        """Listen, with a channel for every topic that the simulator publishes.

        Raises:
            InputError: the port is taken or forbidden, or the file cannot be written
        """
        self._core = core
        self._context = context = self._sdk.Context()  # the server alone does not keep it
        self._simulated = core.stamper.mode == "sim"
        served = [t for t in core.topics.values() if t.direction == "pub" and not t.later]
        self._channels = {topic.name: self._channel(topic, context) for topic in served}
        self._open(context)
        try:
            self._serve(context)
        except InputError:
            self._end_file()
            raise

    def close(self) -> None:
        """Let go of clients and the port, and end the file."""
        if self._server is not None:
            stop = threading.Thread(target=self._server.stop, name="trocar-foxglove", daemon=True)
            stop.start()
            stop.join(FAREWELL_S)
            self._server = None
        self._end_file()
        for channel in self._channels.values():
            channel.close()
        self._channels, self._context = {}, None

    def _channel(self, topic: Topic, context: Any) -> Any:
        kind = message_type(topic.type)
        schema = self._sdk.Schema(
            name=kind.ros2_name, encoding="ros2msg", data=kind.text_ros2.encode()
        )
        return self._sdk.Channel(
            f"/{topic.name}", message_encoding="cdr", schema=schema, context=context
        )

    def _serve(self, context: Any) -> None:
        capability = self._sdk.websocket.Capability
        try:
            self._server = self._sdk.start_server(
                name="trocar",
                host=HOST,
                port=self.port,
                capabilities=[capability.Time] if self._simulated else [],
                server_listener=self._listener,
                context=context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            raise InputError(
                f"Foxglove's server cannot listen on {HOST} port {self.port}: {error}: choose "
                "another (--foxglove-port, 0 for any free one)"
            ) from error
        self.port = self._server.port

    def _open(self, context: Any) -> None:
        if self._record is None:
            return
        try:
            self._writer = self._sdk.open_mcap(self._record, context=context)
        except (OSError, RuntimeError) as error:
            raise InputError(
                f"--foxglove-record {self._record}: {error}; allowed: a new file in a folder that "
                "exists"
            ) from error
        self._always = frozenset(n for n in self._channels if self._written(n)) - {DESCRIPTION}

    def _written(self, name: str) -> bool:
        """Tell whether a topic is written unasked: images only packed, and on request."""
        topic = self._core.topics[name]
        return topic.rate != "camera" or (self._images and topic.type != IMAGE)

    def _end_file(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    # ------------------------------------------------------------------ out

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that somebody listens to, or that are written.

        Who came since the last period gets what is latched; every other listener gets it again.
        """
        for name in self._listener.newly():
            message = self._core.latched(name)
            if message is not None:
                self._log(self._core.topics[name], message)
        wanted = self._listener.wanted | self._always
        return wanted | {"clock"} if wanted and self._simulated else wanted

    def send(self, batch: Batch) -> None:
        """Hand messages to the SDK, which never waits."""
        wanted = self._listener.wanted | self._always
        for topic, message in batch:
            if topic.name in wanted:
                self._log(topic, message)
            if topic.name == "clock" and self._simulated and self._server is not None:
                self._server.broadcast_time(_nanoseconds(message["clock"]))

    def _log(self, topic: Topic, message: Message) -> None:
        header = message.get("header")
        stamp = self._core.stamper.now() if header is None else header["stamp"]
        self._channels[topic.name].log(
            cdr_encode(topic.type, message), log_time=_nanoseconds(stamp)
        )


def _nanoseconds(stamp: tuple[int, int]) -> int:
    seconds, nanoseconds = stamp
    return seconds * SECOND + nanoseconds
