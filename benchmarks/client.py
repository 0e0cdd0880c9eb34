"""A client of a simulator, in a process of its own, that measures what another program would see.

    python -m benchmarks.client listen websocket ws://127.0.0.1:9090 10 TOPIC...
    python -m benchmarks.client answers websocket ws://127.0.0.1:9090 50
    python -m benchmarks.client flood websocket ws://127.0.0.1:9090 10000 10
    python -m benchmarks.client sleep websocket 220 10

print one JSON document: {"TOPIC": [[stamp in ns, arrival in ns], ...]}, or seconds, or a rate.
"""

from __future__ import annotations

import asyncio
import gc
import json
import math
import sys
import threading
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from importlib import import_module
from typing import Any, Protocol

#: Time after subscribing in which connections are made. [s]
SETTLE_S = 2.0
#: Step of a command, rest before it, and the motion that counts: a hundred times what an arm at
#: rest creeps. Source: our own choice. [rad, s, rad]
STEP_RAD, REST_S, SEEN_RAD = 0.05, 0.2, 1e-6
#: Time limit of an answer. [s]
PATIENCE_S = 30.0
STATE, JOINTS, ORDER, SERVO = (
    f"/PSM1/{key}" for key in ("operating_state", "measured_js", "state_command", "servo_jp")
)
#: Set-points of a flood: one in reach, one that is invalid.
FLOOD = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0], [math.nan] * 6

#: Called with a topic, a message and its arrival time [ns].
Callback = Callable[[str, Any, int], None]
Heard = dict[str, list[tuple[int, int]]]


class Peer(Protocol):
    """A program on the other side of a transport; messages are in the transport's own form."""

    def subscribe(self, topics: Sequence[str], callback: Callback) -> None:
        """Call back with the messages of topics, and their arrival times [ns]."""
        ...

    def stamp(self, message: Any) -> int:
        """Return a message's header stamp [ns]."""
        ...

    def joints(self, message: Any) -> Sequence[float]:
        """Return the positions of a JointState."""
        ...

    def homed(self, message: Any) -> bool:
        """Return is_homed of an OperatingState."""
        ...

    def order(self, verb: str) -> None:
        """Send PSM1 a state_command."""
        ...

    def servo(self, position: Sequence[float]) -> None:
        """Send PSM1 a servo_jp."""
        ...


class Websocket:
    """A rosbridge client with one connection for subscriptions and one for commands.

    Messages are text; they are parsed after the measurement, so that parsing one delays no other.
    """

    def __init__(self, address: str) -> None:
        from websockets.sync.client import connect

        self._address, self._out = address, connect(address, compression=None)

    def subscribe(self, topics: Sequence[str], callback: Callback) -> None:
        """As `Peer`."""
        listening = self._listen(topics, callback)
        threading.Thread(target=lambda: asyncio.run(listening), daemon=True).start()

    def stamp(self, message: Any) -> int:
        """As `Peer`."""
        return stamp_ns(message)

    def joints(self, message: Any) -> Sequence[float]:
        """As `Peer`."""
        return json.loads(message)["msg"]["position"]

    def homed(self, message: Any) -> bool:
        """As `Peer`."""
        return json.loads(message)["msg"]["is_homed"]

    def order(self, verb: str) -> None:
        """As `Peer`."""
        self._publish(ORDER, "crtk_msgs/StringStamped", {"string": verb})

    def servo(self, position: Sequence[float]) -> None:
        """As `Peer`."""
        self._publish(SERVO, "sensor_msgs/JointState", {"position": [*position]})

    def _publish(self, topic: str, kind: str, message: dict[str, Any]) -> None:
        self._out.send(json.dumps({"op": "publish", "topic": topic, "type": kind, "msg": message}))

    async def _listen(self, topics: Sequence[str], callback: Callback) -> None:
        async for topic, text, arrived in messages(self._address, topics):
            callback(topic, text, arrived)


async def messages(address: str, topics: Sequence[str]) -> AsyncGenerator[tuple[str, str, int]]:
    """Subscribe to topics of a rosbridge, and yield topic, text and arrival [ns] of messages."""
    from websockets.asyncio.client import connect

    known = {f'"{topic}"': topic for topic in topics}
    async with connect(address, compression=None, max_size=None, ping_interval=None) as socket:
        for topic in topics:
            await socket.send(json.dumps({"op": "subscribe", "topic": topic}))
        async for text in socket:
            arrived = time.monotonic_ns()
            begin = str(text[:200])  # the topic comes first
            quoted = begin[begin.find('"/') :].partition('",')[0] + '"'
            if quoted in known:
                yield known[quoted], str(text), arrived


