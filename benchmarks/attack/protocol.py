"""Fuzzed messages into a running core: rosbridge text, ROS 1 and CDR bytes, from valid ones.

A case is one message, decoded as the transports do, and the ticks after it. It fails when anything
else than a rejection comes of it: an exception that leaves the server or the loop, a defect that
they caught and logged, a state that is not finite, or an arm without power that moves.
"""

from __future__ import annotations

import json
import logging
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import numpy as np
from websockets.protocol import State

from benchmarks.attack import SCENE, Tally
from benchmarks.attack.commands import ELSEWHERE, EXTREME, OVERLAP, STILL, touched
from trocar.errors import InputError
from trocar.live import Command, Loop
from trocar.live.loop import SERVER_TICK_S
from trocar.live.state import Elapsed
from trocar.messages import blank, cdr_decode, cdr_encode, ros1_decode, ros1_encode, to_json
from trocar.ros import Core
from trocar.ros.topic import Topic
from trocar.ros.transports.memory import MemoryTransport
from trocar.ros.transports.websocket.server import Client, Conversation
from trocar.simulation import World
from trocar.tasks import make_task
from trocar.tasks.play import scripted
from trocar.tasks.served import ServedTask

RIGS = ("psm", "pegs", SCENE, "full_cart_mtm")
#: Messages until another rig's turn, and messages of a tick. Source: our own choice.
MESSAGES, BURST = 2000, 5
#: How often everything is switched on and brought home, lest all that follows is rejected.
AWAKE = 0.05
WORDS = (
    "enable", "disable", "home", "unhome", "pause", "resume", "", "LARGE_NEEDLE_DRIVER:400006",
    "none", "yaw", "ECM", "PSM1", "Cart", "Classic_SD_STRAIGHT", "x" * 3000, "\x00", "\ud800",
)  # fmt: skip
LEAVES: tuple[Any, ...] = (*EXTREME, None, True, "", "x", [], {}, [[1.0]], 10**400, -1, 2**63)
LEAVES += (float("nan"), float("inf"))
#: What is put into the text of a message.
TOKENS = (
    "{", "}", "[" * 40, "]", '"', ",", ":", "null", "1e999", "-0", "9" * 5000, "\\u0000", "\\ud800",
    "NaN", "Infinity", '"op":"publish",', "\ufeff", "\x00", "é", "0x1f", "1e-400", '{"a":' * 200,
)  # fmt: skip
OPS = (
    "publish", "subscribe", "unsubscribe", "advertise", "unadvertise", "set_level", "fragment",
    "status", "auth", "fly", "",
)  # fmt: skip
#: A rejection whose reason is an exception that a command should not raise.
DEFECT = re.compile(r"^\w+(Error|Exception|Warning|Interrupt): ")

Rng = np.random.Generator


def attack(seed: int, seconds: float) -> Tally:
    """Send messages for so long [s]."""
    tally, number = Tally("protocol"), 0
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        rng = np.random.default_rng((seed, number))
        target = Target(RIGS[number % len(RIGS)], homed=bool(rng.random() < 0.7))
        try:
            for failure in target.attacked(rng, lambda: time.monotonic() > end, tally):
                tally.failed.append(f"seed {seed}, round {number}: {target.rig}: {failure}")
        finally:
            target.close()
        number += 1
    return tally


