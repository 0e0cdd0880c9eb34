"""A live view in Foxglove, and files for it, by Foxglove's own SDK (extra `foxglove`).

The core's published topics are channels: ROS 2's messages in CDR, with their definitions.

core's publishing thread --send--> CDR --> SDK --bounded queue, oldest lost--> each client
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any

from trocar.errors import InputError, MissingExtraError
from trocar.live.access import PageAccess
from trocar.messages import cdr_encode, message_type
from trocar.messages.types import SECOND

if TYPE_CHECKING:
    from trocar.ros.core import Batch, Core
    from trocar.ros.topic import Message, Topic

ORDER = 40
OPTIONS = """
--foxglove                    serve a live view for Foxglove (extra foxglove)
--foxglove-port N:int = 8765  Foxglove port (default: 8765, 0 = any free port)
--foxglove-record FILE        serve Foxglove and write all topics to a new MCAP file
"""

#: Default port of Foxglove. Source: its SDK's default.
PORT = 8765
#: The SDK lets every page of the web connect, so only this machine may. Source: tried.
HOST = "127.0.0.1"
#: Messages that wait for one client; the SDK drops the oldest beyond. Source: the SDK's default.
BACKLOG = 1024
#: Longest time to shut down [s]: the SDK waits for clients that do not read. Source: our choice.
FAREWELL_S = 1.0
#: Written on request only: it takes seconds to make.
DESCRIPTION = "robot_description"
IMAGE = "sensor_msgs/Image"


def open_transport(options: Mapping[str, Any], pages: PageAccess) -> FoxgloveTransport | None:  # noqa: ARG001
    """Return the transport for --foxglove or --foxglove-record.

    Raises:
        MissingExtraError: the extra `foxglove` is not installed
        InputError: no such port
    """
    port, record = options["foxglove_port"], options["foxglove_record"]
    if not options["foxglove"] and record is None:
        return None
    return FoxgloveTransport(port, record, images=options["record_images"])


class Subscriptions:
    """Keep which client subscribes to what; called by the SDK's threads.

    Attributes:
        wanted: the names of the topics with subscribers, without a leading slash
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._subscriptions: set[tuple[int, str]] = set()
        self._new: set[str] = set()
        self.wanted: frozenset[str] = frozenset()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Note one more."""
        name = channel.topic.removeprefix("/")
        with self._lock:
            self._subscriptions.add((client.id, name))
            self.wanted |= {name}
            self._new.add(name)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Forget one, also where a client has gone."""
        with self._lock:
            self._subscriptions.discard((client.id, channel.topic.removeprefix("/")))
            self.wanted = frozenset(name for _, name in self._subscriptions)

    def newly(self) -> set[str]:
        """Return the topics with new subscribers since the last call."""
        with self._lock:
            new, self._new = self._new, set()
        return new


def load() -> ModuleType:
    """Import the SDK.

    Raises:
        MissingExtraError: the extra `foxglove` is not installed
    """
    try:
        import foxglove
        import foxglove.websocket  # pyright: ignore[reportUnusedImport]  an attribute of foxglove
    except ImportError:
        raise MissingExtraError("foxglove-sdk", "foxglove", "Foxglove") from None
    return foxglove


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

    def __init__(
        self, port: int = PORT, record: str | None = None, *, images: bool = False
    ) -> None:
        if not 0 <= port <= 65535:
            raise InputError(f"got port {port}; allowed: 1 to 65535, or 0 for any free port")
        self._sdk = load()
        self.port, self._record, self._images = port, record, images
        self._subscriptions = Subscriptions()
        self._channels: dict[str, Any] = {}
        self._always: frozenset[str] = frozenset()
        self._simulated = False
        self._context: Any = None
        self._server: Any = None
        self._writer: Any = None

    @property
    def greeting(self) -> str:
        """The line that is printed at the start."""
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
        """Disconnect clients, close the port and end the file."""
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
                server_listener=self._subscriptions,
                context=context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            raise InputError(
                f"Foxglove: cannot listen on {HOST} port {self.port}: {error}; choose "
                "another --foxglove-port, or 0 for any free port"
            ) from error
        self.port = self._server.port

    def _open(self, context: Any) -> None:
        if self._record is None:
            return
        try:
            self._writer = self._sdk.open_mcap(self._record, context=context)
        except (OSError, RuntimeError) as error:
            raise InputError(
                f"--foxglove-record {self._record}: {error}; allowed: a new file in an existing "
                "exists"
            ) from error
        topics = [self._core.topics[name] for name in self._channels]
        self._always = frozenset(
            topic.name
            for topic in topics
            if topic.rate != "camera" or (self._images and topic.type != IMAGE)
        ) - {DESCRIPTION}

    def _end_file(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    # ------------------------------------------------------------------ out

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that have subscribers, or that are written.

        Who came since the last period gets what is latched; every other subscriber gets it again.
        """
        for name in self._subscriptions.newly():
            message = self._core.latched(name)
            if message is not None:
                self._log(self._core.topics[name], message)
        wanted = self._subscriptions.wanted | self._always
        return wanted | {"clock"} if wanted and self._simulated else wanted

    def send(self, batch: Batch) -> None:
        """Hand messages to the SDK, which never waits."""
        wanted = self._subscriptions.wanted | self._always
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
