"""Receive the topics of another program's rosbridge."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from trocar.errors import InputError, TrocarError
from trocar.messages import MessageError, from_json

_log = logging.getLogger("trocar")

JOINT_STATE = "sensor_msgs/JointState"
#: Time between two attempts to connect again [s]. Source: our own choice.
RETRY_S = 1.0
#: Longest time to connect [s]. Source: our own choice.
CONNECT_S = 5.0
#: Largest message that is read [bytes]. Source: our own choice; a JointState has a few hundred.
LARGEST = 1_000_000

Take = Callable[[str, Mapping[str, Any]], None]


class WebSocketListener:
    """Receive joint states over rosbridge, and connect again when the connection breaks.

    Args:
        url: such as ws://127.0.0.1:9090
    """

    def __init__(self, url: str) -> None:
        if not url.startswith(("ws://", "wss://")):
            raise InputError(f"--websocket: got {url!r}; allowed: ws://HOST:PORT")
        self._url = url
        self._line: ClientConnection | None = None
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, topics: Sequence[str], take: Take) -> None:
        """Connect, subscribe and hand over what arrives.

        Raises:
            TrocarError: no answer
        """
        try:
            self._line = self._connect()
        except (OSError, WebSocketException) as error:
            why = str(error) or f"no answer within {CONNECT_S:g} s"
            raise TrocarError(f"--websocket: no connection to {self._url}: {why}") from error
        self._thread = threading.Thread(
            target=self._run, args=(topics, take), name="trocar-listen", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._over.set()
        if self._line is not None:
            self._line.close()
        if self._thread is not None:
            self._thread.join(CONNECT_S)

    def _connect(self) -> ClientConnection:
        return connect(self._url, compression=None, max_size=LARGEST, open_timeout=CONNECT_S)

    def _run(self, topics: Sequence[str], take: Take) -> None:
        """Listen over one connection after the other."""
        while not self._over.is_set():
            reason = "closed by the other side"
            try:
                if self._line is None:
                    self._line = self._connect()
                    _log.warning("%s: reconnected", self._url)
                self._listen(self._line, topics, take)
            except (OSError, WebSocketException) as error:
                reason = str(error) or type(error).__name__
            if self._line is not None and not self._over.is_set():
                _log.warning("%s: connection lost (%s); reconnecting", self._url, reason)
            self._line = None
            self._over.wait(RETRY_S)

    def _listen(self, line: ClientConnection, topics: Sequence[str], take: Take) -> None:
        known = {f"/{topic}": topic for topic in topics} | {topic: topic for topic in topics}
        for topic in topics:
            request = {"op": "subscribe", "topic": f"/{topic}", "type": JOINT_STATE}
            line.send(json.dumps(request))
        for text in line:
            try:
                document = json.loads(text)
                topic = known.get(str(document.get("topic")))
                if topic is not None and document.get("op") == "publish":
                    take(topic, from_json(JOINT_STATE, document["msg"]))
            except (ValueError, KeyError, AttributeError, MessageError) as problem:
                _log.debug("%s: cannot read a message: %s", self._url, problem)
