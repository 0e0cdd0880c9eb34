"""A client of rosbridge."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Sequence
from typing import Any

from websockets.asyncio.client import connect
from websockets.sync.client import connect as connect_in_turn

from trocar.apps.benchmarks.peers import ORDER, SERVO, Told


class Program:
    """Two connections: what is said does not wait for what is heard.

    Messages are the whole text, so that reading one does not make the next seem late; the topic
    comes first in it.
    """

    def __init__(self, address: str) -> None:
        self._address, self._out = address, connect_in_turn(address, compression=None)

    def hear(self, topics: Sequence[str], told: Told) -> None:
        """As `Peer`."""
        threading.Thread(
            target=lambda: asyncio.run(self._listen(topics, told)), daemon=True
        ).start()

    def stamp(self, message: Any) -> int:
        """As `Peer`."""
        stamp = json.loads(message)["msg"]["header"]["stamp"]
        return stamp["secs"] * 1_000_000_000 + stamp["nsecs"]

    def joints(self, message: Any) -> Sequence[float]:
        """As `Peer`."""
        return json.loads(message)["msg"]["position"]

    def homed(self, message: Any) -> bool:
        """As `Peer`."""
        return json.loads(message)["msg"]["is_homed"]

    def order(self, verb: str) -> None:
        """As `Peer`."""
        self._say(ORDER, "crtk_msgs/StringStamped", {"string": verb})

    def servo(self, position: Sequence[float]) -> None:
        """As `Peer`."""
        self._say(SERVO, "sensor_msgs/JointState", {"position": [*position]})

    def _say(self, topic: str, kind: str, message: dict[str, Any]) -> None:
        said = {"op": "publish", "topic": topic, "type": kind, "msg": message}
        self._out.send(json.dumps(said))

    async def _listen(self, topics: Sequence[str], told: Told) -> None:
        known = {f'"{topic}"': topic for topic in topics}
        async with connect(self._address, compression=None, max_size=None) as socket:
            for topic in topics:
                await socket.send(json.dumps({"op": "subscribe", "topic": topic}))
            async for text in socket:
                arrived = time.monotonic_ns()
                begin = str(text[:200])
                quoted = begin[begin.find('"/') :].partition('",')[0] + '"'
                if quoted in known:
                    told(known[quoted], text, arrived)
