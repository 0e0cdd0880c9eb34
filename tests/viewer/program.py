"""A client of the rosbridge WebSocket that is no browser: reads states over CRTK."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from websockets.sync.client import connect

ANSWER_S = 20.0
"""Time within which a topic has to have the message that is waited for [s]."""


class Program:
    """A client on an open socket."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket

    def say(self, op: str, **fields: object) -> None:
        """Send an operation of rosbridge."""
        self._socket.send(json.dumps({"op": op, **fields}))

    def hear(
        self,
        topic: str,
        fits: Callable[[dict], bool] = lambda _: True,
        timeout_s: float = ANSWER_S,
    ) -> dict:
        """Return the first message of a topic that fits; fail with the last one after a time."""
        self.say("subscribe", topic=topic)
        end, last = time.monotonic() + timeout_s, None
        try:
            while True:
                left_s = max(end - time.monotonic(), 0.0)
                try:
                    heard = json.loads(self._socket.recv(timeout=left_s))
                except TimeoutError:
                    break
                if heard.get("topic") == topic:
                    last = heard["msg"]
                    if fits(last):
                        return last
        finally:
            self.say("unsubscribe", topic=topic)
        raise AssertionError(f"in vain: {topic}; the last message: {last}")

    @property
    def state(self) -> str:
        """Operating state of PSM1."""
        return self.hear("/PSM1/operating_state")["state"]

    @property
    def joints(self) -> list[float]:
        """Measured joints of PSM1 [rad, m]."""
        return self.hear("/PSM1/measured_js")["position"]


@contextmanager
def program(address: str, token: str | None = None) -> Iterator[Program]:
    """Connect to a rosbridge WebSocket while the `with` block lasts."""
    shown = {} if token is None else {"Authorization": f"Bearer {token}"}
    # A full queue would stop reading, and with it the answers that keep the connection open.
    with connect(address, additional_headers=shown, max_queue=None) as socket:
        yield Program(socket)
