"""The mirror: simulated arms follow the joint states of a real robot, live or recorded."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, RigDescription
from trocar.errors import InputError, TrocarError
from trocar.live.inbox import Command
from trocar.live.state import Elapsed
from trocar.recording.bags import JOINT_STATE, POSES, Bag, JointMessage
from trocar.robot.recordings.topics import (
    ARM_SETPOINTS,
    ARM_STATES,
    END_SETPOINTS,
    END_STATES,
    find_topic,
    fits_names,
    live_names,
)
from trocar.ros.client import RosClient
from trocar.ros.topic import prefix

if TYPE_CHECKING:
    from trocar.live import Loop
    from trocar.simulation import World

_log = logging.getLogger("trocar")
Array = NDArray[np.float64]
By = Literal["set", "servo"]

#: Time without messages after which an arm holds, with a warning [s]. Source: our own choice.
SILENCE_S = 0.5
#: Number of the newest lags that enter the median. Source: our own choice.
NEWEST = 2000
#: Ticks between two checks for silent arms. Source: our own choice.
WATCH_TICKS = 5
#: Time from the start to the warning about arms without messages [s]. Source: our own choice.
FIRST_MESSAGE_S = 3.0


@dataclass(frozen=True)
class LiveSource:
    """A robot that is there now."""

    client: RosClient

    @property
    def name(self) -> str:
        """Its name in messages."""
        return self.client.name


@dataclass(frozen=True)
class BagSource:
    """A recording."""

    bag: Bag

    @property
    def name(self) -> str:
        """Its name in messages."""
        return self.bag.file


@dataclass(frozen=True)
class ArmReport:
    """Statistics of an arm that follows.

    Attributes:
        heard: messages
        rate_hz: messages a second
        lag_ms_median, lag_ms_max: from when a message was due (of a bag) or came (live) to when the
            arm stood there
        gaps: how often it was silent for more than half a second
        clipped, refused: messages beyond the joints' limits, and that could not be used
    """

    heard: int
    rate_hz: float
    lag_ms_median: float
    lag_ms_max: float
    gaps: int
    clipped: int
    refused: int


@dataclass(frozen=True)
class MirrorReport:
    """The result of a mirror.

    Attributes:
        source: its name
        duration_s: of the bag, or since the first message [s]
        arms: {arm: how it followed}
        missing: arms of the rig without a topic in the source
    """

    source: str
    duration_s: float
    arms: Mapping[str, ArmReport]
    missing: tuple[str, ...]


def follow(name: str, q: Array, qd: Array, by: By) -> Command:
    """Return the command that brings an arm to joint states, with its jaw or gripper.

    Args:
        name: of the arm
        q, qd: positions and velocities, (n,) [rad or m, per s]
        by: "set": put it there; "servo": let its servos follow
    """

    def act(world: World) -> None:
        arm = world.arm(name)
        own = arm.description.own_joints
        if by == "set":
            world.set_state(name, q)
        else:
            arm.servo_jp(q[:own], qd[:own])
            if arm.jaw is not None:
                arm.jaw.servo_jp(q[own:])
        if arm.gripper is not None:
            arm.gripper.squeeze_to(float(q[-1]))

    return Command(name, "mirror", stream="mirror", act=act)


def prepare(name: str, by: By) -> Command:
    """Return the command that releases an arm's brakes, and in mode "set" holds it there."""

    def act(world: World) -> None:
        arm = world.arm(name)
        if arm.description.type == "SUJ":
            arm.brakes.release()
        if by == "set":
            arm.joints.set_mode("set")

    return Command(name, "prepare", act=act)


