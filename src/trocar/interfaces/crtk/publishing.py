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
from trocar.interfaces.crtk.messages.forms import Packing
from trocar.interfaces.crtk.sample import Event, RigFigures, Sample
from trocar.interfaces.crtk.sheet import Page, Sheet
from trocar.interfaces.crtk.topics import Topic
from trocar.interfaces.crtk.transport import Message
from trocar.simulation.readout import Reader

_log = logging.getLogger("trocar")

#: Source: dVRK 2.4, system_ROS: tf every 20 ms. [Hz]
TF_RATE_HZ = 50.0
#: Operating states are told again this often, for those who came late. Source: our own choice. [Hz]
REPEAT_RATE_HZ = 1.0

Figure = Callable[[RigFigures, Stamp], "Message | None"]
#: Messages, or their bytes as the transport writes them.
Out = list[tuple[Topic, Any]]
#: How a transport writes messages, None where it takes them as they are, and what it wants.
Wanted = tuple[Packing | None, frozenset[str]]
#: What may be wrong with the figures of a message.
UNMAKEABLE = TrocarError, np.linalg.LinAlgError


class Publishing:
    """Turn samples into messages; in one thread only.

    Args:
        topics: every topic by name
        prefixes: {arm: what stands before its topics}
        extra: {topic: how to make its message}, beside those of arms

    Attributes:
        latched: {topic: its last message}, of those that late subscribers get
    """

    def __init__(
        self,
        topics: Mapping[str, Topic],
        prefixes: Mapping[str, str],
        extra: Mapping[str, Figure],
    ) -> None:
        self._topics, self._prefixes = topics, prefixes
        self._makers = {**_arm_makers(topics.values()), **extra}
        self._reader: Reader | None = None
        self._sheet: Sheet
        self._pages: dict[int, Page] = {}
        self._tf, self._repeat = Beat(TF_RATE_HZ), Beat(REPEAT_RATE_HZ)
        self._standing: dict[str, tuple[object, ...]] = {}
        self._states: dict[str, tuple[str, bool, bool]] = {}
        self._complained: set[str] = set()
        self.latched: dict[str, Message] = {}

    def states(self, sample: Sample, wanted: Iterable[Wanted]) -> list[Out]:
        """Return what is published every period: for each transport, of the topics it wants."""
        if self._reader is None or self._reader.model is not sample.world.model:
            self._reader = Reader(sample.world.model)
            self._sheet = Sheet(self._reader, self._topics.values())
        rig = RigFigures(sample, self._reader.read(sample.world))
        tf = self._tf.due(sample.elapsed) or bool(sample.cameras)
        made: dict[str, Message | None] = {}
        found: list[Out] = []
        for index, (packing, names) in enumerate(wanted):
            batch, rest = self._filled(index, packing, names, rig)
            for name in rest:
                make, topic = self._makers.get(name), self._topics.get(name)
                if make is None or topic is None or (topic.rate == "tf" and not tf):
                    continue
                if name not in made:
                    made[name] = self._made(name, lambda make=make: make(rig, sample.stamp))
                if (message := made[name]) is not None:
                    batch.append((topic, message))
            found.append(batch)
        rig.readout.let_go()
        return found

    def _filled(
        self, index: int, packing: Packing | None, names: frozenset[str], rig: RigFigures
    ) -> tuple[Out, frozenset[str]]:
        """Return messages of the sheet for one transport, and the names of those left to make."""
        if packing is None:
            return [], names
        page = self._pages.get(index)
        if page is None or page.sheet is not self._sheet or page.names != names:
            page = self._pages[index] = Page(self._sheet, packing, names)
        try:
            return page.filled(rig, rig.sample.stamp), page.rest
        except (*UNMAKEABLE, ValueError):  # each is made alone then, and what cannot be is named
            return [], names

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

    def _made(self, name: str, make: Callable[[], Message | None]) -> Message | None:
        """Make a message; one that cannot be made is left out, and said so once."""
        try:
            return make()
        except UNMAKEABLE as problem:
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