class Target(logging.Handler):
    """A core, with its loop in this thread, that notes every defect that is logged.

    Args:
        rig: a built-in rig
        homed: as of a world
    """

    def __init__(self, rig: str, homed: bool) -> None:
        super().__init__()
        task = (
            ServedTask(make_task(rig), 0, script=scripted if homed else None)
            if rig == SCENE
            else None
        )
        self.rig = rig
        self.world = World(rig, homed=homed) if task is None else task.task.world
        self.applied: list[Command] = []
        self.loop = Loop(
            self.world,
            speed="max",
            tick_s=SERVER_TICK_S,
            clock=Standing(),
            on_apply=lambda _, command: self.applied.append(command),
        )
        self.core = Core(
            self.loop,
            components=() if task is None else (task.component(),),
        )
        if task is not None:
            task.watch(self.loop)
        self.core.attach(MemoryTransport(()))
        self.core.begin()
        self._workers = ThreadPoolExecutor(1)
        self._server = Conversation(self.core, self._workers)
        self._client = Client(cast("Any", Deaf()), {})
        self._stop = self.loop.watch(self)
        self.defects: list[str] = []
        self._topics = [t for t in self.core.topics.values() if t.direction == "sub"]
        self._log = logging.getLogger("trocar")
        self._log.addHandler(self)
        self._propagates, self._log.propagate = self._log.propagate, False

    def close(self) -> None:
        """End."""
        self._log.removeHandler(self)
        self._log.propagate = self._propagates
        self._stop()
        self.core.close()
        self._workers.shutdown()

    def emit(self, record: logging.LogRecord) -> None:
        """Note what was logged with a traceback."""
        if record.exc_info:
            self.defects.append(f"{record.getMessage()}: {record.exc_info[1]!r}")

    def refused(self, command: Command, reason: str) -> None:
        """Note a rejection that is a defect."""
        if DEFECT.match(reason):
            self.defects.append(f"{command.arm}.{command.verb}: {reason}")

    def ticked(self, elapsed: Elapsed) -> None:
        """Do nothing."""

    def patience(self) -> int:
        """Return that no tick matters."""
        return 1000

    def attacked(self, rng: Rng, over: Callable[[], bool], tally: Tally) -> Iterator[str]:
        """Send messages; yield what failed, at most one, since the core is then another."""
        sent: list[str] = []
        send = (self._json, self._text, self._request, self._ros1, self._cdr)
        for index in range(MESSAGES):
            if over():
                return
            topic = self._topics[rng.integers(len(self._topics))]
            tally.tried += 1
            if rng.random() < AWAKE:
                for name in ("system/power_on", "system/home", "scene/resume"):
                    self.core.receive(name, {})
            try:
                sent.append(send[rng.integers(len(send))](rng, topic))
                if index % BURST == BURST - 1:
                    problem = self._ticked(int(rng.integers(1, 5)))
                    sent.clear()
                else:
                    problem = ""
            except Exception as error:  # noqa: BLE001  that is what is looked for
                problem = f"{type(error).__name__}: {error}"
            problem = problem or "; ".join(self.defects)
            if problem:
                yield f"{problem[:1000]}; after {[text[:300] for text in sent[-BURST:]]}"
                return

    # ------------------------------------------------------------------ ways in

    def _json(self, rng: Rng, topic: Topic) -> str:
        """Publish a message one of whose leaves may be spoilt, as rosbridge text."""
        message = to_json(topic.type, self._likely(rng, topic))
        if rng.random() < 0.6:
            message = spoilt(rng, message)
        text = json.dumps({"op": "publish", "topic": f"/{topic.name}", "msg": message})
        return self._frame(rng, text)

    def _text(self, rng: Rng, topic: Topic) -> str:
        """Publish a message whose text is damaged."""
        message = to_json(topic.type, self._likely(rng, topic))
        text = json.dumps({"op": "publish", "topic": f"/{topic.name}", "msg": message})
        for _ in range(rng.integers(1, 4)):
            at, length = rng.integers(len(text) + 1), rng.integers(0, 8)
            token = TOKENS[rng.integers(len(TOKENS))] if rng.random() < 0.7 else ""
            text = text[:at] + token + text[at + length :]
        if rng.random() < 0.1:
            text = text[: rng.integers(len(text) + 1)]
        return self._frame(rng, text)

    def _request(self, rng: Rng, topic: Topic) -> str:
        """Send another request, its fields spoilt."""
        request: dict[str, Any] = {
            "op": OPS[rng.integers(len(OPS))],
            "topic": f"/{topic.name}",
            "type": topic.type,
            "id": "1",
            "throttle_rate": 10,
            "level": "warning",
            "msg": {},
        }
        kept = {key: value for key, value in request.items() if rng.random() < 0.8}
        text = json.dumps(spoilt(rng, kept) if rng.random() < 0.5 else kept)
        return self._frame(rng, text)

    def _frame(self, rng: Rng, text: str) -> str:
        """Hand a text over, now and then as a binary frame."""
        binary = rng.random() < 0.1
        data = text.encode("utf-8", "surrogatepass") if binary else text
        self._server.handle(self._client, data)
        return text

    def _ros1(self, rng: Rng, topic: Topic) -> str:
        return self._bytes(rng, topic, ros1_encode, ros1_decode)

    def _cdr(self, rng: Rng, topic: Topic) -> str:
        return self._bytes(rng, topic, cdr_encode, cdr_decode)

    def _bytes(self, rng: Rng, topic: Topic, encode: Any, decode: Any) -> str:
        """Take damaged bytes as the transports of ROS do."""
        data = damaged(rng, encode(topic.type, self._likely(rng, topic)))
        try:
            message = decode(topic.type, data)
        except InputError as problem:
            self.core.refuse(topic, topic.name, str(problem), "ros")
        else:
            self.core.receive(topic.name, message, f"ros {rng.integers(3)}")
        return f"{topic.name}: {data.hex()}"

    # ------------------------------------------------------------------ what comes of it

    def _ticked(self, ticks: int) -> str:
        """Run ticks and publish; return what went wrong, "" where nothing did."""
        for _ in range(ticks):
            problem = self._tick()
            if problem:
                return problem
        self.core.publish_waiting()
        return ""

    def _tick(self) -> str:
        arms = self.world.arms.values()
        before = {arm.name: (arm.runtime.motors.powered, arm.joints.positions()) for arm in arms}
        self.applied.clear()
        self.loop.tick()
        data = self.world.mj_data
        if not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
            return "the state is not finite"
        if self.world.engine_warnings():
            return f"MuJoCo warns: {self.world.engine_warnings()}"
        if (data.contact.dist < OVERLAP).any() or any(map(elsewhere, self.applied)):
            return ""
        pressed = touched(self.world)
        for arm in arms:
            powered, was = before[arm.name]
            own = arm.description.own_joints
            if powered or arm.runtime.motors.powered or len(was) != len(arm.joints.names):
                continue
            if arm.name in pressed:
                continue
            inside = (arm.joints.lower < was) & (was < arm.joints.upper)
            moved = float(np.abs(arm.joints.positions() - was)[:own].max())
            if inside.all() and not moved < STILL:
                return f"{arm.name} has no power and moved by {moved:g}"
        return ""

    def _likely(self, rng: Rng, topic: Topic) -> dict[str, Any]:
        """Return a message of a topic's type that may be of use."""
        arm = self.world.arms.get(topic.arm)
        count = 1 if arm is None or "jaw" in topic.key else arm.description.own_joints
        return cast("dict[str, Any]", filled(rng, blank(topic.type), count))


