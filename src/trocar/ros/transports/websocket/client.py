"""A client of topics and services behind another program's rosbridge."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from itertools import count
from typing import Any, cast

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from trocar.errors import InputError, TrocarError
from trocar.messages import MessageError, blank, from_json, service_type, to_json
from trocar.ros.client import CALL_S, DEPTH, Graph, Take

_log = logging.getLogger("trocar")

#: Time between two attempts to connect again [s]. Source: our own choice.
RETRY_S = 1.0
#: Longest time to connect [s]. Source: our own choice.
CONNECT_S = 5.0
#: Largest message that is read [bytes]. Source: our own choice; a JointState has a few hundred.
LARGEST = 1_000_000


class WebSocketClient:
    """Subscribe, publish and call over rosbridge; connect again when the connection breaks.

    Args:
        url: such as ws://127.0.0.1:9090
        option: of the command line, for errors
    """

    def __init__(self, url: str, option: str = "--websocket") -> None:
        if not url.startswith(("ws://", "wss://")):
            raise InputError(f"{option}: got {url!r}; allowed: ws://HOST:PORT")
        self.name, self._option = url, option
        self._line: ClientConnection | None = None
        self._over = threading.Event()
        self._thread: threading.Thread | None = None
        self._subscriptions: dict[str, tuple[str, list[Take]]] = {}
        self._advertised: dict[str, str] = {}
        self._waiting: dict[str, Future[Mapping[str, Any]]] = {}
        self._ids = count(1)

    def start(self) -> None:
        """Connect.

        Raises:
            TrocarError: no answer
        """
        try:
            self._line = self._connect()
        except (OSError, WebSocketException) as error:
            why = str(error) or f"no answer within {CONNECT_S:g} s"
            raise TrocarError(f"{self._option}: no connection to {self.name}: {why}") from error
        self._thread = threading.Thread(target=self._run, name="trocar-listen", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Disconnect."""
        self._over.set()
        if self._line is not None:
            self._line.close()
        if self._thread is not None:
            self._thread.join(CONNECT_S)

    def now(self) -> float:
        """Return the time of arrivals [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let time pass [s]."""
        time.sleep(seconds)

    def graph(self) -> Graph:
        """List topics and services by rosapi.

        Raises:
            TrocarError: rosapi does not answer
        """
        listed = self._call("rosapi/topics", {})
        types = dict(zip(listed["topics"], map(_short, listed["types"]), strict=False))
        published: dict[str, str] = {}
        subscribed: dict[str, str] = {}
        for node in self._call("rosapi/nodes", {})["nodes"]:
            details = self._call("rosapi/node_details", {"node": node})
            for names, found in (("publishing", published), ("subscribing", subscribed)):
                found |= {
                    name.removeprefix("/"): types.get(name, "") for name in details.get(names, ())
                }
        services = self._call("rosapi/services", {})["services"]
        return Graph(published, subscribed, {name.removeprefix("/"): "" for name in services})

    def latched(self, topic: str) -> bool | None:  # noqa: ARG002
        """Return None: rosbridge does not show it."""
        return None

    def subscribe(
        self,
        topic: str,
        kind: str,
        take: Take,
        depth: int = DEPTH,  # noqa: ARG002  rosbridge's own queue
    ) -> Callable[[], None]:
        """Have each message handed to `take`; call the result to unsubscribe."""
        takes = self._subscriptions.setdefault(topic, (kind, []))[1]
        takes.append(take)
        key = f"subscription-{next(self._ids)}"
        request = {"topic": f"/{topic}", "id": key}
        self._send({"op": "subscribe", "type": kind, **request})

        def unsubscribe() -> None:
            takes.remove(take)
            self._send({"op": "unsubscribe", **request})

        return unsubscribe

    def advertise(self, topic: str, kind: str) -> None:
        """Announce messages on a topic."""
        if topic not in self._advertised:
            self._advertised[topic] = kind
            self._send({"op": "advertise", "topic": f"/{topic}", "type": kind})

    def publish(self, topic: str, kind: str, fields: Mapping[str, Any]) -> None:
        """Send a message; numbers that JSON lacks become null."""
        self.advertise(topic, kind)
        message = to_json(kind, {**blank(kind), **fields})
        self._send({"op": "publish", "topic": f"/{topic}", "msg": message})

    def call(
        self, service: str, kind: str, fields: Mapping[str, Any], timeout_s: float = CALL_S
    ) -> Mapping[str, Any]:
        """Call a service.

        Raises:
            TrocarError: there is no such service, it rejects the request, or it does not answer
        """
        halves = service_type(kind)
        request = to_json(halves.request, {**blank(halves.request), **fields})
        try:
            return from_json(halves.response, self._call(service, request, timeout_s))
        except MessageError as problem:
            raise TrocarError(f"{service}: {problem}") from problem

    def _call(
        self, service: str, request: Mapping[str, Any], timeout_s: float = CALL_S
    ) -> Mapping[str, Any]:
        key = f"call-{next(self._ids)}"
        answer = self._waiting[key] = Future[Mapping[str, Any]]()
        self._send({"op": "call_service", "id": key, "service": f"/{service}", "args": request})
        try:
            reply = answer.result(timeout_s)
        except FutureTimeoutError:
            raise TrocarError(f"{service}: no answer within {timeout_s:g} s") from None
        finally:
            del self._waiting[key]
        values = reply.get("values")
        if reply.get("result") is False or not isinstance(values, Mapping):
            raise TrocarError(f"{service}: {values}")
        return cast(Mapping[str, Any], values)

    def _send(self, request: Mapping[str, Any]) -> None:
        """Send a request; what is sent while the connection is broken is lost."""
        line = self._line
        try:
            if line is not None:
                line.send(json.dumps(request))
        except (OSError, WebSocketException) as error:
            _log.debug("%s: cannot send: %s", self.name, error)

    def _connect(self) -> ClientConnection:
        return connect(self.name, compression=None, max_size=LARGEST, open_timeout=CONNECT_S)

    def _run(self) -> None:
        """Listen over one connection after the other."""
        while not self._over.is_set():
            reason = "closed by the other side"
            try:
                if self._line is None:
                    self._line = self._connect()
                    _log.warning("%s: reconnected", self.name)
                    self._announce()
                for text in self._line:
                    self._take(text)
            except (OSError, WebSocketException) as error:
                reason = str(error) or type(error).__name__
            if self._line is not None and not self._over.is_set():
                _log.warning("%s: connection lost (%s); reconnecting", self.name, reason)
            self._line = None
            self._over.wait(RETRY_S)

    def _announce(self) -> None:
        """Subscribe and advertise again."""
        for topic, (kind, _) in list(self._subscriptions.items()):
            self._send({"op": "subscribe", "topic": f"/{topic}", "type": kind})
        for topic, kind in list(self._advertised.items()):
            self._send({"op": "advertise", "topic": f"/{topic}", "type": kind})

    def _take(self, text: str | bytes) -> None:
        try:
            document = json.loads(text)
            op = document.get("op")
            if op == "service_response":
                answer = self._waiting.get(str(document.get("id")))
                if answer is not None and not answer.done():
                    answer.set_result(document)
            elif op == "publish":
                kind, takes = self._subscriptions[str(document["topic"]).removeprefix("/")]
                fields = from_json(kind, document["msg"])
                for take in tuple(takes):
                    take(fields)
        except (ValueError, KeyError, AttributeError, MessageError) as problem:
            _log.debug("%s: cannot read a message: %s", self.name, problem)


def _short(kind: str) -> str:
    """Return ROS 1's name of a type, "a/B" for ROS 2's "a/msg/B"."""
    return kind.replace("/msg/", "/", 1)
