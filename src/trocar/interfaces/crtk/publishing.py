"""Messages from samples: only those that are wanted, and every event."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from trocar.errors import TrocarError
from trocar.interfaces.crtk import happenings
from trocar.interfaces.crtk.arm_messages import MAKERS
from trocar.interfaces.crtk.clock import Beat, Stamp
from trocar.interfaces.crtk.figures import RigFigures
from trocar.interfaces.crtk.plan import Plan
from trocar.interfaces.crtk.sample import Event, Sample
from trocar.interfaces.crtk.topics import Topic
from trocar.interfaces.crtk.transport import Message

_log = logging.getLogger("trocar")

#: Source: dVRK 2.4, system_ROS: tf every 20 ms. [Hz]
TF_RATE_HZ = 50.0
#: Operating states are told again this often, for those who came late. Source: our own choice. [Hz]
REPEAT_RATE_HZ = 1.0

Figure = Callable[[RigFigures, Stamp], "Message | None"]
Out = list[tuple[Topic, Message]]


class Publishing:
    """Turn samples into messages; in one thread only.

    Args:
        topics: every topic by name
        prefixes: {arm: what stands before its topics}
        extra: {topic: how to make its message}, beside those of arms

    Attributes:
        latched: {topic: its last message}, of those that late subscribers get
        failed: how many messages could not be made
    """

    def __init__(
        self,
        topics: Mapping[str, Topic],
        prefixes: Mapping[str, str],
        extra: Mapping[str, Figure],
    ) -> None:
        self._topics, self._prefixes = topics, prefixes
        self._makers = {**_arm_makers(topics.values()), **extra}
        self._plan: Plan | None = None
        self._tf, self._repeat = Beat(TF_RATE_HZ), Beat(REPEAT_RATE_HZ)
        self._standing: dict[str, tuple[object, ...]] = {}
        self._states: dict[str, tuple[str, bool, bool]] = {}
        self._complained: set[str] = set()
        self.latched: dict[str, Message] = {}
        self.failed = 0

    def states(self, sample: Sample, wanted: Iterable[str]) -> dict[str, tuple[Topic, Message]]:
        """Return what is published every period, of the topics that are wanted."""
        if self._plan is None or self._plan.rig is not sample.rig:
            self._plan = Plan(sample.rig)
        rig = RigFigures(sample, self._plan)
        tf = self._tf.due(sample.elapsed) or bool(sample.cameras)
        found: dict[str, tuple[Topic, Message]] = {}
        for name in wanted:
            make, topic = self._makers.get(name), self._topics.get(name)
            if make is None or topic is None or (topic.rate == "tf" and not tf):
                continue
            message = self._made(name, make, rig, sample.stamp)
            if message is not None:
                found[name] = topic, message
        return found

    def events(self, sample: Sample) -> Out:
        """Return what happened since the last sample, what latched topics change to included."""
        out: Out = []
        for event in sample.events:
            self._add(out, event, sample.stamp)
        again = self._repeat.due(sample.elapsed)
        for name, arm in sample.arms.items():
            before = self._prefixes[name]
            now = arm.state, arm.homed, arm.busy
            if again or self._states.get(before) != now:
                fields = happenings.state_of(arm)
                self._add(out, Event(f"{before}/operating_state", fields), sample.stamp)
            standing = happenings.standing_of(arm)
            if standing != self._standing.get(name):
                self._standing[name] = standing
                self._tell_standing(out, before, sample, name)
        return out

    def _tell_standing(self, out: Out, before: str, sample: Sample, name: str) -> None:
        for key, (value, message) in happenings.STANDING.items():
            topic = f"{before}/{key}"
            if topic not in self._topics:
                continue
            fields = message(value(sample.arms[name]))
            last = self.latched.get(topic)
            if last is None or any(last[k] != v for k, v in fields.items()):
                self._add(out, Event(topic, fields), sample.stamp)
        for key, first in happenings.FIRST.items():
            topic = f"{before}/{key}"
            if topic in self._topics and topic not in self.latched:
                self._add(out, Event(topic, first(sample.arms[name])), sample.stamp)

    def _add(self, out: Out, event: Event, stamp: Stamp) -> None:
        topic = self._topics.get(event.name)
        if topic is None:
            return
        message: dict[str, Any] = dict(event.fields)
        if topic.stamped and "header" not in message:
            own = event.stamp or stamp
            message = {"header": {"stamp": own, "frame_id": ""}, **message}
        if topic.key == "operating_state":
            state = message["state"], message["is_homed"], message["is_busy"]
            self._states[event.name.removesuffix("/operating_state")] = state
        if topic.latched:
            self.latched[event.name] = message
        out.append((topic, message))

    def _made(self, name: str, make: Figure, rig: RigFigures, stamp: Stamp) -> Message | None:
        """Make a message; one that cannot be made is left out, and said so once."""
        try:
            return make(rig, stamp)
        except (TrocarError, np.linalg.LinAlgError) as problem:
            self.failed += 1
            if name not in self._complained:
                self._complained.add(name)
                _log.warning("%s cannot be published: %s", name, problem)
            return None


def _arm_makers(topics: Iterable[Topic]) -> dict[str, Figure]:
    return {
        topic.name: _of_arm(topic)
        for topic in topics
        if topic.direction == "pub" and topic.arm and topic.key in MAKERS
    }


def _of_arm(topic: Topic) -> Figure:
    maker, arm = MAKERS[topic.key], topic.arm
    return lambda rig, stamp: maker(rig.arm(arm), stamp)
