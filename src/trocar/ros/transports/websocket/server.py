"""Serve the rosbridge protocol in a thread of its own.

core's publishing thread --send--> server's thread: encoded once --> every subscriber
client --> server's thread --> core.receive; services: core.call in a few worker threads

asyncio turns Nagle's algorithm off on every TCP connection, so what is written leaves at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, cast

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response
from websockets.protocol import State

from trocar.errors import InputError, TrocarError
from trocar.live.access import PageAccess, is_loopback, local_host, names_loopback
from trocar.live.connections import Connection, Connections
from trocar.live.pace import LOG_PERIOD_S
from trocar.messages import MessageError, MessageType, from_json, service_type, to_json
from trocar.ros.topic import Direction, Service, Topic
from trocar.ros.transports.websocket import protocol
from trocar.ros.transports.websocket.protocol import (
    LEVELS,
    Advertise,
    AnyRequest,
    CallService,
    Id,
    Level,
    Publish,
    RequestError,
    Rosapi,
    SetLevel,
    Subscribe,
    Unsubscribe,
    as_json,
    plain,
    read_request,
    same_type,
)
from trocar.simulation.rate_limit import RateLimit, suffix

if TYPE_CHECKING:
    from trocar.ros.core import Batch, Core
    from trocar.ros.topic import Message

_log = logging.getLogger("trocar")

#: Default port of rosbridge clients.
PORT = 9090

# Of all clients. Source: our own choice.
#: Patience for opening and closing handshakes. [s]
OPEN_S, CLOSE_S = 5.0, 1.0
#: Period of the check of what clients have not read yet. [s]
TEND_S = 0.01
#: Threads that wait for services, and the longest time of a service call [s].
WORKERS, SERVICE_S = 4, 10.0
#: Longest time to shut down. [s]
FAREWELL_S = 5.0

# Of one client. Source: our own choice.
#: Events and answers that wait for a slow client. [bytes]
MOST_WAITING = 4_000_000
#: Topics of a client, and subscriptions to a topic: three times those of the full cart.
MOST_SUBSCRIPTIONS = 1024
#: Messages a second and in a burst, five arms driven at 1 kHz; one counts for each 1600 bytes.
MESSAGES_PER_S, BYTES_OF_ONE = 5000.0, 1600
#: Pause after so many messages beyond the rate, so that a flood costs little. [s]
PAUSE_S, PAUSE_EVERY = 0.001, 16
#: Services that a client may wait for at a time.
MOST_CALLS = 16
#: Shortest time between two warnings of one kind. [s]
WARN_EVERY_S = 1.0


# ---------------------------------------------------------------------- who may connect


@dataclass(frozen=True)
class Access:
    """Decide which clients may connect.

    Args:
        host: address that is listened on
        pages: which pages and programs may connect

    Raises:
        InputError: the host can be reached from elsewhere and there is no token
    """

    host: str = "127.0.0.1"
    pages: PageAccess = field(default_factory=PageAccess)

    def __post_init__(self) -> None:
        if self.pages.token is None and not is_loopback(self.host):
            raise InputError(
                f"--host {self.host}: other machines could move the arms; set a "
                "--token (or TROCAR_TOKEN), or leave out --host and "
                "forward the port with ssh"
            )

    def objection(self, path: str, headers: Mapping[str, str]) -> tuple[HTTPStatus, str] | None:
        """Check a request to connect; return the reason of a rejection, or None.

        Beyond the loopback address any name may lead here, and the token is required.

        Args:
            path: requested, with its query
            headers: of the request
        """
        if is_loopback(self.host) and not names_loopback(headers.get("Host", "")):
            return HTTPStatus.FORBIDDEN, "Host: allowed: localhost or a loopback address\n"
        return self.pages.objection(path, headers, self.pages.viewer)


# ---------------------------------------------------------------------- rates


class Bucket:
    """Allow a rate in the long run, and as much at once after a rest.

    Args:
        rate: amount a second, and of a burst
    """

    def __init__(self, rate: float) -> None:
        self._rate = self._left = rate
        self._then = 0.0

    def take(self, amount: float, now: float) -> bool:
        """Take an amount at a moment [s] if it is allowed; return whether it was."""
        self._left = min(self._rate, self._left + self._rate * (now - self._then))
        self._then = now
        allowed = amount <= self._left
        if allowed:
            self._left -= amount
        return allowed


class Throttle:
    """Let a topic's messages pass no more often than each `period_s` [s]; 0: all of them."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self._due = 0.0

    def passes(self, now: float) -> bool:
        """Whether a message may go at a moment [s]; if so, the next one has to wait."""
        if now < self._due:
            return False
        late = now - self._due
        self._due = self._due + self.period_s if late < self.period_s else now + self.period_s
        return True