@dataclass
class Twin:
    """One arm and the joint states received for it.

    Attributes:
        name, arm: of the rig
        q, qd: commanded positions and velocities, (n,) [rad or m, per s]
        heard: messages
        first, last: when the first and the newest one came, None before it [s]
        silent: whether no message came for too long
        gaps: how often that happened
        clipped: messages beyond the joints' limits
        refused: messages that could not be used
        unlike: names of joints that the arm does not have, of the first such message
        lags: the newest ones [s]
        lag_max: the largest of all [s]
    """

    name: str
    arm: ArmDescription
    q: Array
    qd: Array
    heard: int = 0
    first: float | None = None
    last: float | None = None
    silent: bool = False
    gaps: int = 0
    clipped: int = 0
    refused: int = 0
    unlike: tuple[str, ...] = ()
    lags: deque[float] = field(default_factory=lambda: deque(maxlen=NEWEST))
    lag_max: float = 0.0

    def take(self, joints: slice, message: Mapping[str, Any]) -> str:
        """Take the positions of a JointState; return why they cannot be used, "" where they can.

        Velocities that the message lacks are 0, and so are those of joints at their limits.
        """
        try:
            position = np.asarray(message["position"], np.float64)
            velocity = np.asarray(message.get("velocity", ()), np.float64)
            names = [str(name) for name in cast(Iterable[object], message.get("name", ()))]
        except (TypeError, ValueError, KeyError):
            position, velocity, names = np.zeros(0), np.zeros(0), []
        known = self.arm.mechanism.joint_names[joints]
        if joints.start == 0 and len(position) == len(self.q):
            joints, known = slice(0, len(self.q)), self.arm.mechanism.joint_names
        if len(position) != len(known):
            return f"got {len(position)} joints; allowed: {len(known)} ({', '.join(known)})"
        if not np.isfinite(position).all():
            return f"got {position.tolist()}; allowed: finite numbers"
        same = len(names) == len(known) and set(names) == set(known)
        order = [names.index(joint) for joint in known] if same else list(range(len(known)))
        # setup joints have names of their own on every robot
        if self.arm.type != "SUJ" and not (self.unlike or fits_names(names, known)):
            self.unlike = tuple(names)
            _log.warning("%s: joints %s taken in their order", self.name, ", ".join(names))
        wanted = position[order]
        limits = self.arm.mechanism.lower[joints], self.arm.mechanism.upper[joints]
        inside = np.clip(wanted, *limits)
        self.clipped += bool((inside != wanted).any())
        self.q[joints] = inside
        moving = len(velocity) == len(position) and bool(np.isfinite(velocity).all())
        self.qd[joints] = np.where(inside == wanted, velocity[order], 0.0) if moving else 0.0
        return ""

    def report(self) -> ArmReport:
        """Collect the statistics so far."""
        lasted = (self.last or 0.0) - (self.first or 0.0)
        rate = (self.heard - 1) / lasted if lasted > 0.0 else 0.0
        median = float(np.median(list(self.lags))) if self.lags else 0.0
        lags = round(1e3 * median, 3), round(1e3 * self.lag_max, 3)
        return ArmReport(
            self.heard, round(rate, 2), *lags, self.gaps, self.clipped, self.refused
        )  # fmt: skip


