"""Whatever a client asks, in whatever order, nothing but an answer comes of it."""

from __future__ import annotations

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import numpy as np
import pytest
from websockets.protocol import State

from trocar.live import Loop
from trocar.ros import Core
from trocar.ros.transports.websocket.protocol import OPERATIONS, ROSAPI, UNSUPPORTED, Subscribe
from trocar.ros.transports.websocket.server import Client, Conversation, EncodedMessage
from trocar.simulation import World

REQUESTS = 3000


class Wire:
    """What a connection writes."""

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.state = State.OPEN
        self.remote_address = ("127.0.0.1", 1)
        self.transport, self.paused = self, False

    def write(self, data: bytes) -> None:
        self.written.append(data)


@pytest.fixture(scope="module")
def core() -> Core:
    """Return the core of a PSM that is neither enabled nor homed; nothing runs."""
    world = World("psm")
    world.arm("PSM1").state_command("disable")
    return Core(Loop(world))


def values(core: Core, rng: np.random.Generator) -> list[Any]:
    """Return what may stand in a field: much that fits, and much that does not."""
    names = [*core.topics, *core.services, *(f"rosapi/{name}" for name in ROSAPI)]
    types = [topic.type for topic in core.topics.values()]
    vector = rng.normal(size=int(rng.integers(0, 9))).tolist()
    return [
        *(f"/{rng.choice(names)}" for _ in range(12)),
        *(str(rng.choice(types)) for _ in range(4)),
        *({"position": vector}, {"data": "enable"}, {"string": "home"}, {"jp": vector}, {}, vector),
        *(
            {"header": {"stamp": {"secs": -1}}},
            {"data": [[]]},
            {"type": {"a": []}},
            {"position": "x"},
        ),
        *(None, True, -1, 1e400, 10**30, "", "x" * 300, "\ud800", float("nan"), [], [None], "none"),
    ]


def test_thousands_of_random_requests_raise_nothing_and_move_nothing(
    core: Core, rng: np.random.Generator
) -> None:
    wire = Wire()
    keys = [
        "topic",
        "service",
        "msg",
        "args",
        "type",
        "id",
        "throttle_rate",
        "level",
        "compression",
    ]

    async def ask() -> None:
        with ThreadPoolExecutor(1) as workers:
            conversation = Conversation(core, workers)
            client = Client(cast("Any", wire), {})
            for _ in range(REQUESTS):
                choice = values(core, rng)
                document = {key: choice[rng.integers(len(choice))] for key in keys}
                if rng.random() < 0.7:
                    del document["id"]
                op = rng.choice([*OPERATIONS, *UNSUPPORTED, "publish", "call_service", "subscribe"])
                if rng.random() < 0.8:
                    document["topic"] = f"/{rng.choice([*core.topics])}"
                    document["service"] = f"/rosapi/{rng.choice([*ROSAPI])}"
                client.level = "info"
                conversation.handle(client, json.dumps({"op": str(op), **document}))
                conversation.reject(client, json.dumps(document))
                client.tend(0.0)
                await asyncio.sleep(0)

    before = core.loop.world.arm("PSM1").measured_js().position.copy()
    asyncio.run(ask())
    assert len(wire.written) > REQUESTS / 2
    for _ in range(100):
        core.loop.tick()
    after = core.loop.world.arm("PSM1")
    assert after.operating_state().state == "DISABLED" or after.operating_state().is_homed
    assert abs(after.measured_js().position - before).max() < 0.02


def test_a_message_is_encoded_once_for_everybody(core: Core) -> None:
    frame = EncodedMessage(core.topics["PSM1/status"], {"data": "hello"})
    assert frame.named("/PSM1/status") is frame.named("/PSM1/status")
    assert b'"msg":{"data":"hello"}' in frame.named("PSM1/status")


def test_the_last_of_a_throttled_topic_comes_in_the_end(core: Core) -> None:
    wire = Wire()
    client = Client(cast("Any", wire), {})
    topic = core.topics["PSM1/status"]
    client.subscribe(topic.name, Subscribe(topic="/PSM1/status", throttle_rate=1000.0))
    for moment, text in ((10.0, "one"), (10.1, "two"), (10.2, "three")):
        client.deliver([EncodedMessage(topic, {"data": text})], [], moment)
    client.tend(10.9)
    assert [text for text in (b"one", b"two", b"three") if text in b"".join(wire.written)] == [
        b"one"
    ]
    client.tend(11.1)
    client.tend(12.5)
    assert len(wire.written) == 2
    assert b"three" in wire.written[1]


def test_a_message_to_a_topic_that_no_arm_has_is_answered_with_the_nearest(core: Core) -> None:
    wire = Wire()
    with ThreadPoolExecutor(1) as workers:
        conversation = Conversation(core, workers)
        client = Client(cast("Any", wire), {})
        request = {"op": "publish", "topic": "/psm1/move_jp", "msg": {}}
        client.level = "info"
        conversation.handle(client, json.dumps(request))
    assert b"did you mean /PSM1/move_jp?" in b"".join(wire.written)