class Outbox:
    """Keep events and answers for a slow client in order; beyond a size the oldest go.

    Args:
        capacity: size beyond which the oldest go, and are counted in `lost` [bytes]
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._waiting: deque[bytes] = deque()
        self._size = self.lost = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, frame: bytes) -> None:
        """Let an event or an answer wait."""
        self._waiting.append(frame)
        self._size += len(frame)
        while self._size > self._capacity:
            self.take()
            self.lost += 1

    def take(self) -> bytes:
        """Take the oldest."""
        frame = self._waiting.popleft()
        self._size -= len(frame)
        return frame


# ---------------------------------------------------------------------- messages


def encode(kind: str, message: Message) -> bytes:
    """Write a message as JSON.

    Raises:
        MessageError: the message does not fit its type
    """
    return as_json(to_json(kind, message, arrays=True))


class EncodedMessage:
    """A message of a topic, encoded when its first subscriber requests it.

    Attributes:
        replaceable: whether a newer message of the topic makes this one worthless
        number: of its batch
    """

    def __init__(self, topic: Topic, message: Message | bytes) -> None:
        self.topic, self.replaceable = topic, topic.rate != "event"
        self.number = 0
        self._message = message
        self._frames: dict[str, bytes] = {}

    def named(self, name: str) -> bytes:
        """Return the bytes for clients that spell the topic like this.

        Raises:
            MessageError: the message does not fit its type
        """
        found = self._frames.get(name)
        if found is None:
            if not isinstance(self._message, bytes):
                self._message = encode(self.topic.type, self._message)
            found = self._frames[name] = protocol.publication(name, self._message)
        return found


# ---------------------------------------------------------------------- clients


@dataclass
class ClientSubscription:
    """All requests of a client for one topic; the one with the highest rate counts.

    Args:
        name: the topic as the client spells it
        periods: shortest time between two messages of each request [s]
    """

    name: str
    periods: dict[Id, float] = field(default_factory=dict[Id, float])
    throttle: Throttle = field(default_factory=lambda: Throttle(0.0))
    held: EncodedMessage | None = None

    def settle(self) -> None:
        """Take over the shortest period."""
        period = min(self.periods.values())
        if self.throttle.period_s != period:
            self.throttle = Throttle(period)


class Client:
    """One connection, touched in the server's own thread only.

    States wait for no client: one that reads on gets the newest.

    Args:
        connection: to the client
        newest: the newest state of each topic; it belongs to the server

    Attributes:
        connection: as given
        subscriptions: by the topic's name without a slash
        refused: messages beyond the rate
    """

    def __init__(self, connection: Connection, newest: Mapping[str, EncodedMessage]) -> None:
        self.connection, self._newest = connection, newest
        self.peer = "{}:{}".format(*connection.remote_address[:2])
        self.subscriptions: dict[str, ClientSubscription] = {}
        self.outbox = Outbox(MOST_WAITING)
        self.calls = self.refused = 0
        self.level: Level = "warning"
        self._rate = Bucket(MESSAGES_PER_S)
        self._warned: dict[str, float] = {}
        self._missed: int | None = None
        self._periods = 0

    def may_send(self, size: int) -> bool:
        """Whether a message of so many bytes is within the client's rate; count it if not."""
        allowed = self._rate.take(max(1.0, size / BYTES_OF_ONE), time.monotonic())
        self.refused += not allowed
        return allowed

    def subscribe(self, topic: str, request: Subscribe) -> bool:
        """Note a subscription; return False when there are too many."""
        if topic not in self.subscriptions and len(self.subscriptions) >= MOST_SUBSCRIPTIONS:
            return False
        found = self.subscriptions.setdefault(topic, ClientSubscription(request.topic))
        if len(found.periods) >= MOST_SUBSCRIPTIONS and request.id not in found.periods:
            return False
        found.name = request.topic
        found.periods[request.id] = 1e-3 * (request.throttle_rate or 0.0)
        found.settle()
        return True

    def unsubscribe(self, topic: str, id: Id) -> None:  # noqa: A002  the protocol's word
        """End one subscription, or all to the topic when no id is given."""
        found = self.subscriptions.get(topic)
        if found is None:
            return
        found.periods.pop(id, None)
        if id is None or not found.periods:
            del self.subscriptions[topic]
        else:
            found.settle()

    def deliver(
        self, frames: Sequence[EncodedMessage], events: Sequence[EncodedMessage], now: float
    ) -> None:
        """Send the subscribed messages of a batch, in one write; to a slow client events alone."""
        if not self._ready:
            self._missed = frames[0].number if self._missed is None else self._missed
            frames = events
        due: list[tuple[EncodedMessage, str]] = []
        for frame in frames:
            found = self.subscriptions.get(frame.topic.name)
            if found is None:
                continue
            if found.throttle.passes(now):
                found.held = None
                due.append((frame, found.name))
            else:
                found.held = frame
        if due:
            self.send(b"".join([frame.named(name) for frame, name in due]))

    def send(self, data: bytes) -> None:
        """Send messages, or let them wait their turn."""
        if self._ready:
            self.connection.transport.write(data)
        else:
            self.outbox.put(data)

    def report(self, level: Level, text: str, id: Id = None) -> None:  # noqa: A002
        """Send a status message, if the client's level includes it."""
        if LEVELS.index(level) <= LEVELS.index(self.level):
            self.send(protocol.status(level, text, id))

    def warn(self, kind: str, text: str) -> bool:
        """Send a warning unless one of its kind was sent a moment ago; return whether it was."""
        now = time.monotonic()
        if now < self._warned.get(kind, 0.0) + WARN_EVERY_S:
            return False
        self._warned[kind] = now
        self.report("warning", text)
        return True

    def tend(self, now: float) -> None:
        """Send what waited long enough, and report what a slow client has missed."""
        while self.outbox and self._reads:
            self.connection.transport.write(self.outbox.take())
        if self.outbox or not self._reads:
            return
        if self._missed is not None:
            since, self._missed = self._missed, None
            found = [self._newest[name] for name in self.subscriptions if name in self._newest]
            if missed := [frame for frame in found if frame.number >= since]:
                self._periods += max(frame.number for frame in missed) - since
                self.deliver(missed, [], now)
        for held in [s for s in self.subscriptions.values() if s.held]:
            if held.held and held.throttle.passes(now):
                frame, held.held = held.held, None
                self.send(frame.named(held.name))
        if self._periods or self.outbox.lost:
            what = f"the states of {self._periods} periods and {self.outbox.lost} other messages"
            if self.warn("slow", f"client reads too slowly: {what} dropped"):
                self._periods = self.outbox.lost = 0

    @property
    def _reads(self) -> bool:
        return self.connection.state is State.OPEN and not self.connection.paused

    @property
    def _ready(self) -> bool:
        return self._reads and not self.outbox and self._missed is None


