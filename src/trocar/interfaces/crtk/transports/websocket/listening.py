"""Hear the topics of another program's rosbridge."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidURI, WebSocketException

from trocar.errors import InputError, TrocarError
from trocar.interfaces.crtk.messages import MessageError, from_json

_log = logging.getLogger("trocar")

JOINT_STATE = "sensor_msgs/JointState"
#: Between two attempts to connect again [s]. Source: our own choice.
AGAIN_S = 1.0
#: How long the first connection may take [s]. Source: our own choice.
FIRST_S = 5.0
#: Largest message that is read [bytes]. Source: our own choice; a JointState has a few hundred.
LARGEST = 1_000_000

Take = Callable[[str, Mapping[str, Any]], None]


class WebSocketListener:
    """Hears joint states over rosbridge, and connects again when the line breaks.

    Args:
        url: such as ws://127.0.0.1:9090
    """

    def __init__(self, url: str) -> None:
        if not url.startswith(("ws://", "wss://")):
            raise InputError(f"--websocket: got {url!r}; allowed: ws://HOST:PORT")
        self._url = url
        self._loop = asyncio.new_event_loop()
        self._task: asyncio.Task[None] | None = None
        self._thread: threading.Thread | None = None
        self._connected = threading.Event()
        self._failure = ""

    def start(self, topics: Sequence[str], take: Take) -> None:
        """Connect, subscribe and hand over what comes.

        Raises:
            TrocarError: nobody answers there
        """
        self._thread = threading.Thread(
            target=self._run, args=(tuple(topics), take), name="trocar-listen", daemon=True
        )
        self._thread.start()
        if not self._connected.wait(FIRST_S):
            self.close()
            why = self._failure or f"no answer within {FIRST_S:g} s"
            raise TrocarError(f"--websocket: nobody answers at {self._url}: {why}")

    def close(self) -> None:
        """Listen no more."""
        task, thread = self._task, self._thread
        if task is not None:
            with contextlib.suppress(RuntimeError):  # it is over already
                self._loop.call_soon_threadsafe(task.cancel)
        if thread is not None:
            thread.join(FIRST_S)

    def _run(self, topics: Sequence[str], take: Take) -> None:
        try:
            self._task = self._loop.create_task(self._stay(topics, take))
            with contextlib.suppress(asyncio.CancelledError):
                self._loop.run_until_complete(self._task)
        finally:
            self._loop.close()

    async def _stay(self, topics: Sequence[str], take: Take) -> None:
        """Listen until cancelled, over one connection after the other."""
        while True:
            try:
                async with connect(self._url, compression=None, max_size=LARGEST) as line:
                    if self._failure:
                        _log.warning("%s: connected again", self._url)
                    self._failure = ""
                    self._connected.set()
                    await self._listen(line, topics, take)
                    reason = "closed by the other side"
            except InvalidURI as problem:
                self._failure = str(problem)
                return
            except (OSError, WebSocketException, TimeoutError) as problem:
                reason = str(problem) or type(problem).__name__
            if self._connected.is_set() and not self._failure:
                _log.warning("%s: the connection is lost (%s); trying again", self._url, reason)
            self._failure = reason
            await asyncio.sleep(AGAIN_S)

    async def _listen(self, line: ClientConnection, topics: Sequence[str], take: Take) -> None:
        known = {f"/{topic}": topic for topic in topics} | {topic: topic for topic in topics}
        for topic in topics:
            request = {"op": "subscribe", "topic": f"/{topic}", "type": JOINT_STATE}
            await line.send(json.dumps(request))
        async for text in line:
            try:
                told = json.loads(text)
                topic = known.get(str(told.get("topic"))) if told.get("op") == "publish" else None
                if topic is not None:
                    take(topic, from_json(JOINT_STATE, told["msg"]))
            except (ValueError, KeyError, AttributeError, MessageError) as problem:
                _log.debug("%s: a message that cannot be read: %s", self._url, problem)
