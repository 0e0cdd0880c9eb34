"""The core of every transport, without ROS: topics out, commands in.

loop's thread --samples--> publishing thread --messages--> transports
transports --messages--> Topic.read --commands--> the loop's inbox
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from math import inf
from types import MappingProxyType
from typing import Any, Protocol

import msgspec
import numpy as np

from trocar.descriptions import RigDescription
from trocar.errors import InputError, TrocarError, UnknownNameError
from trocar.live.commanders import IDLE_S
from trocar.live.images import Pictures
from trocar.live.inbox import AT_ONCE, Command
from trocar.live.loop import Loop
from trocar.ros import console, images, tf
from trocar.ros.arm_topics import arm_topics
from trocar.ros.clock import FIRST_NS, Mode, StampCheck, Stamper
from trocar.ros.message_fields import RefusedError, stamp
from trocar.ros.nearest import nearest_topic, nobody
from trocar.ros.publishing import Publishing
from trocar.ros.robot_model import robot_model
from trocar.ros.sample import Sample
from trocar.ros.sampler import Sampler
from trocar.ros.scene import scene_topics
from trocar.ros.services import LARGEST, Services, service_rows
from trocar.ros.topic import Emit, Message, Read, Service, Topic, by_name, prefix
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.rate_limit import RateLimit, burst, suffix

_log = logging.getLogger("trocar")

#: Source: the seeds' joints were published so often; paper, section 3.5.2. [Hz]
RATE_HZ = 220.0
#: Source: the cameras of the da Vinci; paper, section 3.4. [Hz]
CAMERA_RATE_HZ = 60.0
#: Source: our own choice, the control rate that clients of the dVRK reach. [Hz]
RATE_MAX_HZ = 1000.0
#: Effort and velocity set-points of a client end after so much simulated time without another.
#: Source: MoveIt Servo's default of `incoming_command_timeout`. The dVRK has none: its arms repeat
#: the last effort in every period (SAW 2.4, mtsIntuitiveResearchKitArm.cpp, control_servo_jf); its
#: watchdog of 30 ms (mtsIntuitiveResearchKit.h, WatchdogTimeout) is that of the controllers. [s]
SETPOINT_TIMEOUT_S = 0.1
#: Unknown topics that are compared with those that there are. Source: our own choice.
UNREAD = 256
#: {verb: its set-point}, of verbs with a time-out.
EXPIRING = {"servo_jf": "effort", "servo_cf": "wrench", "servo_jv": "v"}
#: Made for its first subscriber, since its meshes are written too.
DESCRIPTION = "robot_description"

Batch = Sequence[tuple[Topic, Any]]


class Transport(Protocol):
    """Carries messages between the core and programs; each has threads of its own."""

    #: "websocket", "ros1", ...
    name: str

    def start(self, core: Core) -> None:
        """Begin; `core` takes messages and calls from any thread from now on."""
        ...

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics with subscribers now; called every period."""
        ...

    def send(self, batch: Batch) -> None:
        """Hand on messages of one period, without waiting; they must not be changed.

        They are those that were wanted, and every event, wanted or not: a transport leaves out
        what it does not serve.
        """
        ...

    def close(self) -> None:
        """End, and release sockets and threads."""
        ...


@dataclass(frozen=True)
class Component:
    """Topics of a component that is served beside the arms.

    Attributes:
        topics: rows by name, with what makes or reads their messages; rows of the same name that
            come `later` are then there
        begin: called when the core begins; returns what ends it
        reads: {topic of the core: reads its messages into further commands}
    """

    topics: Mapping[str, Topic]
    begin: Callable[[Core], Callable[[], None]]
    reads: Mapping[str, Read] = field(default_factory=dict[str, Read])