# ---------------------------------------------------------------------- requests


class Conversation:
    """Carry out the requests of clients; in the server's own thread.

    Args:
        core: takes messages and answers services
        workers: the threads in which services are waited for
        changed: called after a client's subscriptions have changed
    """

    def __init__(
        self, core: Core, workers: Executor, changed: Callable[[], None] = lambda: None
    ) -> None:
        self._core, self._workers, self._changed = core, workers, changed
        served = {name: topic for name, topic in core.topics.items() if not topic.later}
        self._rosapi = Rosapi(served, core.services, core.stamper.now)
        self._calls: set[asyncio.Task[None]] = set()

    def handle(self, client: Client, text: str | bytes) -> None:
        """Carry out a message of a client, or report why not."""
        try:
            self._act(client, read_request(text))
        except RequestError as error:
            client.report("error", str(error), error.id)
        except TrocarError as error:
            _log.error("websocket: %s", error)

    def reject(self, client: Client, text: str | bytes) -> None:
        """Report now and then that messages beyond the client's rate are left out."""
        words = f"{client.peer} sends too fast: {client.refused} messages dropped"
        if client.warn("flood", words):
            with contextlib.suppress(RequestError):
                request = read_request(text)
                topic = self._core.topics.get(plain(getattr(request, "topic", "")))
                if topic is not None and isinstance(request, Publish):
                    self._core.refuse(topic, topic.name, words, client.peer)

    def disconnected(self, client: Client) -> None:
        """Note that a client has left."""
        self._core.disconnected(client.peer)

    def _act(self, client: Client, request: AnyRequest) -> None:
        match request:
            case Publish():
                self._publish(client, request)
            case Subscribe():
                topic = self._topic(client, request, "pub", request.type)
                if not client.subscribe(topic.name, request):
                    problem = f"subscribe: {MOST_SUBSCRIPTIONS} topics are the most for a client"
                    raise RequestError(problem, request.id)
                self._changed()
                last = self._core.latched(topic.name)
                if last is not None:
                    client.send(EncodedMessage(topic, last).named(request.topic))
            case Unsubscribe():
                client.unsubscribe(plain(request.topic), request.id)
                self._changed()
            case CallService():
                self._call(client, request)
            case Advertise():
                self._topic(client, request, "sub", request.type)
            case SetLevel():
                client.level = request.level
            case _:
                pass

    def _publish(self, client: Client, request: Publish) -> None:
        topic = self._topic(client, request, "sub")
        try:
            message = from_json(topic.type, request.msg)
        except MessageError as error:
            self._core.refuse(topic, topic.name, str(error), client.peer)
            raise RequestError(f"publish: {request.topic}: {error}", request.id) from error
        self._core.receive(topic.name, message, client.peer)

    def _topic(
        self,
        client: Client,
        request: Publish | Subscribe | Advertise,
        direction: Direction,
        kind: str | None = None,
    ) -> Topic:
        """Return the topic that a request names, if it has this direction and type."""
        name = plain(request.topic)
        topic = self._core.topics.get(name)
        if topic is None:
            problem = "unknown topic; list all with /rosapi/topics"
            if direction == "sub" and (near := self._core.unread([name], client.peer)):
                problem = f"unknown topic (did you mean /{near}?); list all with /rosapi/topics"
        elif topic.later:
            problem = "is not there yet"
        elif topic.direction != direction:
            problem = "trocar listens to it" if direction == "pub" else "trocar itself publishes it"
        elif kind is not None and not same_type(kind, topic.type):
            problem = f"got the type {kind}; it has {topic.type}"
        else:
            return topic
        verb = type(request).__name__.lower()
        raise RequestError(f"{verb}: {request.topic}: {problem}", request.id)

    def _call(self, client: Client, request: CallService) -> None:
        name = plain(request.service)
        service, args = self._core.services.get(name), request.args or {}
        try:
            if service is None:
                values = self._rosapi.call(name, args)
                client.send(protocol.response(request.service, request.id, values, result=True))
                return
            if client.calls >= MOST_CALLS:
                raise InputError(f"{MOST_CALLS} calls are already pending")
            kind = service_type(service.type).request
            arguments = from_json(kind, _by_name(kind, args))
        except InputError as error:
            client.send(protocol.response(request.service, request.id, str(error), result=False))
            return
        client.calls += 1
        task = asyncio.create_task(self._answer(client, request, service, arguments))
        self._calls.add(task)
        task.add_done_callback(self._calls.discard)

    async def _answer(
        self, client: Client, request: CallService, service: Service, arguments: dict[str, Any]
    ) -> None:
        """Send a service's answer once a worker has it."""
        try:
            values = await asyncio.get_running_loop().run_in_executor(
                self._workers, self._core.call, service.name, arguments, SERVICE_S
            )
            told, result = to_json(service_type(service.type).response, values), True
        except TrocarError as error:
            told, result = str(error), False
        client.calls -= 1
        client.send(protocol.response(request.service, request.id, told, result=result))


