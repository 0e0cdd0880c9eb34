"""Messages from samples: states with subscribers, and every event."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from trocar.errors import TrocarError
from trocar.ros.clock import Beat, Stamp
from trocar.ros.period_statistics import RATE_HZ as STATISTICS_RATE_HZ
from trocar.ros.period_statistics import Stopwatches
from trocar.ros.sample import Event, Sample, SampleReadings
from trocar.ros.topic import Content, Message, Topic
from trocar.simulation.readout import Reader
from trocar.simulation.records import ArmStatus

_log = logging.getLogger("trocar")

#: Source: dVRK 2.4, system_ROS: tf every 20 ms. [Hz]
TF_RATE_HZ = 50.0

Out = list[tuple[Topic, Message]]


def spoken(arm: str, text: str) -> str:
    """Return a message of an arm with its name in front: "PSM1: ...", "PSM1 SUJ: ...".

    Source: recorded answers of the dVRK's software; SAW 9e535e6, SUJ.cpp:192.
    """
    name = f"{arm.removeprefix('SUJ_')} SUJ" if arm.startswith("SUJ_") else arm
    return text if text.startswith(f"{name}: ") else f"{name}: {text}"


class Publishing:
    """Turn samples into messages.

    Args:
        topics: every topic by name
        prefixes: {arm: prefix of its topics}
        now: wall time [s]

    Attributes:
        latched: {topic: its last message}, of those that late subscribers get
    """

    def __init__(
        self,
        topics: Mapping[str, Topic],
        prefixes: Mapping[str, str],
        now: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._topics, self._prefixes = topics, prefixes
        self._reader: Reader | None = None
        self._lock = threading.Lock()
        self._newest: Sample | None = None
        self._now, self._watches, self._made_s = now, Stopwatches(), 0.0
        self._tf = Beat(TF_RATE_HZ)
        self._summary = Beat(STATISTICS_RATE_HZ)
        self._before: frozenset[str] = frozenset()
        self._contents: dict[str, list[tuple[Topic, Content]]] = {}
        self._first: dict[str, list[tuple[Topic, Content]]] = {}
        for topic in topics.values():
            if topic.content:
                self._contents.setdefault(topic.arm, []).append((topic, topic.content))
            if topic.first:
                self._first.setdefault(topic.arm, []).append((topic, topic.first))
        self._content: dict[str, Message] = {}
        self._states: dict[str, tuple[str, bool, bool]] = {}
        self._statuses: dict[str, ArmStatus] = {}
        self._complained: set[str] = set()
        self.latched: dict[str, Message] = {}

    def states(self, sample: Sample, wanted: Iterable[frozenset[str]]) -> list[Out]:
        """Make the messages of a period: for each transport, those of its subscribed topics."""
        begun_s, world = self._now(), sample.world
        self._watches.sampled(begun_s, world.time, world.model.mj.opt.timestep, self._made_s)
        wanted = list(wanted)
        every = frozenset[str]().union(*wanted)
        fresh, self._before = every - self._before, every
        due = self._tf.due(sample.elapsed) or bool(sample.cameras)
        if due:
            self._watches.framed(begun_s)
        summed = self._summary.due(sample.elapsed)
        self._newest = sample
        made: dict[str, tuple[Topic, Message]] = {}
        with self._lock:
            readings = self._readings(sample)
            for name in every:
                topic = self._topics.get(name)
                if topic is None or topic.make is None:
                    continue
                if topic.rate == "tf" and not (due or name in fresh):
                    continue
                if topic.rate == "statistics" and not summed:
                    continue
                message = self._made(topic, readings, sample.stamp)
                if message is not None:
                    made[name] = topic, message
            readings.readout.let_go()
        self._made_s = self._now() - begun_s
        return [[made[name] for name in names if name in made] for names in wanted]

    def last(self, name: str) -> Message | None:
        """Return the message that a new subscriber gets at once; from any thread.

        It is the last one of a latched topic, and one of the newest sample of a topic that is
        published every period: the next sample may be too late for a client that reads at once.
        """
        topic, sample = self._topics.get(name), self._newest
        if topic is None or topic.make is None or sample is None:
            return self.latched.get(name)
        with self._lock:
            readings = self._readings(sample)
            message = self._made(topic, readings, sample.stamp)
            readings.readout.let_go()
        return message

    def events(self, sample: Sample) -> Out:
        """Make the messages of events since the last sample, and of latched topics that changed."""
        out: Out = []
        for event in sample.events:
            self._add(out, event, sample.stamp)
        for name, sampled in sample.arms.items():
            before, arm = self._prefixes[name], sampled.status
            now = arm.state, arm.homed, arm.busy
            if self._states.get(before) != now:
                fields: Message = {"state": arm.state, "is_homed": arm.homed, "is_busy": arm.busy}
                self._add(out, Event(f"{before}/operating_state", fields), sample.stamp)
            if self._statuses.get(name) is arm:
                continue
            self._statuses[name] = arm
            for topic, content in self._contents.get(name, ()):
                fields = content(arm)
                if fields != self._content.get(topic.name):
                    self._content[topic.name] = fields
                    self._add(out, Event(topic.name, fields), sample.stamp)
            for topic, first in self._first.pop(name, ()):
                if topic.name not in self.latched:
                    self._add(out, Event(topic.name, first(arm)), sample.stamp)
        return out

    def _readings(self, sample: Sample) -> SampleReadings:
        if self._reader is None or self._reader.model is not sample.world.model:
            self._reader = Reader(sample.world.model)
        return SampleReadings(sample, self._reader.read(sample.world), self._watches.of)

    def _add(self, out: Out, event: Event, stamp: Stamp) -> None:
        topic = self._topics.get(event.name)
        if topic is None:
            return
        message: dict[str, Any] = dict(event.fields)
        if topic.stamped and "header" not in message:
            own = event.stamp or stamp
            message = {"header": {"stamp": own, "frame_id": ""}, **message}
        if topic.arm and topic.key in ("error", "warning", "status"):
            message["data"] = spoken(topic.arm, message["data"])
        if topic.key == "operating_state":
            state = message["state"], message["is_homed"], message["is_busy"]
            self._states[event.name.removesuffix("/operating_state")] = state
        if topic.latched:
            self.latched[event.name] = message
        out.append((topic, message))

    def _made(self, topic: Topic, readings: SampleReadings, stamp: Stamp) -> Message | None:
        """Make a message; one that cannot be made is left out, and logged once."""
        try:
            return topic.make(readings, stamp) if topic.make else None
        except (TrocarError, np.linalg.LinAlgError) as problem:
            if topic.name not in self._complained:
                self._complained.add(topic.name)
                _log.warning("cannot publish %s: %s", topic.name, problem)
            return None