class Standing:
    """A clock that stands still, so that a seed sends the same messages in the same ticks."""

    def now(self) -> float:
        """Return the moment."""
        return 0.0

    def sleep(self, seconds: float, until: threading.Event | None = None) -> None:
        """Do not wait."""


def elsewhere(command: Command) -> bool:
    """Return whether a command may put an arm elsewhere by other means than motion."""
    pins = command.act is not None and command.verb == "servo_jp"  # a joint in mode "set"
    return pins or command.verb in ELSEWHERE or command.verb.startswith("emulate_")


class Deaf:
    """Stand-in for a connection: takes what is written."""

    paused = False

    state = State.OPEN
    remote_address = ("127.0.0.1", 1)

    def __init__(self) -> None:
        self.transport = self

    def get_extra_info(self, name: str) -> Deaf:  # noqa: ARG002
        """Return itself for the socket."""
        return self

    def setsockopt(self, *_: int) -> None:
        """Do nothing."""

    def get_write_buffer_size(self) -> int:
        """Return that nothing waits."""
        return 0

    def write(self, data: bytes) -> None:
        """Forget an answer."""


# ---------------------------------------------------------------------- values


def filled(rng: Rng, value: Any, count: int, key: str = "") -> Any:
    """Return a blank message with numbers, words and so many joints in it."""
    if isinstance(value, Mapping):
        if set(value) == {"x", "y", "z", "w"}:
            turn = rng.standard_normal(4)
            return dict(zip("xyzw", (turn / np.linalg.norm(turn)).tolist(), strict=True))
        return {name: filled(rng, inner, count, name) for name, inner in value.items()}
    if isinstance(value, bool):
        return bool(rng.integers(2))
    if isinstance(value, int):
        return int(rng.integers(3))
    if isinstance(value, float):
        return float(EXTREME[rng.integers(len(EXTREME))] if rng.random() < 0.2 else rng.random())
    if isinstance(value, str):
        return "" if key == "frame_id" else str(WORDS[rng.integers(len(WORDS) - 1)])
    if isinstance(value, np.ndarray) or key in ("position", "velocity", "effort"):
        found = 0.2 * rng.standard_normal(count)
        wild = np.array([EXTREME[rng.integers(len(EXTREME))] for _ in range(count)])
        return np.where(rng.random(count) < 0.1, wild, found)
    if key == "buttons":
        return [int(rng.integers(3))]
    return value


def spoilt(rng: Rng, value: Any) -> Any:
    """Return a value with one of its leaves replaced, left out or added."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        known = cast("dict[str, Any]", value)
        key = str(rng.choice(list(known)))
        kind = rng.random()
        if kind < 0.1:
            return {name: inner for name, inner in known.items() if name != key}
        if kind < 0.2:
            return {**known, str(rng.choice(["op", "x", "secs", "name"])): leaf(rng)}
        return {**known, key: spoilt(rng, known[key])}
    if isinstance(value, list) and value and rng.random() < 0.8:
        row, at = list(cast("list[Any]", value)), int(rng.integers(len(cast("list[Any]", value))))
        row[at] = spoilt(rng, row[at])
        return row
    return leaf(rng)


def leaf(rng: Rng) -> Any:
    """Return anything."""
    return LEAVES[rng.integers(len(LEAVES))]


def damaged(rng: Rng, data: bytes) -> bytes:
    """Return bytes of which some are others, missing or more; sometimes as they are."""
    found, kind = bytearray(data), rng.random()
    if kind < 0.2:
        return data
    for _ in range(rng.integers(1, 4)):
        if found and kind < 0.7:
            found[rng.integers(len(found))] = int(rng.choice([0, 1, 127, 128, 255]))
        elif found and kind < 0.85:  # a length, as likely as not
            at = 4 * int(rng.integers(len(found) // 4 + 1))
            found[at : at + 4] = int(rng.choice([0, 2**31, 2**32 - 1, 65536])).to_bytes(4, "little")
        else:
            at = int(rng.integers(len(found) + 1))
            found[at : at + int(rng.integers(9))] = rng.bytes(int(rng.integers(9)))
    return bytes(found)