class Mirror:
    """Lets the arms of a loop follow a source; a watcher of the loop.

    Args:
        loop: steps the simulated arms
        source: of joint states
        arms: names of arms; None: all that have topics in the source
        by: "set": put where the robot is; "servo": follow it by their own servos
        topics, jaws: {arm: topic of its joint states, or of its jaw or gripper}; of other arms,
            topics are found by their names of all versions of the dVRK, in whatever namespace

    Attributes:
        twins: {arm: what was received for it}
        missing: arms of the rig without a topic in the source
        over: set at the end of a bag

    Raises:
        InputError: the source has no topic of a requested arm, or of any arm
    """

    def __init__(
        self,
        loop: Loop,
        source: BagSource | LiveSource,
        arms: Sequence[str] | None = None,
        by: By = "set",
        *,
        topics: Mapping[str, str] | None = None,
        jaws: Mapping[str, str] | None = None,
    ) -> None:
        self._loop, self._source = loop, source
        self._by: By = by
        self._bag = source.bag if isinstance(source, BagSource) else None
        rig = loop.world.rig
        self.twins: dict[str, Twin] = {}
        self.missing: list[str] = []
        self._parts: dict[str, tuple[Twin, slice]] = {}
        own = {rig.arm(name).name: topic for name, topic in (topics or {}).items()}
        ends = {rig.arm(name).name: topic for name, topic in (jaws or {}).items()}
        for name in [rig.arm(name).name for name in arms] if arms else [a.name for a in rig.arms]:
            self._subscribe(rig, name, own.get(name), ends.get(name))
        if not self.twins or (arms and self.missing):
            known: Mapping[str, str] = {} if self._bag is None else self._bag.topics
            raise InputError(_nothing(self.missing, rig, known, source.name))
        self.over = threading.Event()
        self._lock = threading.Lock()  # a live source's thread and the loop's
        self._waiting: dict[str, float] = {}
        self._messages: Iterator[JointMessage] = iter(())
        self._next: JointMessage | None = None
        self._begin, self._end, self._simulated_s = 0.0, 0.0, 0.0
        self._drained = self._named = False
        self._failure: TrocarError | None = None
        self._unwatch: Callable[[], None] = lambda: None

    def _subscribe(
        self, rig: RigDescription, name: str, topic: str | None, jaw: str | None
    ) -> None:
        """Note the topics of an arm, and of its jaw or gripper."""
        arm, where = rig.arm(name).arm, self._source.name
        topics = None if self._bag is None else self._bag.topics
        own = _found(topics, prefix(name, arm), ARM_STATES, ARM_SETPOINTS, topic, where)
        if not own:
            self.missing.append(name)
            return
        start = rig.poses["start"][name]
        twin = self.twins[name] = Twin(name, arm, start.copy(), np.zeros(len(start)))
        self._parts |= dict.fromkeys(own, (twin, slice(0, arm.own_joints)))
        last = arm.mechanism.joint_names[-1]
        names, setpoints = END_STATES.get(last), END_SETPOINTS.get(last, ())
        if names is None and jaw is not None:
            raise InputError(f"{name}: has neither a jaw nor a gripper; got {jaw}")
        if names is not None:
            others = _found(topics, prefix(name, arm), names, setpoints, jaw, where)
            end = slice(arm.own_joints, len(arm.joints))
            self._parts |= dict.fromkeys(others, (twin, end))

    def start(self) -> None:
        """Begin; the loop may run already or begin afterwards."""
        for name in self.twins:
            self._loop.post(prepare(name, self._by))
        if self._bag is not None:
            self._messages = self._bag.messages(tuple(self._parts))
            self._advance()
            self._begin = self._next.time if self._next is not None else 0.0
        self._started = time.monotonic()
        self._unwatch = self._loop.watch(self)
        if isinstance(self._source, LiveSource):
            client = self._source.client
            client.start()
            for topic in self._parts:
                client.subscribe(topic, JOINT_STATE, partial(self._receive, topic), depth=1)

    def close(self) -> None:
        """Stop following.

        Raises:
            TrocarError: the error that ended the reading of the bag
        """
        self._unwatch()
        if isinstance(self._source, LiveSource):
            self._source.client.close()
        if self._failure is not None:
            raise self._failure

    def ticked(self, elapsed: Elapsed) -> None:
        """Post the messages that are due; report silent arms."""
        with self._lock:
            arrived, self._waiting = self._waiting, {}
        now = time.monotonic() if self._bag is None else elapsed.simulated_s
        for name, due in arrived.items():
            self.twins[name].lags.append(now - due)
            self.twins[name].lag_max = max(self.twins[name].lag_max, now - due)
        if self._bag is not None:
            self._play(now)
            now += self._begin
        elif not self._named and now - self._started >= FIRST_MESSAGE_S:
            self._named = True
            for twin in self.twins.values():
                if not twin.heard:
                    _log.warning(
                        "%s: no message received yet; holding the start pose", twin.name
                    )  # fmt: skip
        if not self.over.is_set():
            self._watch_silence(now)

    def patience(self) -> int:
        """Compute the ticks until the next message is due."""
        if self._bag is None:
            return WATCH_TICKS
        if self._next is None or self._waiting:
            return 1
        ahead = self._next.time - self._begin - self._simulated_s
        return max(1, min(WATCH_TICKS, int(ahead / self._loop.tick_s)))

    def refused(self, command: Command, reason: str) -> None:
        """Do nothing: the loop reports rejected commands."""

    def report(self) -> MirrorReport:
        """Collect the statistics of all arms so far."""
        firsts = [t.first for t in self.twins.values() if t.first is not None]
        lasts = [t.last for t in self.twins.values() if t.last is not None]
        lasted = max(lasts) - min(firsts) if firsts and lasts else 0.0
        arms = {name: twin.report() for name, twin in self.twins.items()}
        return MirrorReport(self._source.name, lasted, arms, tuple(self.missing))

    def page(self) -> str:
        """Return an HTML table for the web viewer: each arm's state, rate and lag."""
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{self._state(self.twins[name])}</td>"
            f"<td>{arm.rate_hz:.0f} Hz</td><td>{arm.lag_ms_median:.1f} ms</td></tr>"
            for name, arm in self.report().arms.items()
        )
        name = self._source.name if self._bag is None else Path(self._source.name).name
        head = "<tr><th></th><th>state</th><th>rate</th><th>lag</th></tr>"
        return (
            f'<div data-trocar="mirror"><b>mirrors {escape(name)}</b>'
            f"<table>{head}{rows}</table></div>"
        )

    def _state(self, twin: Twin) -> str:
        if not twin.heard:
            return "no message yet"
        if self.over.is_set():
            return "ended, holds"
        return '<b class="bad">no message, holds</b>' if twin.silent else "follows"

    def _play(self, simulated_s: float) -> None:
        """Post every message of the bag that is due, the newest of each arm last."""
        self._simulated_s = simulated_s
        while self._next is not None and self._next.time - self._begin <= simulated_s:
            topic, self._end, fields = self._next
            self._take(topic, fields, self._end, self._end - self._begin)
            self._advance()
        if self._next is None and not self._drained:
            self._drained = True  # commands posted just now act in the next tick
        elif self._next is None and not self.over.is_set():
            self.over.set()
            if self._failure is None:
                lasted = self._end - self._begin
                _log.warning(
                    "%s: ended after %.2f s; the arms hold position", self._source.name, lasted
                )  # fmt: skip

    def _advance(self) -> None:
        """Read the next message of the bag."""
        try:
            self._next = next(self._messages, None)
        except TrocarError as failure:
            self._failure, self._next = failure, None

    def _receive(self, topic: str, fields: Mapping[str, Any]) -> None:
        """Take a message of a live source, in its own thread."""
        now = time.monotonic()
        self._take(topic, fields, now, now)

    def _take(self, topic: str, fields: Mapping[str, Any], now: float, due: float) -> None:
        """Post the command that brings an arm where a message says.

        Args:
            topic: without a leading slash
            fields: of a JointState
            now: when it came, in the source's time [s]
            due: when its arm is to be there, in the time that lags are measured in [s]
        """
        twin, joints = self._parts[topic]
        with self._lock:
            wrong = twin.take(joints, fields)
            if wrong:
                twin.refused += 1
                if twin.refused == 1:
                    _log.warning("%s: %s: %s", twin.name, topic, wrong)
                return
            by: By = self._by
            if joints.start == 0:
                if not twin.heard or twin.silent:  # it may be far from where the twin stands
                    by = "set"
                if twin.silent and twin.last is not None:
                    _log.warning(
                        "%s: messages received again after %.2f s", twin.name, now - twin.last
                    )
                twin.silent, twin.last, twin.heard = False, now, twin.heard + 1
                twin.first = now if twin.first is None else twin.first
            command = follow(twin.name, twin.q.copy(), twin.qd.copy(), by)
        self._loop.post(command)
        with self._lock:
            self._waiting.setdefault(twin.name, due)

    def _watch_silence(self, now: float) -> None:
        with self._lock:
            for twin in self.twins.values():
                if twin.last is None or twin.silent or now - twin.last <= SILENCE_S:
                    continue
                twin.silent, twin.gaps = True, twin.gaps + 1
                _log.warning(
                    "%s: no message for %.0f ms; holding position", twin.name, 1e3 * SILENCE_S
                )  # fmt: skip