def stamp_ns(text: str) -> int:
    """Return the header stamp of a rosbridge's message [ns]."""
    stamp = json.loads(text)["msg"]["header"]["stamp"]
    return stamp["secs"] * 1_000_000_000 + stamp["nsecs"]


def listen(peer: Peer, topics: Sequence[str], seconds: float) -> Heard:
    """Return stamps and arrivals of topics."""
    noted: list[tuple[str, Any, int]] = []
    begin = time.monotonic_ns() + round(SETTLE_S * 1e9)

    def note(topic: str, message: Any, arrived: int) -> None:
        if arrived > begin:
            read = peer.stamp(message) if "image" in topic else message  # images are large
            noted.append((topic, read, arrived))

    peer.subscribe([f"/{topic}" for topic in topics], note)
    time.sleep(SETTLE_S + seconds)
    heard: Heard = {topic: [] for topic in topics}
    for topic, message, arrived in list(noted):
        stamp = message if isinstance(message, int) else peer.stamp(message)
        heard[topic.removeprefix("/")].append((stamp, arrived))
    return heard


def answers(peer: Peer, count: int) -> list[float]:
    """Command one joint of PSM1, and return the times until its motion is measured [s]."""
    newest: list[Sequence[float]] = []
    homed, moved = threading.Event(), threading.Event()
    rest = 0.0

    def note(topic: str, message: Any, _: int) -> None:
        if topic == STATE:
            if peer.homed(message):
                homed.set()
            return
        position = peer.joints(message)
        newest[:] = [position]
        if abs(position[0] - rest) > SEEN_RAD:
            moved.set()

    peer.subscribe([STATE, JOINTS], note)
    time.sleep(SETTLE_S)
    for verb in ("enable", "home"):
        peer.order(verb)
    if not homed.wait(PATIENCE_S):
        raise TimeoutError("PSM1 did not home")
    time.sleep(SETTLE_S)
    took: list[float] = []
    for k in range(count):
        time.sleep(REST_S)
        goal = [*newest[0]]
        rest = goal[0]
        goal[0] += STEP_RAD if k % 2 else -STEP_RAD
        moved.clear()
        sent = time.monotonic()
        peer.servo(goal)
        if not moved.wait(PATIENCE_S):
            raise TimeoutError("PSM1 did not move")
        took.append(time.monotonic() - sent)
    return took


def flood(peer: Peer, rate_hz: float, seconds: float) -> float:
    """Send PSM1 servo commands, every other one invalid; return their rate [1/s]."""
    time.sleep(SETTLE_S)
    began, count = time.monotonic(), 0
    while (passed := time.monotonic() - began) < seconds:
        while count < passed * rate_hz:
            peer.servo(FLOOD[count % 2])
            count += 1
        time.sleep(0.001)
    return count / (time.monotonic() - began)


def sleep(rate_hz: float, seconds: float) -> Heard:
    """Wake at a rate and do nothing: the lateness that the operating system alone causes."""
    time.sleep(SETTLE_S)
    noted: list[tuple[int, int]] = []
    began, period = time.monotonic_ns(), 1e9 / rate_hz
    for k in range(1, round(seconds * rate_hz) + 1):
        due = began + round(k * period)
        time.sleep(max(0, due - time.monotonic_ns()) * 1e-9)
        noted.append((due, time.monotonic_ns()))
    return {"": noted}


def main(words: Sequence[str]) -> None:
    """Run one program and print its result."""
    what, transport, address, amount, *topics = words
    gc.disable()  # a collection over what was noted would delay the client
    if what == "sleep":
        result: object = sleep(float(address), float(amount))
    else:
        kind = Websocket if transport == "websocket" else None
        peer: Peer = (kind or import_module(f"benchmarks.{transport}").Program)(address)
        if what == "listen":
            result = listen(peer, topics, float(amount))
        elif what == "answers":
            result = answers(peer, int(amount))
        else:
            result = flood(peer, float(amount), float(topics[0]))
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