def _by_name(kind: MessageType, args: Mapping[str, Any] | list[Any]) -> Mapping[str, Any]:
    """Return a service's arguments by name."""
    if isinstance(args, Mapping):
        return args
    names = [field.name for field in kind.fields if not field.only_ros1]
    if len(args) > len(names):
        raise InputError(f"got {len(args)} arguments; allowed: {', '.join(names) or 'none'}")
    return dict(zip(names, args, strict=False))


# ---------------------------------------------------------------------- server


class WebSocketTransport:
    """Serve the rosbridge protocol in a thread of its own.

    Args:
        host: address to listen on
        port: port to listen on; 0 takes any free one
        pages: which pages and programs may connect; when omitted, programs; beyond the loopback
            address it has a token

    Attributes:
        port: the one that is listened on, once started
        clients: who is connected; touched in the server's own thread only

    Raises:
        InputError: no token beyond the loopback address, or no such port
    """

    name = "websocket"

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = PORT,
        pages: PageAccess | None = None,
    ) -> None:
        if not 0 <= port <= 65535:
            raise InputError(f"got port {port}; allowed: 1 to 65535, or 0 for any free port")
        self._access = Access(host, pages or PageAccess())
        self.port = port
        self.clients: set[Client] = set()
        self._connections = Connections("websocket")
        self._newest: dict[str, EncodedMessage] = {}
        self._batches = 0
        self._rate_limit = RateLimit(LOG_PERIOD_S)
        self._wanted: frozenset[str] = frozenset()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._workers = ThreadPoolExecutor(WORKERS, "trocar-websocket-call")

    @property
    def address(self) -> str:
        """Address for clients, without the token."""
        host = self._access.host
        return f"ws://{f'[{host}]' if ':' in host else host}:{self.port}"

    @property
    def viewer_address(self) -> str:
        """The address with the secret that the web viewer shows."""
        host = local_host(self._access.host)
        where = f"ws://{f'[{host}]' if ':' in host else host}:{self.port}"
        return f"{where}/?{self._access.pages.query}"

    @property
    def greeting(self) -> str:
        """The line that is printed at the start."""
        return (
            f"{self.address}  (rosbridge{', with the token' if self._access.pages.token else ''})"
        )

    def start(self, core: Core) -> None:
        """Listen.

        Raises:
            InputError: the port is taken or forbidden, or the host is not this machine's
        """
        bound: Future[int] = Future()
        self._thread = threading.Thread(
            target=self._main, args=(core, bound), name="trocar-websocket", daemon=True
        )
        self._thread.start()
        try:
            self.port = bound.result()
        except OSError as error:
            why = str(error.strerror).rpartition(": ")[2]
            raise InputError(
                f"WebSocket: cannot listen on {self._access.host} port {self.port}: {why}; "
                "choose another --websocket-port, 0 for any free port, or "
                "--no-websocket"
            ) from error

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics with subscribers; from any thread."""
        return self._wanted

    def send(self, batch: Batch) -> None:
        """Let the server's thread send messages as soon as it can."""
        frames = [
            EncodedMessage(topic, message) for topic, message in batch if topic.name in self._wanted
        ]
        if frames:
            self._soon(self._deliver, frames)

    def close(self) -> None:
        """Close all connections and end."""
        if self._thread is not None:
            self._soon(lambda: self._stopping.set())
            self._thread.join(FAREWELL_S)
        self._workers.shutdown(wait=False, cancel_futures=True)

    def _soon(self, work: Any, *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the server may have ended in between
            if self._loop is not None:
                self._loop.call_soon_threadsafe(work, *arguments)

    # In the server's thread.

    def _main(self, core: Core, bound: Future[int]) -> None:
        try:
            asyncio.run(self._serve(core, bound))
        except Exception as error:  # noqa: BLE001  handed over whole to whoever waits for the port
            if bound.done():
                _log.exception("websocket: stopped")
            else:
                bound.set_exception(error)

    async def _serve(self, core: Core, bound: Future[int]) -> None:
        self._loop, self._stopping = asyncio.get_running_loop(), asyncio.Event()
        self._conversation = Conversation(core, self._workers, self._look)
        async with serve(
            self._listen,
            self._access.host,
            self.port,
            process_request=self._admit,
            open_timeout=OPEN_S,
            close_timeout=CLOSE_S,
            server_header="trocar",
            **self._connections.options,
            # keeps the library's remarks about strangers off the terminal
            logger=logging.Logger("trocar.websocket", logging.CRITICAL),
        ) as listening:
            bound.set_result(next(iter(listening.sockets)).getsockname()[1])
            tending = asyncio.create_task(self._tend())
            await self._stopping.wait()
            tending.cancel()

    def _admit(self, connection: ServerConnection, request: HttpRequest) -> Response | None:
        objection = self._access.objection(request.path, request.headers)
        if objection is not None:
            return connection.respond(*objection)
        return self._connections.admit(connection)

    async def _listen(self, connection: ServerConnection) -> None:
        client = Client(cast(Connection, connection), self._newest)
        self.clients.add(client)
        try:
            async for text in connection:
                if client.may_send(len(text)):
                    self._conversation.handle(client, text)
                else:
                    self._conversation.reject(client, text)
                    if client.refused % PAUSE_EVERY == 0:
                        await asyncio.sleep(PAUSE_S)
        except ConnectionClosed:
            pass
        finally:
            self.clients.discard(client)
            self._conversation.disconnected(client)
            self._look()

    def _look(self) -> None:
        """Note which topics have subscribers."""
        self._wanted = frozenset[str]().union(*(client.subscriptions for client in self.clients))

    def _deliver(self, frames: Sequence[EncodedMessage]) -> None:
        now = time.monotonic()
        self._batches += 1
        for frame in frames:
            frame.number = self._batches
            if frame.replaceable:
                self._newest[frame.topic.name] = frame
        events = [frame for frame in frames if not frame.replaceable]
        for client in self.clients:
            with self._logged():
                client.deliver(frames, events, now)

    async def _tend(self) -> None:
        while True:
            await asyncio.sleep(TEND_S)
            now = time.monotonic()
            for client in self.clients:
                with self._logged():
                    client.tend(now)

    @contextlib.contextmanager
    def _logged(self) -> Generator[None]:
        """Log a message that cannot be sent, and go on with the others."""
        try:
            yield
        except TrocarError as error:
            unsaid = self._rate_limit.due(str(error), time.monotonic())
            if unsaid is not None:
                _log.error("websocket: %s%s", error, suffix(unsaid))
