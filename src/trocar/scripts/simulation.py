"""A simulation beneath a script: `Stepped` in simulated time, or `Live` at the wall clock's pace.

script -> crtk.ral -> Node -> Bus -> Core -> the loop of a World
"""

# Public attributes of genpy's classes begin with an underscore.
# pyright: reportPrivateUsage=false

from __future__ import annotations

import logging
import queue
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from math import ceil, inf
from typing import Any

from trocar.live.images import Pictures
from trocar.live.loop import SERVER_TICK_S, Loop
from trocar.live.pace import nearest_tick
from trocar.ros.clock import SECOND, Beat
from trocar.ros.core import Batch, Component, Core
from trocar.ros.nearest import nobody
from trocar.ros.sample import Sample, SampleReadings
from trocar.ros.topic import Topic
from trocar.scripts.messages import Message, fields_of, message_of
from trocar.scripts.virtual_time import Scheduler
from trocar.simulation import World
from trocar.simulation.readout import Reader

_log = logging.getLogger("trocar")

#: Origin of a rejected message in the core's warnings.
PEER = "the script"
#: A subscription that nothing publishes to is reported after so long. Source: our own choice: the
#: script's own publishers are made by then. [s]
SILENT_S = 1.0
Call = Callable[[Callable[[], None]], None]
#: Makes what is served beside the arms, of the loop.
Parts = Callable[[Loop], Sequence[Component]]
#: Makes what draws for the cameras, of the loop; None: there are no topics of cameras.
Draw = Callable[[Loop], Pictures | None]


class Subscription:
    """A function that is called with each message of a topic.

    Args:
        name: of the topic, without the first slash
        kind: class of the messages
        heard: called with each message
        size: how many messages may wait; the oldest are lost beyond
        at_once: called in the publishing thread, where the simulation waits for it
        late: whether it begins with the last message of a topic
    """

    def __init__(
        self,
        name: str,
        kind: type[Message],
        heard: Callable[[Any], None],
        size: int | None = None,
        at_once: bool = False,
        late: bool = True,
    ) -> None:
        self.name, self.kind, self.at_once, self.late = name, kind, at_once, late
        self._heard = heard
        self._waiting: deque[Any] = deque(maxlen=size or None)
        self._busy = False

    def put(self, message: Any, later: Call) -> None:
        """Have the function called with a message, once those before are done with."""
        if self.at_once:
            self._heard(message)
            return
        self._waiting.append(message)
        if not self._busy:
            self._busy = True
            later(self._work)

    def _work(self) -> None:
        try:
            while self._waiting:
                self._heard(self._waiting.popleft())
        finally:
            self._busy = False


