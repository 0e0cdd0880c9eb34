"""The engine-free core of every transport: topics out, commands in.

loop's thread --samples--> publishing thread --messages--> transports
transports --messages--> checks --commands--> the loop's inbox
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

from trocar.descriptions import RigDescription
from trocar.errors import InputError, TrocarError, UnknownNameError
from trocar.interfaces.crtk import image_rows, rig_messages, scene, scene_messages, services
from trocar.interfaces.crtk.carriers import Carriers
from trocar.interfaces.crtk.clock import FIRST_NS, Mode, Stamper
from trocar.interfaces.crtk.compat import compatible
from trocar.interfaces.crtk.component import Component, install, merged
from trocar.interfaces.crtk.images import Images
from trocar.interfaces.crtk.incoming import Incoming
from trocar.interfaces.crtk.publishing import Publishing
from trocar.interfaces.crtk.robot_model import robot_model
from trocar.interfaces.crtk.sample import Sample
from trocar.interfaces.crtk.topics import Service, Topic, prefix, service_table, topic_table
from trocar.interfaces.crtk.transport import Batch, Message, Transport
from trocar.interfaces.crtk.watching import Watch
from trocar.interfaces.loop import Loop
from trocar.interfaces.pictures import Pictures
from trocar.interfaces.seldom import Seldom, more

_log = logging.getLogger("trocar")

#: Source: the seeds' joints were published so often; paper, section 3.5.2. [Hz]
RATE_HZ = 220.0
#: Source: the cameras of the da Vinci; paper, section 3.4. [Hz]
CAMERA_RATE_HZ = 60.0
#: Source: our own choice, the control rate that clients of the dVRK reach. [Hz]
RATE_MAX_HZ = 1000.0
#: Made when somebody asks for it first: it writes meshes, too.
DESCRIPTION = "robot_description"


class Core:
    """What every transport speaks for.

    Args:
        loop: the world's loop; its ticks bound how late samples are (`SERVER_TICK_S`)
        rate_hz: of states, above 0 to 1000
        camera_rate_hz: of images
        clock: "wall" or "sim": what header stamps tell
        first_ns: where simulated time begins [ns]
        compat: names of older interfaces to serve as well
        pictures: what draws for the cameras; None: there are no topics of cameras
        components: what else is served

    Attributes:
        loop, rate_hz, camera_rate_hz: as given
        topics, services: {name: row}; a row marked `later` is not served
        incoming: what becomes of messages that somebody publishes
        refused: how many messages were refused
    """

    def __init__(
        self,
        loop: Loop,
        *,
        rate_hz: float = RATE_HZ,
        camera_rate_hz: float = CAMERA_RATE_HZ,
        clock: Mode = "wall",
        first_ns: int = FIRST_NS,
        compat: Sequence[str] = (),
        components: Sequence[Component] = (),
        pictures: Pictures | None = None,
    ) -> None:
        for name, got in (("rate", rate_hz), ("camera rate", camera_rate_hz)):
            if not 0.0 < got <= RATE_MAX_HZ:
                raise InputError(f"{name}: got {got:g} Hz; allowed: above 0 to {RATE_MAX_HZ:g} Hz")
        self.loop, self.rate_hz, self.camera_rate_hz = loop, rate_hz, camera_rate_hz
        self.compat = tuple(compat)
        rig = loop.world.rig
        older = compatible(rig, compat)
        parts = merged(components)
        rows = () if pictures is None else (*image_rows.topics_of(rig), *older.cameras)
        seen = [(topic.name, topic) for topic, _ in rows]
        self.topics: Mapping[str, Topic] = MappingProxyType(
            {**{t.name: t for t in topic_table(rig)}, **older.topics, **dict(seen), **parts.topics}
        )
        self.services: Mapping[str, Service] = MappingProxyType(
            {s.name: s for s in service_table(rig)}
        )
        self.prefixes = {arm.name: prefix(arm.name, arm.arm) for arm in rig.arms}
        self.stamper = Stamper(clock, first_ns=first_ns)
        self._samples: queue.SimpleQueue[Sample | None] = queue.SimpleQueue()
        self.incoming = Incoming(self)
        for topic, ask in scene.commands(rig).items():
            self.incoming.handlers[topic] = partial(self.incoming.obey, ask)
        for topic, act in older.handlers.items():
            self.incoming.handlers[topic] = partial(act, self)
        install(components, self.incoming.handlers)
        self._watch = Watch(
            loop, self.prefixes, self.stamper, rate_hz, self._samples, self.incoming.waits
        )
        self._publishing = Publishing(
            self.topics,
            self.prefixes,
            {
                **rig_messages.makers(clock == "sim"),
                **scene_messages.makers(rig),
                **older.makers,
                **parts.makers,
            },
        )
        self._carriers, self._components = Carriers(), tuple(components)
        self._images = pictures and Images(
            pictures, loop.world, rows, camera_rate_hz, self._carriers
        )
        self._thread: threading.Thread | None = None
        self._lock, self._seldom = threading.Lock(), Seldom()
        self._ends: list[Callable[[], None]] = []
        self.refused = 0
        self._described: RigDescription | None = None

    # ------------------------------------------------------------------ life

    def attach(self, transport: Transport) -> None:
        """Serve a transport as well; started with the core, or at once when it runs."""
        self._carriers.add(transport, self)

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
        self._carriers.start(self)
        self._ends = [self.incoming.begin(), *(part.begin(self) for part in self._components)]
        rig, stamp = self.loop.world.rig, self.stamper.stamp()
        cameras = {} if self._images is None else self._images.cameras()
        self.emit("tf_static", rig_messages.tf_static(rig, stamp, cameras))
        self._watch.start()
        if self._images is not None:
            self._images.start(self._watch)

    def close(self) -> None:
        """End: no more samples, then no thread, then no transport."""
        for end in self._ends:
            end()
        if self._images is not None:
            self._images.stop()
        self._watch.stop()
        if self._thread is not None:
            self._samples.put(None)
            self._thread.join()
            self._thread = None
        self._carriers.close()

    # ------------------------------------------------------------------ in

    def receive(self, name: str, message: Message, peer: str = "") -> bool:
        """Take a message that somebody published; from any thread. Never raises.

        Args:
            name: the topic
            message: its fields
            peer: who sent it, for the log

        Returns:
            whether it was accepted; one that is refused changes nothing, and is told of on the
            arm's topic `warning`
        """
        topic = self.topics.get(name)
        try:
            if topic is None or topic.direction != "sub" or topic.later:
                raise InputError("the simulator does not listen to this topic")
            self.incoming.take(topic, message, peer)
        except InputError as problem:
            self.refuse(topic, name, str(problem), peer, getattr(problem, "kind", ""))
            return False
        except Exception:  # noqa: BLE001  whatever a message holds, everybody else goes on
            _log.exception("%s: a message could not be read", name[:80])
            self.refuse(topic, name, "could not be read", peer)
            return False
        return True

    def call(self, name: str, request: Message, timeout_s: float = 5.0) -> Message:
        """Answer a service call; from any thread but the loop's.

        Raises:
            UnknownNameError: no such service
            InputError: what is wrong with the request, or no answer in time
        """
        if name not in self.services:
            raise UnknownNameError("service", name, self.services)
        return services.answer(self, self.services[name], request, timeout_s)

    def refuse(
        self, topic: Topic | None, name: str, reason: str, peer: str = "", kind: str = ""
    ) -> None:
        """Count a refused message, and say so: once a while for each topic and kind of reason."""
        with self._lock:
            self.refused += 1
        unsaid = self._seldom.due((topic.name, kind) if topic else None, self.loop.now)
        if unsaid is None:
            return
        text = f"{topic.key if topic else name[:80]}: {reason}{more(unsaid)}"
        _log.warning("refused%s: %s: %s", f" from {peer}" if peer else "", name[:80], text)
        before = self.prefixes.get(topic.arm, "system") if topic else "system"
        self.emit(f"{before}/warning", {"data": text})

    def tell_refusals_anew(self) -> None:
        """Forget which refusals were told a moment ago."""
        self._seldom.forget()

    # ------------------------------------------------------------------ out

    def emit(self, name: str, fields: Mapping[str, Any]) -> None:
        """Publish an event with the next sample, its header added; from any thread."""
        self._watch.put(name, fields)

    def tell_state(self, arm: str) -> None:
        """Tell an arm's operating state with the next sample; in the loop's thread."""
        self._watch.tell_state(arm)

    def latched(self, name: str) -> Message | None:
        """Return the last message of a latched topic, for those who come late."""
        return self._publishing.latched.get(name)

    def publish_waiting(self) -> int:
        """Publish every sample that waits, in the calling thread; return how many."""
        count = 0
        while not self._samples.empty():
            sample = self._samples.get()
            if sample is not None:
                self._send(self._made(sample))
                count += 1
        return count

    @property
    def skipped(self) -> int:
        """How many samples were left out because publishing could not keep up."""
        return self._watch.skipped

    # ------------------------------------------------------------------ inside

    def _run(self) -> None:
        while (sample := self._samples.get()) is not None:
            batches = self._made(sample)
            if sample.due_s is not None:
                time.sleep(max(sample.due_s - self.loop.now, 0.0))
            self._send(batches)

    def _made(self, sample: Sample) -> list[tuple[Transport, Batch]]:
        """Return what each transport is to send of a sample."""
        wanted = self._carriers.wanted()
        asked = self._watch.asked = frozenset[str]().union(*(names for _, names in wanted))
        if DESCRIPTION in asked and self._thread is not None and self._described is not sample.rig:
            self._described = sample.rig  # it takes seconds: others are not to wait for it
            describe = partial(self._describe, sample.rig)
            threading.Thread(target=describe, name="trocar-urdf", daemon=True).start()
        events = self._publishing.events(sample)
        states = self._publishing.states(sample, [(t.packing, names) for t, names in wanted])
        told = zip(wanted, states, strict=True)
        return [(transport, events + own) for (transport, _), own in told]

    def _send(self, batches: Sequence[tuple[Transport, Batch]]) -> None:
        for transport, batch in batches:
            if batch:
                self._carriers.send(transport, batch)

    def _describe(self, rig: RigDescription) -> None:
        """Publish a rig as URDF, unless a tool was exchanged meanwhile."""
        try:
            text = robot_model(rig).urdf
        except TrocarError as problem:
            _log.warning("%s cannot be published: %s", DESCRIPTION, problem)
            self.emit("system/warning", {"data": f"{DESCRIPTION}: {problem}"})
        else:
            if rig is self._described:
                self.emit(DESCRIPTION, {"data": text})
