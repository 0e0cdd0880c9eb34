"""What is done about each request of a client."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any

from trocar.errors import InputError, TrocarError
from trocar.interfaces.crtk.messages import (
    MessageError,
    MessageType,
    from_json,
    service_type,
    to_json,
)
from trocar.interfaces.crtk.topics import Direction, Service, Topic
from trocar.interfaces.crtk.transports.websocket import rosapi
from trocar.interfaces.crtk.transports.websocket.client import MOST_SUBSCRIPTIONS, Client
from trocar.interfaces.crtk.transports.websocket.names import plain, same_type
from trocar.interfaces.crtk.transports.websocket.parcel import Parcel
from trocar.interfaces.crtk.transports.websocket.replies import answer, failure
from trocar.interfaces.crtk.transports.websocket.requests import (
    Advertise,
    CallService,
    Publish,
    Request,
    RequestError,
    SetLevel,
    Subscribe,
    Unsubscribe,
    read_request,
)

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core

MOST_CALLS = 16
"""Services that a client may wait for at a time. Source: our own choice."""

PATIENCE_S = 10.0
"""How long a service may take [s]. Source: our own choice."""


class Conversation:
    """Talk with clients for the core; in the server's own thread.

    Args:
        core: who takes messages and answers services
        workers: the threads in which services are waited for
    """

    def __init__(self, core: Core, workers: Executor) -> None:
        self._core, self._workers = core, workers
        self._catalogue = rosapi.Catalogue(
            {name: topic for name, topic in core.topics.items() if not topic.later},
            core.services,
            core.stamper.now,
        )
        self._calls: set[asyncio.Task[None]] = set()

    def hear(self, client: Client, text: str | bytes) -> None:
        """Do what a message of a client asks for, or tell it why not."""
        try:
            self._act(client, read_request(text))
        except RequestError as error:
            client.tell("error", str(error), error.id)

    def overhear(self, client: Client, text: str | bytes) -> None:
        """Note that a message came beyond the client's rate and is not done."""
        words = f"{client.peer} sends too fast: {client.refused} messages were not read"
        if not client.tell_now_and_then("flood", words):
            return
        try:
            request = read_request(text)
        except RequestError:
            return
        topic = (
            self._core.topics.get(plain(request.topic)) if isinstance(request, Publish) else None
        )
        if topic is not None:
            self._core.refuse(topic, topic.name, words, client.peer)

    def _act(self, client: Client, request: Request) -> None:
        match request:
            case Publish():
                self._publish(client, request)
            case Subscribe():
                self._subscribe(client, request)
            case Unsubscribe():
                client.unsubscribe(plain(request.topic), request.id)
            case CallService():
                self._call(client, request)
            case Advertise():
                self._topic(request, "sub", request.type)
            case SetLevel():
                client.level = request.level
            case _:
                pass

    def _publish(self, client: Client, request: Publish) -> None:
        topic = self._topic(request, "sub")
        try:
            message = from_json(topic.type, request.msg)
        except MessageError as error:
            self._core.refuse(topic, topic.name, str(error), client.peer)
            raise RequestError(f"publish: {request.topic}: {error}", request.id) from error
        self._core.receive(topic.name, message, client.peer)

    def _subscribe(self, client: Client, request: Subscribe) -> None:
        topic = self._topic(request, "pub", request.type)
        if not client.subscribe(topic.name, request):
            problem = f"subscribe: {MOST_SUBSCRIPTIONS} topics are as many as a client may want"
            raise RequestError(problem, request.id)
        last = self._core.latched(topic.name)
        if last is not None:
            client.send(Parcel(topic, last).frame(request.topic))

    def _topic(
        self,
        request: Publish | Subscribe | Advertise,
        direction: Direction,
        kind: str | None = None,
    ) -> Topic:
        """Find the topic that a request is about, of this direction and type."""
        topic = self._core.topics.get(plain(request.topic))
        verb = type(request).__name__.lower()
        if topic is None or topic.later:
            problem = (
                "is not there yet" if topic else "there is no such topic; /rosapi/topics tells all"
            )
            raise RequestError(f"{verb}: {request.topic}: {problem}", request.id)
        if topic.direction != direction:
            problem = "trocar listens to it" if direction == "pub" else "trocar itself publishes it"
            raise RequestError(f"{verb}: {request.topic}: {problem}", request.id)
        if kind is not None and not same_type(kind, topic.type):
            problem = f"got the type {kind}; it has {topic.type}"
            raise RequestError(f"{verb}: {request.topic}: {problem}", request.id)
        return topic

    def _call(self, client: Client, request: CallService) -> None:
        name = plain(request.service)
        service = self._core.services.get(name)
        try:
            if service is None:
                values = rosapi.ask(name, request.args, self._catalogue)
                client.send(answer(request.service, request.id, values))
            elif client.calls >= MOST_CALLS:
                raise InputError(f"{MOST_CALLS} calls wait for an answer already")
            else:
                self._begin(client, request, service)
        except InputError as error:
            client.send(failure(request.service, request.id, str(error)))

    def _begin(self, client: Client, request: CallService, service: Service) -> None:
        """Let a worker wait for a service's answer."""
        kind = service_type(service.type)
        arguments = from_json(kind.request, _named(kind.request, request.args))
        client.calls += 1
        task = asyncio.create_task(self._wait(client, request, service, arguments))
        self._calls.add(task)
        task.add_done_callback(self._calls.discard)

    async def _wait(
        self, client: Client, request: CallService, service: Service, arguments: dict[str, Any]
    ) -> None:
        loop = asyncio.get_running_loop()
        try:
            values = await loop.run_in_executor(
                self._workers, self._core.call, service.name, arguments, PATIENCE_S
            )
            reply = to_json(service_type(service.type).response, values)
            client.send(answer(request.service, request.id, reply))
        except TrocarError as error:
            client.send(failure(request.service, request.id, str(error)))
        finally:
            client.calls -= 1


def _named(kind: MessageType, args: Mapping[str, Any] | list[Any]) -> Mapping[str, Any]:
    """Return a service's arguments by name."""
    if isinstance(args, Mapping):
        return args
    names = [field.name for field in kind.fields if not field.only_ros1]
    if len(args) > len(names):
        raise InputError(f"got {len(args)} arguments; allowed: {', '.join(names) or 'none'}")
    return dict(zip(names, args, strict=False))
