"""The core's part in the loop's thread: it takes samples, and notes what happens between them."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from math import ceil
from typing import Any

from trocar.interfaces.commands import Command
from trocar.interfaces.crtk import happenings, sample, scene
from trocar.interfaces.crtk.clock import Beat, Stamper
from trocar.interfaces.crtk.sample import Event, Sample
from trocar.interfaces.loop import Loop
from trocar.interfaces.seldom import Seldom, more
from trocar.interfaces.state import Elapsed
from trocar.simulation.journal import Entry

#: Samples that may wait to be published span this much time. Source: our own choice, longer than a
#: hiccup of a busy machine. [s]
WAITING_S = 0.5
#: Messages go out at least so long after the tick that they show, or half a period where that is
#: shorter: they are made meanwhile, and how long that took this time nobody sees. Source: our own
#: choice, by the lateness of six arms and twenty objects in `python -m benchmarks interface`. [s]
READY_S = 0.0018
#: How many events may wait for a sample. Source: our own choice: floods are cut off.
EVENTS = 1024


def behind_s(rate_hz: float, tick_s: float) -> float:
    """Return how long after they are due by their rate samples' messages go out [s].

    A sample shows the first tick from then on. Sent a fixed time later, and not as soon as it is
    ready, it comes as evenly as its rate, not as ticks and threads happen to come.

    Args:
        rate_hz: of samples
        tick_s: time between two ticks [s]
    """
    ticks = 1.0 / (rate_hz * tick_s)
    wait = 0.0 if abs(ticks - round(ticks)) < 1e-6 else tick_s
    return wait + min(READY_S, 0.5 / rate_hz)


class Watch:
    """Watches a loop, and hands samples on.

    Args:
        loop: is watched from `start` to `stop`
        prefixes: {arm: what stands before its topics}
        stamper: gives stamps
        rate_hz: how often to sample
        samples: takes every sample
        waits: tells whether commands wait for an arm, which keep it busy

    Attributes:
        skipped: how many samples were left out since those before were not published yet
    """

    def __init__(
        self,
        loop: Loop,
        prefixes: Mapping[str, str],
        stamper: Stamper,
        rate_hz: float,
        samples: queue.SimpleQueue[Sample | None],
        waits: Callable[[str], bool],
    ) -> None:
        self._loop, self._prefixes, self._stamper = loop, prefixes, stamper
        self._beat, self._samples, self._waits = Beat(rate_hz), samples, waits
        self._room = max(1, round(WAITING_S * rate_hz))
        self._behind_s = behind_s(rate_hz, loop.tick_s)
        self._events: deque[Event] = deque(maxlen=EVENTS)
        self._moved: set[str] = set()
        self._stops: list[Callable[[], None]] = []
        self._seldom = Seldom()
        self._paused: bool | None = None
        self._timed = False
        self._stepped = 0
        self.skipped = 0
        #: Topics that somebody wants, as of the sample before: what costs is only then looked at.
        self.asked: frozenset[str] = frozenset()
        #: Looks at every sample as it is taken, and may return one with more in it.
        self.look: Callable[[Sample], Sample] = lambda taken: taken

    def start(self) -> None:
        """Watch from now on."""
        self._stops = [self._loop.world.listen(self._hear), self._loop.watch(self)]

    def stop(self) -> None:
        """Watch no longer."""
        for stop in self._stops:
            stop()

    def put(self, name: str, fields: Mapping[str, Any]) -> None:
        """Let an event out with the next sample; from any thread."""
        self._events.append(Event(name, fields))

    def ticked(self, elapsed: Elapsed) -> None:
        """Take a sample when one is due."""
        self._stamper.advance(elapsed, self._loop.now)
        self._timed = elapsed.due_s is not None
        if elapsed.paused != self._paused:
            self._paused = elapsed.paused
            self.put("scene/paused", {"data": elapsed.paused})
        stepped, self._stepped = elapsed.stepped != self._stepped, elapsed.stepped
        if not self._beat.due(self._stamper.elapsed_s) and not stepped:
            return
        if self._samples.qsize() >= self._room:
            self.skipped += 1
            return
        self._repeat_states()
        events = tuple(self._drained())
        stamp, passed = self._stamper.stamp(), self._stamper.elapsed_s
        world, seen = self._loop.world, scene.look(self._loop.world, self.asked)
        taken = self.look(sample.take(world, stamp, passed, (events, seen), self._waits))
        if elapsed.due_s is not None and not stepped:  # who steps waits for what comes of it
            out_s = elapsed.due_s - self._beat.since(passed) + self._behind_s
            taken = replace(taken, due_s=out_s)
        self._samples.put(taken)

    def patience(self) -> int:
        """Return in how many ticks the next sample is due; 1 where somebody waits for it.

        Ticks that are due are done at once then: several together would hold a sample up.
        """
        left = ceil(self._beat.left(self._stamper.elapsed_s) / self._loop.tick_s)
        return 1 if self.asked and self._timed else max(left, 1)

    def _drained(self) -> Iterator[Event]:
        """Take the events that wait, each with a stamp of its own."""
        while self._events:
            event = self._events.popleft()
            yield event if event.stamp else replace(event, stamp=self._stamper.stamp())

    def tell_state(self, arm: str) -> None:
        """Tell an arm's state with the next sample, even when it is the same."""
        self._moved.add(arm)

    def refused(self, command: Command, reason: str) -> None:
        """Tell the arm's `warning` topic of a command that was refused when it was applied."""
        before = self._prefixes.get(getattr(command, "arm", ""), "system")
        unsaid = self._seldom.due((before, reason), self._loop.now)
        if unsaid is not None:
            self.put(f"{before}/warning", {"data": reason + more(unsaid)})

    def _hear(self, entry: Entry) -> None:
        before = self._prefixes.get(entry.source)
        if before is None:
            return
        if happenings.is_move(entry):
            self._moved.add(entry.source)
            if self._loop.world.arm(entry.source).operating_state().is_busy:
                self._repeat_states()  # it may be over before the next sample
        desired = happenings.desired_state(entry)
        if desired is not None:
            self._append(before, "desired_state", {"data": desired})
        found = happenings.told(entry)
        if found is not None:
            key, fields = found
            if key == "operating_state":
                self._moved.discard(entry.source)
                fields = {**fields, "is_busy": fields["is_busy"] or self._waits(entry.source)}
            self._append(before, key, fields)

    def _append(self, before: str, key: str, fields: Mapping[str, Any]) -> None:
        stamp = self._stamper.stamp(self._loop.now)
        self._events.append(Event(f"{before}/{key}", fields, stamp))

    def _repeat_states(self) -> None:
        """Tell again the state of arms that were told to move and changed none by it.

        Clients wait for a state that is newer than their command, and a command to an arm that is
        busy anyhow changes nothing.
        """
        for name in self._moved:
            now = self._loop.world.arm(name).operating_state()
            busy = now.is_busy or self._waits(name)
            fields = {"state": now.state, "is_homed": now.is_homed, "is_busy": busy}
            self._append(self._prefixes[name], "operating_state", fields)
        self._moved.clear()
