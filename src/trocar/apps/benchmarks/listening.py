"""The subscriber of `trocar bench interface`: a process of its own, which only notes arrivals.

    python -m trocar.apps.benchmarks.listening listen websocket ws://127.0.0.1:9090 10 TOPIC...
    python -m trocar.apps.benchmarks.listening answers websocket ws://127.0.0.1:9090 50
    python -m trocar.apps.benchmarks.listening flood websocket ws://127.0.0.1:9090 10000 10
    python -m trocar.apps.benchmarks.listening sleep websocket 220 10

print one JSON document: {"TOPIC": [[stamp in ns, arrival in ns], ...]}, or seconds. It uses
nothing of the simulator's, so that what is measured is what another program would see.
"""

from __future__ import annotations

import gc
import json
import math
import sys
import threading
import time
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from trocar.apps.benchmarks.peers import JOINTS, STATE, Peer

#: After subscribing, until what comes counts: connections are made meanwhile. [s]
SETTLE_S = 2.0
#: A command's step, the rest before it, and the motion that counts: a hundred times what an arm at
#: rest creeps. Source: our own choice. [rad, s, rad]
STEP_RAD, REST_S, SEEN_RAD = 0.05, 0.2, 1e-6
#: Nothing takes longer; a simulator that does not answer is an error. [s]
PATIENCE_S = 30.0

#: What a flood is made of: where the arm may go, and what is no place.
FLOOD = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0], [math.nan] * 6

Heard = dict[str, list[tuple[int, int]]]


def listen(peer: Peer, topics: Sequence[str], seconds: float) -> Heard:
    """Note stamps and arrivals of topics."""
    noted: list[tuple[str, Any, int]] = []
    begin = time.monotonic_ns() + round(SETTLE_S * 1e9)

    def told(topic: str, message: Any, arrived: int) -> None:
        if arrived > begin:
            read = peer.stamp(message) if "image" in topic else message  # those are large
            noted.append((topic, read, arrived))

    peer.hear([f"/{topic}" for topic in topics], told)
    time.sleep(SETTLE_S + seconds)
    heard: Heard = {topic: [] for topic in topics}
    for topic, message, arrived in list(noted):
        stamp = message if isinstance(message, int) else peer.stamp(message)
        heard[topic.removeprefix("/")].append((stamp, arrived))
    return heard


def answers(peer: Peer, count: int) -> list[float]:
    """Command one joint of PSM1 and time how long it takes until it is seen to move [s]."""
    newest: list[Sequence[float]] = []
    homed, moved = threading.Event(), threading.Event()
    rest = 0.0

    def told(topic: str, message: Any, _: int) -> None:
        if topic == STATE:
            if peer.homed(message):
                homed.set()
            return
        position = peer.joints(message)
        newest[:] = [position]
        if abs(position[0] - rest) > SEEN_RAD:
            moved.set()

    peer.hear([STATE, JOINTS], told)
    time.sleep(SETTLE_S)
    for verb in ("enable", "home"):
        peer.order(verb)
    if not homed.wait(PATIENCE_S):
        raise TimeoutError("PSM1 did not come home")
    time.sleep(SETTLE_S)
    took: list[float] = []
    for k in range(count):
        time.sleep(REST_S)
        goal = [*newest[0]]
        rest = goal[0]
        goal[0] += STEP_RAD if k % 2 else -STEP_RAD
        moved.clear()
        asked = time.monotonic()
        peer.servo(goal)
        if not moved.wait(PATIENCE_S):
            raise TimeoutError("PSM1 did not move")
        took.append(time.monotonic() - asked)
    return took


def flood(peer: Peer, rate_hz: float, seconds: float) -> float:
    """Send PSM1 servo commands, every other one without a meaning; return how many a second."""
    time.sleep(SETTLE_S)
    began, count = time.monotonic(), 0
    while (passed := time.monotonic() - began) < seconds:
        while count < passed * rate_hz:
            peer.servo(FLOOD[count % 2])
            count += 1
        time.sleep(0.001)
    return count / (time.monotonic() - began)


def sleep(rate_hz: float, seconds: float) -> Heard:
    """Wake so often and do nothing: how late that is, nobody's messages can be earlier."""
    time.sleep(SETTLE_S)
    noted: list[tuple[int, int]] = []
    began, period = time.monotonic_ns(), 1e9 / rate_hz
    for k in range(1, round(seconds * rate_hz) + 1):
        due = began + round(k * period)
        time.sleep(max(0, due - time.monotonic_ns()) * 1e-9)
        noted.append((due, time.monotonic_ns()))
    return {"": noted}


def main(words: Sequence[str]) -> None:
    """Do what the command line says, and print what was heard or how long answers took."""
    what, transport, address, much, *topics = words
    gc.disable()  # going through what was noted would stop the listener, not what it listens to
    if what == "sleep":
        said: object = sleep(float(address), float(much))
    else:
        peer: Peer = import_module(f"trocar.apps.benchmarks.{transport}_peer").Program(address)
        if what == "listen":
            said = listen(peer, topics, float(much))
        elif what == "answers":
            said = answers(peer, int(much))
        else:
            said = flood(peer, float(much), float(topics[0]))
    sys.stdout.write(json.dumps(said))
    sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