def _found(
    topics: Mapping[str, str] | None,
    arm: str,
    names: Sequence[str],
    setpoints: Sequence[str],
    given: str | None,
    where: str,
) -> tuple[str, ...]:
    """Return the topics to subscribe to; none where a bag has none.

    Without a list of topics (live) they are those that a robot of any version may have. Commanded
    positions of a bag stand for measured ones that it lacks.
    """
    if given is not None:
        topic = given.lstrip("/")
        if topics is not None and topics.get(topic) != JOINT_STATE:
            known = ", ".join(f"/{t}" for t, kind in topics.items() if kind == JOINT_STATE)
            raise InputError(f"{where}: has no joint states in {given}; they are in: {known}")
        return (topic,)
    if topics is None:
        return live_names(arm, names)
    states = [topic for topic, kind in topics.items() if kind == JOINT_STATE]
    found = find_topic(states, arm, (*names, *setpoints), where)
    return () if found is None else (found,)


def _nothing(
    missing: Sequence[str], rig: RigDescription, topics: Mapping[str, str], where: str
) -> str:
    wanted = ", ".join(f"/{prefix(n, rig.arm(n).arm)}/{ARM_STATES[0]}" for n in missing)
    states = [topic for topic, kind in sorted(topics.items()) if kind == JOINT_STATE]
    found = ", ".join(f"/{topic}" for topic in (states or sorted(topics))) or "none"
    kind = "joint states" if states or not topics else "topics, none of them joint states"
    posed = not states and any(kind in POSES for kind in topics.values())
    hint = " (--topic ARM=TOPIC)" if states else ""
    hint = " (`trocar replay` reads poses of the tip)" if posed else hint
    return f"{where}: has no {wanted}; its {kind}: {found}{hint}"