class MessageBus:
    """Carries messages between the core and a script, and from the script to itself.

    Args:
        later: has a function called where the script's functions may be called

    Attributes:
        posted: whether a published message waits for the next tick
    """

    name = "script"

    def __init__(self, later: Call) -> None:
        self._later = later
        self._lock = threading.Lock()
        self._subscriptions: dict[str, tuple[Subscription, ...]] = {}
        self._publishers: dict[str, int] = {}
        self._wanted: frozenset[str] = frozenset()
        self._awaited: dict[str, float] = {}
        self._unread: set[str] = set()
        self.posted = False

    def start(self, core: Core) -> None:
        """Begin."""
        self._core = core

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that the script subscribes to."""
        if self._awaited:
            self._report_silent(self._core.stamper.elapsed_s - SILENT_S)
        return self._wanted

    def send(self, batch: Batch) -> None:
        """Hand messages on: events first, as they came, then states by name."""
        events = [pair for pair in batch if pair[0].rate == "event"]
        states = sorted((p for p in batch if p[0].rate != "event"), key=lambda pair: pair[0].name)
        for topic, fields in (*events, *states):
            for subscription in self._subscriptions.get(topic.name, ()):
                if subscription.kind._type == topic.type:
                    subscription.put(message_of(subscription.kind, fields), self._later)

    def close(self) -> None:
        """End; report the topics that nothing published."""
        self._report_silent(inf)
        self._subscriptions = {}

    def subscribe(self, subscription: Subscription) -> None:
        """Subscribe to a topic; it begins with the last message, if it is latched or periodic."""
        name, kind = subscription.name, subscription.kind
        self._keep(name, (*self._subscriptions.get(name, ()), subscription))
        topic = self._served(name, kind, "pub")
        if topic is None:
            self._warn(name, kind, "pub")
            self._awaited.setdefault(name, self._core.stamper.elapsed_s)
        last = None if topic is None or not subscription.late else self._core.latched(name)
        if last is not None:
            subscription.put(message_of(kind, last), self._later)

    def unsubscribe(self, subscription: Subscription) -> None:
        """Unsubscribe."""
        kept = self._subscriptions.get(subscription.name, ())
        self._keep(subscription.name, tuple(x for x in kept if x is not subscription))

    def advertise(self, name: str, kind: type[Message]) -> None:
        """Note that the script may publish to a topic."""
        self._publishers[name] = self._publishers.get(name, 0) + 1
        self._warn(name, kind, "sub")

    def publish(self, name: str, message: Message) -> None:
        """Publish a message of the script's."""
        fields = fields_of(message)
        if self._served(name, type(message), "sub") is not None:
            self.posted |= self._core.receive(name, fields, PEER)
        for subscription in self._subscriptions.get(name, ()):
            if subscription.kind is type(message):
                subscription.put(message_of(subscription.kind, fields), self._later)
        if name not in self._unread and not self.subscribers(name, None):
            self._unread.add(name)
            _log.warning("%s", nobody(name, self._core.topics, "sub"))

    def subscribers(self, name: str, kind: type[Message] | None) -> int:
        """Count the subscribers of a topic that the script publishes; None: of any type."""
        return len(self._subscriptions.get(name, ())) + self.listens(name, kind)

    def publishers(self, name: str, kind: type[Message] | None) -> int:
        """Count the publishers of a topic that the script subscribes to; None: of any type."""
        return self._publishers.get(name, 0) + self.speaks(name, kind)

    def listens(self, name: str, kind: type[Message] | None) -> bool:
        """Return whether the simulator subscribes to a topic."""
        return self._served(name, kind, "sub") is not None

    def speaks(self, name: str, kind: type[Message] | None) -> bool:
        """Return whether the simulator publishes a topic."""
        return self._served(name, kind, "pub") is not None

    def latches(self, name: str) -> bool:
        """Return whether late subscribers of the simulator's topic get its last message."""
        return self._core.topics[name].latched

    def _report_silent(self, before_s: float) -> None:
        """Warn of topics that were subscribed to before a time, and that nothing publishes."""
        for name, since in tuple(self._awaited.items()):
            if since <= before_s:
                del self._awaited[name]
                if self._subscriptions.get(name) and not self.publishers(name, None):
                    _log.warning("%s", nobody(name, self._core.topics, "pub"))

    def _keep(self, name: str, subscriptions: tuple[Subscription, ...]) -> None:
        with self._lock:
            self._subscriptions[name] = subscriptions
            self._wanted = frozenset(n for n, found in self._subscriptions.items() if found)

    def _served(self, name: str, kind: type[Message] | None, direction: str) -> Topic | None:
        """Return the simulator's end of a topic, None where it has none of that type."""
        topic = self._core.topics.get(name)
        if topic is None or topic.later or topic.direction != direction:
            return None
        return topic if kind is None or topic.type == kind._type else None

    def _warn(self, name: str, kind: type[Message], direction: str) -> None:
        """Log that the simulator has a topic of that name with another type."""
        topic = self._core.topics.get(name)
        if topic is None or topic.later or topic.direction != direction or topic.type == kind._type:
            return
        _log.warning("/%s has type %s, but the script uses %s", name, topic.type, kind._type)


#: A script's time begins here: a client that asks how old a message is that never came, with its
#: stamp of zero, has to find it older than it has patience for. Source: our own choice. [ns]
FIRST_NS = 1000 * SECOND


class TickClock:
    """A clock that stands still between ticks."""

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        """Return seconds since the first tick."""
        return self.time

    def sleep(self, seconds: float, until: threading.Event | None = None) -> None:  # noqa: ARG002
        """Let seconds pass."""
        self.time += seconds


