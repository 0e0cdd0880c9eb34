"""A client of rosbridge."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from websockets.sync.client import connect

from trocar.apps.benchmarks.peers import ORDER, SERVO


class Program:
    """A client of rosbridge, with two connections: what is said does not wait for what is heard."""

    def __init__(self, address: str) -> None:
        self._told: dict[str, Callable[[Any, int], None]] = {}
        self._out = connect(address, compression=None)
        self._in = connect(address, compression=None, max_size=None)
        threading.Thread(target=self._listen, daemon=True).start()

    def hear(self, topic: str, told: Callable[[Any, int], None]) -> None:
        """As `Peer`; messages are rosbridge's "msg"."""
        self._told[topic] = told
        self._in.send(json.dumps({"op": "subscribe", "topic": topic}))

    def stamp(self, message: Any) -> int:
        """As `Peer`."""
        stamp = message["header"]["stamp"]
        return stamp["secs"] * 1_000_000_000 + stamp["nsecs"]

    def joints(self, message: Any) -> Sequence[float]:
        """As `Peer`."""
        return message["position"]

    def homed(self, message: Any) -> bool:
        """As `Peer`."""
        return message["is_homed"]

    def order(self, verb: str) -> None:
        """As `Peer`."""
        self._say(ORDER, "crtk_msgs/StringStamped", {"string": verb})

    def servo(self, position: Sequence[float]) -> None:
        """As `Peer`."""
        self._say(SERVO, "sensor_msgs/JointState", {"position": [*position]})

    def _say(self, topic: str, kind: str, message: dict[str, Any]) -> None:
        said = {"op": "publish", "topic": topic, "type": kind, "msg": message}
        self._out.send(json.dumps(said))

    def _listen(self) -> None:
        for text in self._in:
            arrived = time.monotonic_ns()
            said = json.loads(text)
            if said.get("op") == "publish":
                self._told[said["topic"]](said["msg"], arrived)
