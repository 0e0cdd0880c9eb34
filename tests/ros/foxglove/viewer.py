"""What a viewer does in Foxglove's WebSocket protocol, and no more; nothing of its SDK.

Source: github.com/foxglove/ws-protocol, docs/spec.md.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from websockets.sync.client import connect
from websockets.sync.connection import Connection

PROTOCOL = "foxglove.sdk.v1"
MESSAGE, TIME = 1, 2
PATIENCE_S = 10.0


class Viewer:
    """A client; `channels` is what the server advertised, by topic."""

    def __init__(self, socket: Connection) -> None:
        self.socket = socket
        self.hello = json.loads(socket.recv(PATIENCE_S))
        self.channels: dict[str, dict[str, Any]] = {}

    def read_channels(self, count: int) -> None:
        while len(self.channels) < count:
            told = json.loads(self.socket.recv(PATIENCE_S))
            assert told["op"] == "advertise"
            self.channels |= {channel["topic"]: channel for channel in told["channels"]}

    def say(self, **operation: object) -> None:
        self.socket.send(json.dumps(operation))

    def subscribe(self, *topics: str) -> None:
        ids = [self.channels[topic]["id"] for topic in topics]
        self.say(op="subscribe", subscriptions=[{"id": n, "channelId": n} for n in ids])

    def unsubscribe(self, *topics: str) -> None:
        ids = [self.channels[topic]["id"] for topic in topics]
        self.say(op="unsubscribe", subscriptionIds=ids)

    def message(self) -> tuple[str, int, bytes]:
        """Return the next message: its topic, log time [ns] and bytes."""
        while True:
            frame = self.socket.recv(PATIENCE_S)
            if isinstance(frame, bytes) and frame[0] == MESSAGE:
                _, channel, log_ns = struct.unpack_from("<BIQ", frame)
                names = {entry["id"]: topic for topic, entry in self.channels.items()}
                return names[channel], log_ns, frame[13:]

    def time(self) -> int:
        """Return the next time that the server tells [ns]."""
        while True:
            frame = self.socket.recv(PATIENCE_S)
            if isinstance(frame, bytes) and frame[0] == TIME:
                return struct.unpack_from("<Q", frame, 1)[0]


@contextmanager
def viewer(port: int, count: int = 0) -> Iterator[Viewer]:
    """Connect, and wait until so many channels were advertised."""
    with connect(
        f"ws://127.0.0.1:{port}",
        subprotocols=[PROTOCOL],  # type: ignore[list-item]
        close_timeout=1,
        max_size=None,
    ) as socket:
        found = Viewer(socket)
        found.read_channels(count)
        yield found


def until(condition, patience_s: float = PATIENCE_S) -> None:
    """Wait until something holds that another thread brings about."""
    end = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)