class Stepped:
    """Steps a world in its script's thread, whenever that waits.

    Args:
        world: used by this object alone
        limit_s: simulated time after which the script has to be over [s]; None: none
        parts: makes what is served beside the arms, of the loop
        draw: makes what draws for the cameras, of the loop
        pace: simulated time over wall time, if the machine keeps up; None: as fast as it goes
        rates: `rate_hz` and the like of the `Core`

    Attributes:
        world, core, bus: its parts
        scheduler: threads of the script; its `wait`, `sleep` and `look` are the simulation's
        steps: ticks so far; a watchdog sees by them that something goes on
    """

    virtual = True

    def __init__(
        self,
        world: World,
        limit_s: float | None = None,
        parts: Parts = lambda _: (),
        draw: Draw = lambda _: None,
        pace: float | None = None,
        **rates: Any,
    ) -> None:
        self.world, self._pace, self._begun = world, pace, 0.0
        self._clock = TickClock()
        tick_s = nearest_tick(SERVER_TICK_S, world.timestep)
        self._loop = Loop(world, speed="max", tick_s=tick_s, clock=self._clock)
        components = parts(self._loop)
        self._alone = not components
        self._pictures = draw(self._loop)
        self.core = Core(
            self._loop,
            clock="sim",
            first_ns=FIRST_NS,
            components=components,
            pictures=self._pictures,
            setpoint_timeout_s=0.0,  # as on the dVRK: a script ends with its simulation
            **rates,
        )
        self.bus = MessageBus(self._later)
        self.core.attach(self.bus)
        self._beat = Beat(self.core.rate_hz)
        self._calls: deque[Callable[[], None]] = deque()
        self._reader = Reader(world.model)
        self._seen: SampleReadings | None = None
        self._limit_s, self.steps = limit_s, 0
        self._tick_ns = round(tick_s * SECOND)
        self.scheduler = Scheduler(self._clock_ns, self._step, self._tick_ns)
        self.wait, self.sleep, self.look = (
            self.scheduler.wait,
            self.scheduler.sleep,
            self.scheduler.look,
        )
        self.over: Callable[[], BaseException] = TimeoutError

    def start(self) -> None:
        """Start, and let the first tick pass, so that every topic has a message."""
        self.core.begin()
        self._step(None)

    def close(self) -> None:
        """End."""
        self.core.close()
        if self._pictures is not None:
            self._pictures.close()
        self._loop.close()

    @property
    def simulated_s(self) -> float:
        """Time that has passed [s]."""
        return self.core.stamper.elapsed_s

    def _clock_ns(self) -> int:
        """Return the time of the last tick [ns]."""
        return FIRST_NS + self.steps * self._tick_ns

    def now_ns(self) -> int:
        """Return the time that the next stamp is not before [ns]: that, or nanoseconds later."""
        seconds, rest = self.core.stamper.now()
        return seconds * SECOND + rest

    def peek(self, name: str) -> dict[str, Any] | None:
        """Return the message that a periodic topic of an arm would have now."""
        topic = self.core.topics[name]
        if topic.make is None or not topic.arm:
            return None
        if self._seen is None:
            if self._reader.model is not self.world.model:  # a tool was exchanged
                self._reader = Reader(self.world.model)
            sample = Sample(self.core.stamper.now(), self.simulated_s, self.world.sample())
            self._seen = SampleReadings(sample, self._reader.read(sample.world))
        return topic.make(self._seen, self._seen.sample.stamp)

    def fail(self, failure: BaseException) -> None:
        """End the run from another thread: the script meets this error when it waits next."""
        self.scheduler.failure = failure

    def _step(self, most_ns: int | None) -> None:
        """Let time pass until messages were sent, and call their subscribers."""
        if self._limit_s is not None and self.simulated_s >= self._limit_s:
            raise self.over()
        ticks = self._ticks(most_ns)
        self._seen = None
        self._loop.tick(ticks)
        self._clock.sleep(ticks * self._loop.tick_s)
        self.steps += ticks
        if self._pace is not None:
            self._keep_to(self._pace)
        if self._beat.due(self.simulated_s):
            self.core.publish_waiting()
        while self._calls:
            call = self._calls.popleft()
            try:
                call()
            except Exception as problem:
                if problem is self.scheduler.failure:
                    raise
                complain()

    def _keep_to(self, pace: float) -> None:
        """Wait until wall time has come to simulated time over `pace`; lost time is not made up."""
        now = time.perf_counter()
        due = self._begun + self.simulated_s / pace
        self._begun = max(self._begun, now - self.simulated_s / pace)
        time.sleep(max(0.0, due - now))

    def _ticks(self, most_ns: int | None) -> int:
        """Return the number of ticks to step together: waiting commands act in the first."""
        if self.bus.posted:
            self.bus.posted = False
            return 1
        sample = ceil(self._beat.left(self.simulated_s) / self._loop.tick_s)
        patience = self.core.patience() if self._alone else self._loop.quiet_ticks()
        ticks = max(1, int(min(sample, patience)))
        return ticks if most_ns is None else min(ticks, max(1, -(-most_ns // self._tick_ns)))

    def _later(self, call: Callable[[], None]) -> None:
        """Have a function of the script called when time passes next."""
        self._calls.append(call)


def complain() -> None:
    """Print the error of a callback."""
    sys.stderr.write("bad callback:\n")
    traceback.print_exc()


#: Period at which a wait checks its condition [s]. Source: our own choice.
LOOK_S = 0.002


class Live:
    """Steps a world in a thread of its own; functions of the script are called in another.

    Args:
        world: used by this object alone
        begin: starts the loop, and a viewer of it where there is one
        parts: makes what is served beside the arms, of the loop
        draw: makes what draws for the cameras, of the loop
        rates: `rate_hz` and the like of the `Core`

    Attributes:
        world, core, bus: what it is made of
        loop: the world's loop
    """

    virtual = False

    def __init__(
        self,
        world: World,
        begin: Callable[[Loop], None] = Loop.start,
        parts: Parts = lambda _: (),
        draw: Draw = lambda _: None,
        **rates: Any,
    ) -> None:
        self.world, self._begin = world, begin
        self.loop = Loop(world, tick_s=nearest_tick(SERVER_TICK_S, world.timestep))
        components = parts(self.loop)
        self._pictures = draw(self.loop)
        self.core = Core(
            self.loop,
            components=components,
            pictures=self._pictures,
            setpoint_timeout_s=0.0,
            **rates,
        )
        self.bus = MessageBus(self._later)
        self.core.attach(self.bus)
        self._calls: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="trocar-callbacks", daemon=True)
        self._failure: BaseException | None = None

    def start(self) -> None:
        """Start, and wait for the first tick."""
        if self._pictures is not None:
            self._pictures.start()
        self.core.start()
        self._thread.start()
        self._begin(self.loop)
        self.wait(lambda: self.core.stamper.elapsed_s > 0.0, 10.0)

    def close(self) -> None:
        """End, and stop every thread."""
        self._calls.put(None)
        self.core.close()
        if self._pictures is not None:
            self._pictures.close()
        self.loop.close()

    @property
    def steps(self) -> int:
        """Ticks that a watchdog watches: none, as time goes on by itself."""
        return 0

    @property
    def simulated_s(self) -> float:
        """Time that has passed [s]."""
        return self.core.stamper.elapsed_s

    def now_ns(self) -> int:
        """Return the time of stamps [ns]."""
        seconds, rest = self.core.stamper.now()
        return seconds * SECOND + rest

    def look(self) -> None:
        """Raise what ended the run, if something did."""
        if self._failure is not None:
            raise self._failure
        if not self.loop.running:
            self.loop.wait()  # raises what stopped it

    def wait(self, ready: Callable[[], bool], timeout_s: float | None) -> bool:
        """Wait until something holds; return whether it does."""
        end = float("inf") if timeout_s is None else time.monotonic() + timeout_s
        while not ready():
            self.look()
            left = end - time.monotonic()
            if left <= 0.0:
                return ready()
            time.sleep(min(LOOK_S, left))
        return True

    def sleep(self, seconds: float) -> None:
        """Wait for some time [s]."""
        self.look()
        time.sleep(max(0.0, seconds))

    def peek(self, name: str) -> dict[str, Any] | None:  # noqa: ARG002  as the stepped one has it
        """Return None: readings come as messages."""
        return None

    def fail(self, failure: BaseException) -> None:
        """End the run from another thread: the script meets this error when it waits next."""
        self._failure = failure

    def _later(self, call: Callable[[], None]) -> None:
        self._calls.put(call)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            try:
                call()
            except Exception:  # noqa: BLE001  as rospy: printed, and the others go on
                complain()


#: The simulation that runs beneath a script: stepped by its waits, or in real time.
Flow = Stepped | Live