class Core:
    """Topics and services of a running world, for every transport.

    Args:
        loop: the world's loop; its ticks bound how late samples are (`SERVER_TICK_S`)
        rate_hz: of states, above 0 to 1000
        camera_rate_hz: of images
        clock: "wall" or "sim": time of header stamps
        first_ns: where simulated time begins [ns]
        pictures: what draws for the cameras; None: there are no topics of cameras
        components: served beside the arms
        exclusive: reject commands for an arm that another client commands, all but `AT_ONCE`
        setpoint_timeout_s: simulated time after which an arm holds that a client commanded by an
            effort, a wrench or velocities other than zero, and that got no further command [s];
            0: never, as on the dVRK

    Attributes:
        loop, rate_hz, camera_rate_hz: as given
        topics, services: {name: row}; a row marked `later` is not served
        refused: how many messages were rejected
    """

    def __init__(
        self,
        loop: Loop,
        *,
        rate_hz: float = RATE_HZ,
        camera_rate_hz: float = CAMERA_RATE_HZ,
        clock: Mode = "wall",
        first_ns: int = FIRST_NS,
        components: Sequence[Component] = (),
        pictures: Pictures | None = None,
        exclusive: bool = False,
        setpoint_timeout_s: float = SETPOINT_TIMEOUT_S,
    ) -> None:
        if not 0.0 <= setpoint_timeout_s < inf:
            raise InputError(
                f"set-point time-out: got {setpoint_timeout_s:g} s; allowed: 0 or more"
            )
        self._setpoint_timeout_s = setpoint_timeout_s
        for name, got in (("rate", rate_hz), ("camera rate", camera_rate_hz)):
            if not 0.0 < got <= RATE_MAX_HZ:
                raise InputError(f"{name}: got {got:g} Hz; allowed: above 0 to {RATE_MAX_HZ:g} Hz")
        self.loop, self.rate_hz, self.camera_rate_hz = loop, rate_hz, camera_rate_hz
        loop.commanders.exclusive = exclusive
        self._components = tuple(components)
        rig, self._arms = loop.world.rig, loop.world.arms
        self.prefixes = {arm.name: prefix(arm.name, arm.arm) for arm in rig.arms}
        self._bedside = console.Bedside(self.emit)
        seen: tuple[tuple[Topic, images.Origin], ...] = ()
        if pictures is not None:
            seen = tuple(images.camera_topics(rig, overlaid=pictures.overlay is not None))
        topics = by_name(topic_table(rig, self.emit, self._bedside))
        topics |= by_name(topic for topic, _ in seen)
        for part in self._components:
            topics |= part.topics
        for part in self._components:
            for name, read in part.reads.items():
                topics[name] = replace(topics[name], read=_both(topics[name].read, read))
        if clock == "sim":
            topics["clock"] = replace(topics["clock"], make=tf.clock)
        self.topics: Mapping[str, Topic] = MappingProxyType(topics)
        self.services = MappingProxyType({row.name: row for row in service_table(rig)})
        self.stamper = Stamper(clock, first_ns=first_ns)
        self._stamps, self._services = StampCheck(), Services(loop, self.stamper)
        self._samples: queue.SimpleQueue[Sample | None] = queue.SimpleQueue()
        scripted = {prop.name: f"scene/{prop.name}" for prop in rig.objects if prop.script}
        heard = {**self.prefixes, **scripted}
        self._sampler = Sampler(loop, heard, self.stamper, rate_hz, self._samples, self._report)
        self._publishing = Publishing(topics, self.prefixes, lambda: loop.now)
        self._waiting: list[Transport] = []
        self._running: tuple[Transport, ...] = ()
        self._begun = False
        self._broken: set[str] = set()
        self._images = pictures and images.Images(
            pictures, loop.world, seen, camera_rate_hz, self._wanted, self._hand
        )
        self._thread: threading.Thread | None = None
        self._lock, self._rate_limit, self._noted = threading.Lock(), RateLimit(), RateLimit(inf)
        self._ends: list[Callable[[], None]] = []
        self.refused = 0
        self._unread: dict[str, str] = {}
        self._described: RigDescription | None = None

    # ------------------------------------------------------------------ life

    def attach(self, transport: Transport) -> None:
        """Serve a transport as well; started with the core, or at once when it runs."""
        if self._begun:
            transport.start(self)
            self._running += (transport,)
        else:
            self._waiting.append(transport)

    def start(self) -> None:
        """Start transports, and publish in a thread of its own.

        Raises:
            TrocarError: a transport cannot start; none of the others runs then
        """
        self.begin()
        self._thread = threading.Thread(target=self._run, name="trocar-publish", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """Start transports and watch the loop; `publish_waiting` is then up to the caller."""
        with ExitStack() as started:
            for transport in self._waiting:
                transport.start(self)
                started.callback(transport.close)
            started.pop_all()
        self._running, self._begun = tuple(self._waiting), True
        console.begin(self.emit)
        self._ends = [
            self._bedside.begin(self.loop),
            *(part.begin(self) for part in self._components),
        ]
        rig, now = self.loop.world.rig, self.stamper.stamp()
        cameras: Mapping[str, CameraRecord] = {}
        if self._images is not None:
            cameras = self._images.cameras()
        self.emit("tf_static", tf.tf_static(rig, now, cameras))
        self._sampler.start()
        if self._images is not None:
            self._images.start(self._sampler)

    def close(self) -> None:
        """End: no more samples, then no thread, then no transport."""
        for end in self._ends:
            end()
        if self._images is not None:
            self._images.stop()
        self._sampler.stop()
        if self._thread is not None:
            self._samples.put(None)
            self._thread.join()
            self._thread = None
        running, self._running = self._running, ()
        for transport in reversed(running):
            transport.close()

    # ------------------------------------------------------------------ in

    def receive(self, name: str, message: Mapping[str, Any], peer: str = "") -> bool:
        """Take a message that a client published; from any thread. Never raises.

        Args:
            name: the topic
            message: its fields
            peer: the client that sent it; "" for one inside the simulator, to which neither
                `exclusive` nor the time-out of set-points applies

        Returns:
            whether it was accepted; a rejected one changes nothing, and is reported on the arm's
            topic `warning`
        """
        topic = self.topics.get(name)
        try:
            if topic is None or topic.read is None or topic.later:
                raise InputError("the simulator does not subscribe to this topic")
            sent = stamp(message) if topic.stamped else None
            if sent is not None:
                self._stamps.check((topic.name, peer), sent, self.loop.now)
            arm = self._arms[topic.arm].runtime if topic.arm else None
            found = topic.read(message, arm.description if arm else None)
            for command in (found,) if isinstance(found, Command) else found:
                if peer and command.arm in self._arms and command.verb not in AT_ONCE:
                    others = self.loop.commanders.claim(command.arm, peer)
                    if others:
                        self._share(command.arm, peer, others)
                    if command.verb in EXPIRING and self._setpoint_timeout_s:
                        command = expiring(command, self._setpoint_timeout_s)
                if not self.loop.post(command):
                    raise RefusedError("full", "too many pending commands")
                if command.note:
                    self._note(command, peer)
            if sent is not None:
                self._stamps.remember((topic.name, peer), sent, self.loop.now)
        except InputError as problem:
            self.refuse(topic, name, str(problem), peer, getattr(problem, "kind", ""))
            return False
        except Exception:  # noqa: BLE001  a hostile message must not stop the others
            _log.exception("%s: cannot read a message", name[:80])
            self.refuse(topic, name, "cannot be read", peer)
            return False
        return True

    def decoded(
        self, topic: Topic, data: bytes, decode: Callable[[str, bytes], Message], peer: str
    ) -> Message | None:
        """Decode a client's message; reject one that is too large or not of the topic's type."""
        try:
            if len(data) > LARGEST:
                raise InputError(f"got {len(data)} bytes; allowed: up to {LARGEST}")
            return decode(topic.type, data)
        except InputError as problem:
            self.refuse(topic, topic.name, str(problem), peer)
            return None

    def unread(self, names: Iterable[str], peer: str) -> str:
        """Report topics that a client publishes and no arm has, once each; from any thread.

        Args:
            names: of topics, without a leading slash; those that the simulator has do not count
            peer: the client

        Returns:
            the topic that the last name stands for, "" without one
        """
        near = ""
        for name in names:
            if name in self.topics:
                near = ""
                continue
            near = self._unread.get(name, "")
            if name in self._unread or len(self._unread) >= UNREAD:
                continue
            near = self._unread[name] = nearest_topic(name, self.topics, "sub")
            if near:
                text = nobody(name, self.topics, "sub")
                _log.warning("%s: %s", peer, text)
                self.emit("system/warning", {"data": text})
        return near

    def disconnected(self, peer: str) -> None:
        """Note that a client has left: it commands no arm any longer; from any thread."""
        self.loop.commanders.left(peer)

    def press(self, pedal: str, pressed: bool) -> bool:
        """Press or release a foot pedal ("clutch", "camera", "coag", ...), as if by hand.

        Raises:
            UnknownNameError: no such pedal
        """
        if pedal not in console.PEDALS:
            raise UnknownNameError("pedal", pedal, console.PEDALS)
        return self.receive(f"footpedals/emulate_{pedal}", {"axes": [], "buttons": [int(pressed)]})

    def call(self, name: str, request: Message, timeout_s: float = 5.0) -> Message:
        """Answer a service call; from any thread but the loop's.

        Raises:
            UnknownNameError: no such service
            InputError: what is wrong with the request, or no answer in time
        """
        if name not in self.services:
            raise UnknownNameError("service", name, self.services)
        return self._services.answer(self.services[name], request, timeout_s)

    def refuse(
        self, topic: Topic | None, name: str, reason: str, peer: str = "", kind: str = ""
    ) -> None:
        """Count and report a rejected message, those of streams once in a while."""
        with self._lock:
            self.refused += 1
        seen = (topic.name, kind) if topic else None
        unsaid = self._rate_limit.due(seen, self.loop.now, burst(topic.key if topic else ""))
        if unsaid is None:
            return
        text = reason + suffix(unsaid)
        _log.warning("rejected%s: %s: %s", f" from {peer}" if peer else "", name[:80], text)
        before = self._warner(topic) if topic else "system"
        self.emit(f"{before}/warning", {"data": f"{topic.key if topic else name[:80]}: {text}"})

    def forget_refusals(self) -> None:
        """Forget which rejections were reported: the next ones are reported at once."""
        self._rate_limit.forget()
        self._noted.forget()

    # ------------------------------------------------------------------ out

    def emit(self, name: str, fields: Mapping[str, Any]) -> None:
        """Publish an event with the next sample, its header added; from any thread."""
        self._sampler.put(name, fields)

    def latched(self, name: str) -> Message | None:
        """Return the latched message of a topic for new subscribers; None before the first."""
        return self._publishing.last(name)

    def publish_waiting(self) -> int:
        """Publish every sample that waits, in the calling thread; return how many."""
        count = 0
        while not self._samples.empty():
            sample = self._samples.get()
            if sample is not None:
                self._send(self._made(sample))
                count += 1
        return count

    def patience(self) -> int:
        """Return in how many ticks the next one matters to commands, 1 at least."""
        return 1 if self.loop.restless else self._bedside.patience()

    @property
    def skipped(self) -> int:
        """Number of samples that were left out because publishing could not keep up."""
        return self._sampler.skipped

    @property
    def backlog(self) -> dict[str, int]:
        """Sizes of what clients can fill: stamps, pending events, kinds of rejections."""
        return {
            "stamps": len(self._stamps),
            "events": self._sampler.events_waiting,
            "rejections": len(self._rate_limit),
        }

    # ------------------------------------------------------------------ inside

    def _note(self, command: Command, peer: str) -> None:
        """Report what is odd about a message that was accepted, once for each client and topic."""
        if self._noted.due((command.topic, peer), self.loop.now) is not None:
            _log.warning("%s from %s: %s", command.topic, peer or "the simulator", command.note)
            topic = self.topics[command.topic]
            warning = f"{self._warner(topic)}/warning"
            self.emit(warning, {"data": f"{topic.key}: {command.note}"})

    def _warner(self, topic: Topic) -> str:
        """Return the prefix of an arm's or a component's warnings, "system" of other topics."""
        component = topic.name.partition("/")[0]
        own = component if f"{component}/warning" in self.topics else "system"
        return self.prefixes.get(topic.arm, own)

    def _share(self, arm: str, peer: str, others: Sequence[str]) -> None:
        """Report that several clients command an arm.

        Raises:
            RefusedError: arms are exclusive
        """
        if self.loop.commanders.exclusive:
            raise RefusedError(
                "exclusive",
                f"{arm} is commanded by {', '.join(others)}; allowed (--exclusive): disable and"
                f" pause, and the rest once it disconnects or sends nothing for {IDLE_S:g} s",
            )
        unsaid = self._rate_limit.due((arm, "commanders"), self.loop.now)
        if unsaid is not None:
            text = f"{peer} commands {arm} beside {', '.join(others)}: the newest command counts"
            _log.warning("%s%s", text, suffix(unsaid))
            self.emit(f"{self.prefixes[arm]}/warning", {"data": text + suffix(unsaid)})

    def _report(self, command: Command, reason: str) -> None:
        """Report a command that was rejected when it was applied."""
        if command.topic:
            topic = self.topics.get(command.topic)
            kind = "" if topic is None or topic.arm else reason  # of streams one reason is enough
            self.refuse(topic, command.topic, reason, kind=kind)
            return
        before = self.prefixes.get(command.arm, "system")
        unsaid = self._rate_limit.due((before, reason), self.loop.now, burst(command.verb))
        if unsaid is not None:
            self.emit(f"{before}/warning", {"data": reason + suffix(unsaid)})

    def _run(self) -> None:
        while (sample := self._samples.get()) is not None:
            batches = self._made(sample)
            if sample.due_s is not None and (early := sample.due_s - self.loop.now) > 0.0:
                time.sleep(early)
            self._send(batches)

    def _made(self, sample: Sample) -> list[tuple[Transport, Batch]]:
        """Make the messages of a sample for each transport."""
        wanted = self._wanted()
        every = self._sampler.wanted = frozenset[str]().union(*(names for _, names in wanted))
        if DESCRIPTION in every and self._thread is not None and self._described is not sample.rig:
            self._described = sample.rig  # it takes seconds, which the other topics must not wait
            describe = partial(self._describe, sample.rig)
            threading.Thread(target=describe, name="trocar-urdf", daemon=True).start()
        events = self._publishing.events(sample)
        states = self._publishing.states(sample, [names for _, names in wanted])
        return [(pair[0], events + own) for pair, own in zip(wanted, states, strict=True)]

    def _send(self, batches: Iterable[tuple[Transport, Batch]]) -> None:
        for transport, batch in batches:
            if batch:
                self._hand(transport, batch)

    def _wanted(self) -> list[tuple[Transport, frozenset[str]]]:
        """Return each running transport with the topics that have subscribers."""
        found: list[tuple[Transport, frozenset[str]]] = []
        for transport in self._running:
            try:
                found.append((transport, transport.wanted()))
            except Exception:  # noqa: BLE001  logged whole
                self._complain(transport)
        return found

    def _hand(self, transport: Transport, batch: Batch) -> None:
        """Hand a batch over; a transport that breaks does not end the others' messages."""
        try:
            transport.send(batch)
        except Exception:  # noqa: BLE001  logged whole
            self._complain(transport)

    def _complain(self, transport: Transport) -> None:
        """Log what was raised just now, once for each transport."""
        if transport.name not in self._broken:
            self._broken.add(transport.name)
            _log.exception("%s: messages lost", transport.name)

    def _describe(self, rig: RigDescription) -> None:
        """Publish a rig as URDF, unless a tool was exchanged meanwhile."""
        try:
            text = robot_model(rig).urdf
        except TrocarError as problem:
            _log.warning("cannot publish %s: %s", DESCRIPTION, problem)
            self.emit("system/warning", {"data": f"{DESCRIPTION}: {problem}"})
        else:
            if rig is self._described:
                self.emit(DESCRIPTION, {"data": text})


def expiring(command: Command, timeout_s: float) -> Command:
    """Return an effort or velocity command with a time-out; one of zeros as it is.

    Without efforts an arm is free, without velocities it stands: neither needs a client.
    """
    if not np.any(command.kwargs.get(EXPIRING[command.verb], 0.0)):
        return command
    return msgspec.structs.replace(command, kwargs={**command.kwargs, "timeout_s": timeout_s})


def topic_table(
    rig: RigDescription,
    emit: Emit = lambda _topic, _fields: None,
    bedside: console.Bedside | None = None,
) -> tuple[Topic, ...]:
    """Return every topic of a rig, those that come later included.

    Args:
        rig: the rig
        emit: publishes an event
        bedside: does what is no verb of an arm; its own when omitted
    """
    beside = bedside or console.Bedside(emit)
    arms = (arm_topics(arm, beside.acts(arm.arm.type)) for arm in rig.arms)
    later = (replace(row, later=True) for row in console.teleop_topics(rig.teleops))
    rows = chain(
        *arms,
        console.statistics_topics(rig),
        tf.viewer_topics(),
        console.console_topics(rig, emit),
        scene_topics(rig),
        later,
    )
    return tuple(by_name(rows).values())  # each name once: arms of a kind share some


def service_table(rig: RigDescription) -> tuple[Service, ...]:
    """Return every service of a rig."""
    return tuple(
        replace(row, name=f"{prefix(arm.name, arm.arm)}/{row.key}", arm=arm.name)
        for arm in rig.arms
        for row in service_rows(arm.arm)
    )


def _both(first: Read | None, then: Read) -> Read:
    """Return a reader whose commands are those of two readers."""

    def read(message: Mapping[str, Any], arm: Any) -> list[Command]:
        found: list[Command] = []
        for part in filter(None, (first, then)):
            commands = part(message, arm)
            found += [commands] if isinstance(commands, Command) else commands
        return found

    return read
