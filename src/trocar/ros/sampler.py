"""Sampling in the loop's thread: samples when they are due, and the events between them."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from math import ceil
from typing import Any

from trocar.live.inbox import Command
from trocar.live.loop import Loop
from trocar.live.state import Elapsed
from trocar.ros.clock import Beat, Stamper
from trocar.ros.sample import Event, Sample, scene_sample
from trocar.simulation.arm import Arm
from trocar.simulation.journal import Entry
from trocar.simulation.records import ArmSample, WorldSample

#: Samples that may wait to be published span this much time. Source: our own choice, longer than a
#: hiccup of a busy machine. [s]
WAITING_S = 0.5
#: Messages go out at least so long after the tick that they show: they are made meanwhile, so that
#: the time this takes does not show as jitter. Source: our own choice, by the lateness that
#: `python -m benchmarks interface` prints for six arms and twenty objects. [s]
READY_S = 0.0018
#: Above this rate they go out as soon as they are made. Source: our own choice; holding them for
#: half a period at 1 kHz does not make them more even, and takes 7 % more processor time. [Hz]
HELD_HZ = 0.5 / READY_S
#: Events that may wait for a sample; a flood is cut off. Source: our own choice.
EVENTS = 1024

#: Events of the journal that are topics, and the value that is their data.
PLAIN = {
    "goal_reached": "reached",
    "desired_state": "state",
    **dict.fromkeys(("error", "warning", "status"), "text"),
    **dict.fromkeys(("grasp/slipped", "grasp/dropped"), "object"),
}
#: Verbs after which clients wait for a state.
MOVES = {
    *("state_command", "unhome"),
    *("move_jp", "move_jr", "move_cp", "move_to", "home"),
    *("jaw.move_jp", "jaw.move_jr", "jaw.open", "jaw.close"),
}


def behind_s(rate_hz: float, tick_s: float) -> float | None:
    """Return the delay of messages after their samples are due by the rate [s]; None: no delay.

    A sample shows the first tick from then on. Sent a fixed time later, and not as soon as it is
    ready, it comes as evenly as its rate, not as ticks and threads happen to come.

    Args:
        rate_hz: of samples
        tick_s: time between two ticks [s]
    """
    if rate_hz > HELD_HZ:
        return None
    ticks = 1.0 / (rate_hz * tick_s)
    return READY_S if abs(ticks - round(ticks)) < 1e-6 else tick_s + READY_S


class Sampler:
    """Watches a loop, and puts samples into a queue.

    Args:
        loop: is watched from `start` to `stop`
        prefixes: {arm or object with events: prefix of its topics}
        stamper: gives stamps
        rate_hz: how often to sample
        samples: takes every sample
        rejected: called with each command that was rejected when it was applied, and the reason

    Attributes:
        skipped: samples that were left out since those before were not published yet
        wanted: topics with subscribers, as of the sample before: others are not computed
        look: called with every sample as it is taken; returns one that may have more in it
    """

    def __init__(
        self,
        loop: Loop,
        prefixes: Mapping[str, str],
        stamper: Stamper,
        rate_hz: float,
        samples: queue.SimpleQueue[Sample | None],
        rejected: Callable[[Command, str], None],
    ) -> None:
        self._loop, self._prefixes, self._stamper = loop, prefixes, stamper
        self._beat, self._samples, self._rejected = Beat(rate_hz), samples, rejected
        self._room = max(1, round(WAITING_S * rate_hz))
        self._behind_s = behind_s(rate_hz, loop.tick_s)
        self._events: deque[Event] = deque(maxlen=EVENTS)
        self._moved: set[str] = set()
        self._held: frozenset[str] = frozenset()
        self._current: dict[str, str] = {}
        #: Arms without an instrument.
        self._bare: set[str] = set()
        self._stops: list[Callable[[], None]] = []
        self._paused: bool | None = None
        self._timed = False
        self._stepped = 0
        self.skipped = 0
        self.wanted: frozenset[str] = frozenset()
        self.look: Callable[[Sample], Sample] = lambda taken: taken

    def start(self) -> None:
        """Watch from now on."""
        arms = self._loop.world.arms
        for name, before in self._prefixes.items():
            if name in arms:
                now = arms[name].operating_state()
                self._current[before] = now.phase
                if not arms[name].description.tool:
                    self._bare.add(name)
        self._stops = [self._loop.world.listen(self._hear), self._loop.watch(self)]

    def stop(self) -> None:
        """Watch no longer."""
        for stop in self._stops:
            stop()

    def put(self, name: str, fields: Mapping[str, Any]) -> None:
        """Publish an event with the next sample; from any thread."""
        self._events.append(Event(name, fields))

    @property
    def events_waiting(self) -> int:
        """Number of events that wait for the next sample."""
        return len(self._events)

    def ticked(self, elapsed: Elapsed) -> None:
        """Take a sample when one is due."""
        held = self._loop.held
        self._moved |= self._held - held  # what waited is over: publish the state, even if the same
        self._held = held
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
        passed = self._stamper.elapsed_s
        due_s, behind_s = None, self._behind_s
        if behind_s is not None and elapsed.due_s is not None and not stepped:
            due_s = elapsed.due_s - self._beat.since(passed) + behind_s  # who steps waits for it
        self._samples.put(self.look(self._sample(passed, due_s)))

    def patience(self) -> int:
        """Return the number of ticks that may be stepped together.

        They end with the sample that is due next, or a tick before it where a subscriber waits for
        it: those before would delay it.
        """
        left = ceil(self._beat.left(self._stamper.elapsed_s) / self._loop.tick_s)
        return max(left - 1 if self.wanted and self._timed else left, 1)

    def refused(self, command: Command, reason: str) -> None:
        """Report a rejected command."""
        self._rejected(command, reason)

    # ------------------------------------------------------------------ inside

    def _sample(self, passed: float, due_s: float | None) -> Sample:
        """Copy the world; arms for which commands wait are busy."""
        world = self._loop.world
        events = tuple(self._drained())
        stamp, scene, seen = self._stamper.stamp(), scene_sample(world, self.wanted), world.sample()
        if self._held:
            seen = replace(seen, arms={**seen.arms, **self._waiting(seen)})
        return Sample(stamp, passed, seen, events, scene, due_s=due_s)

    def _waiting(self, seen: WorldSample) -> dict[str, ArmSample]:
        """Return the arms for which commands wait, as busy."""
        held = ((name, seen.arms[name]) for name in self._held)
        return {n: arm._replace(status=replace(arm.status, busy=True)) for n, arm in held}

    def _drained(self) -> Iterator[Event]:
        """Take the events that wait, each with a stamp of its own."""
        while self._events:
            event = self._events.popleft()
            yield event if event.stamp else replace(event, stamp=self._stamper.stamp())

    def _hear(self, entry: Entry) -> None:
        before = self._prefixes.get(entry.source)
        if before is None:
            return
        if entry.name == "desired_state" or (entry.kind == "command" and entry.name in MOVES):
            self._moved.add(entry.source)
            if self._loop.world.arm(entry.source).operating_state().is_busy:
                self._repeat_states()  # it may be over before the next sample
        if entry.kind != "event":
            return
        if entry.name == "operating_state":
            self._moved.discard(entry.source)
            busy = entry.values["is_busy"] or entry.source in self._loop.held
            self._append(before, entry.name, {**entry.values, "is_busy": busy})
            self._append_phase(before, self._loop.world.arm(entry.source))
        elif entry.name == "tool_type":
            self._append_tool(before, entry.source, entry.values["tool"])
        elif entry.name == "gripper/pinch":
            self._append(before, entry.name, {})
        elif entry.name in PLAIN:
            self._append(before, entry.name, {"data": entry.values[PLAIN[entry.name]]})

    def _append(self, before: str, key: str, fields: Mapping[str, Any]) -> None:
        stamp = self._stamper.stamp(self._loop.now)
        self._events.append(Event(f"{before}/{key}", fields, stamp))
        if key == "desired_state":
            self._append(before, "status", {"data": f"desired state {fields['data']}"})

    def _append_tool(self, before: str, name: str, tool: str) -> None:
        """Report that an instrument is there, or is no longer there; not an exchange.

        Source: SAW 9e535e6, mtsIntuitiveResearchKitPSM.cpp:1557.
        """
        if bool(tool) == (name in self._bare):
            (self._bare.discard if tool else self._bare.add)(name)
            text = "tool detected" if tool else "no tool detected"
            self._append(before, "status", {"data": text})

    def _append_phase(self, before: str, arm: Arm) -> None:
        """Report a new state of an arm by the name that the dVRK's status messages have for it.

        Source: SAW 9e535e6, mtsIntuitiveResearchKitArm.cpp:1168, and recorded answers.
        """
        phase = arm.operating_state().phase
        if self._current.get(before, phase) != phase:
            self._append(before, "status", {"data": f"current state {phase}"})
        self._current[before] = phase

    def _repeat_states(self) -> None:
        """Publish again the state of arms that were commanded to move and changed none by it.

        Clients wait for a state that is newer than their command, and a command to an arm that is
        busy anyhow changes nothing.
        """
        for name in self._moved:
            now = self._loop.world.arm(name).operating_state()
            busy = now.is_busy or name in self._loop.held
            fields = {"state": now.state, "is_homed": now.is_homed, "is_busy": busy}
            self._append(self._prefixes[name], "operating_state", fields)
        self._moved.clear()
