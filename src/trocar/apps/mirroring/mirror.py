"""The mirror: a source of joint states, the loop that steps the twin, and what is said of both."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from trocar.apps.mirroring.bag import Bag, Heard
from trocar.apps.mirroring.twin import By, Twins
from trocar.errors import TrocarError
from trocar.interfaces.state import Elapsed

if TYPE_CHECKING:
    from trocar.interfaces import Loop
    from trocar.interfaces.commands import Command

_log = logging.getLogger("trocar")

#: An arm that is silent for longer holds, and that is said [s]. Source: the issue.
SILENCE_S = 0.5
#: How many messages a bag's reader is ahead of the loop. Source: our own choice: a tenth of a
#: second of ten arms, so that unpacking a chunk delays nothing.
AHEAD = 2000
#: The bag's reader is waited for so long at most [s]. Source: our own choice.
PATIENCE_S = 5.0
#: Silence is looked for once in so many ticks. Source: our own choice.
SELDOM = 5
#: How long it takes until arms that were never heard are named [s]. Source: our own choice.
FIRST_WORD_S = 3.0


class Listener(Protocol):
    """Hears topics, in a thread of its own, until it is closed."""

    def start(self, topics: Sequence[str], take: Callable[[str, Mapping[str, Any]], None]) -> None:
        """Listen, and hand over every message with its topic."""
        ...

    def close(self) -> None:
        """Listen no more."""
        ...


@dataclass(frozen=True)
class LiveSource:
    """A robot that is there now: who listens to it, and what it is called in messages."""

    listener: Listener
    name: str


@dataclass(frozen=True)
class BagSource:
    """A recording."""

    bag: Bag

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return self.bag.file


@dataclass(frozen=True)
class ArmReport:
    """How an arm followed.

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
    """What came of a mirror.

    Attributes:
        source: what was heard
        duration_s: of the bag, or since the first message [s]
        arms: {arm: how it followed}
        missing: arms of the rig of which nothing is told
    """

    source: str
    duration_s: float
    arms: Mapping[str, ArmReport]
    missing: tuple[str, ...]


class Lags:
    """How late an arm was: the newest values, and the largest of all; memory stays flat."""

    def __init__(self) -> None:
        self._newest: deque[float] = deque(maxlen=AHEAD)
        self.largest = 0.0

    def note(self, lag: float) -> None:
        """Note how late it was [s]."""
        self._newest.append(lag)
        self.largest = max(self.largest, lag)

    @property
    def median(self) -> float:
        """Of the newest [s]."""
        return float(np.median(list(self._newest))) if self._newest else 0.0


class Mirror:
    """Lets the arms of a loop follow a source; a watcher of the loop.

    Args:
        loop: steps the twin
        source: what is followed
        arms: names of arms; None: all that the source tells of
        by: "set": put where the robot is; "servo": follow it by their own servos

    Raises:
        InputError: the source tells nothing of an arm that was asked for, or of no arm
    """

    def __init__(
        self,
        loop: Loop,
        source: BagSource | LiveSource,
        arms: Sequence[str] | None = None,
        by: By = "set",
    ) -> None:
        self._loop, self._source = loop, source
        self._bag = source.bag if isinstance(source, BagSource) else None
        topics = None if self._bag is None else self._bag.topics
        self.twins = Twins(loop.world.rig, topics, arms, by, source.name)
        self.over = threading.Event()
        self._queue: queue.Queue[Heard | TrocarError | None] = queue.Queue(AHEAD)
        self._next: Heard | None = None
        self._begin, self._end, self._simulated_s = 0.0, 0.0, 0.0
        self._closing = threading.Event()
        self._lags = {name: Lags() for name in self.twins.twins}
        self._lock = threading.Lock()
        self._waiting: dict[str, float] = {}
        self._drained = False
        self._named = False
        self._failure: TrocarError | None = None
        self._stop: Callable[[], None] = lambda: None

    # ------------------------------------------------------------------ life

    def start(self) -> None:
        """Begin; the loop may run already or begin afterwards."""
        for order in self.twins.prepare():
            self._loop.post(order)
        if self._bag is not None:
            threading.Thread(target=self._read, name="trocar-bag", daemon=True).start()
            self._advance()
            self._begin = self._next.time if self._next is not None else 0.0
        self._started = time.monotonic()
        self._stop = self._loop.watch(self)
        if isinstance(self._source, LiveSource):
            self._source.listener.start(self.twins.topics, self._live)

    def close(self) -> None:
        """End: nothing is followed any more.

        Raises:
            TrocarError: what ended the reading of the bag
        """
        self._closing.set()
        self._stop()
        if isinstance(self._source, LiveSource):
            self._source.listener.close()
        if self._failure is not None:
            raise self._failure

    # ------------------------------------------------------------------ the loop's thread

    def ticked(self, elapsed: Elapsed) -> None:
        """Post what is due by now; say who is silent."""
        with self._lock:
            arrived, self._waiting = self._waiting, {}
        now = elapsed.simulated_s if self._bag is not None else time.monotonic()
        for name, due in arrived.items():
            self._lags[name].note(now - due)
        if self._bag is not None:
            self._play(elapsed.simulated_s)
            now = self._begin + elapsed.simulated_s
            if not self.over.is_set():
                self._tell(self.twins.silence(now, SILENCE_S))
        else:
            self._tell(self.twins.silence(time.monotonic(), SILENCE_S))
            self._name_the_unheard()

    def patience(self) -> int:
        """Return in how many ticks the next message is due."""
        if self._bag is None:
            return SELDOM
        if self._next is None or self._waiting:
            return 1
        ahead = self._next.time - self._begin - self._simulated_s
        return max(1, min(SELDOM, int(ahead / self._loop.tick_s)))

    def refused(self, command: Command, reason: str) -> None:
        """Refusals are said by the loop."""

    def _play(self, simulated_s: float) -> None:
        """Post every message of the bag that is due, the newest of each arm last."""
        self._simulated_s = simulated_s
        while self._next is not None and self._next.time - self._begin <= simulated_s:
            heard = self._next
            self._end = heard.time
            self._take(heard.topic, heard.message, heard.time, heard.time - self._begin)
            self._advance()
        if self._next is None and not self._drained:
            self._drained = True  # what was posted just now is obeyed in the next tick
        elif self._next is None and not self.over.is_set():
            self.over.set()
            if self._failure is None:
                text = f"{self._source.name}: over after {self._end - self._begin:.2f} s"
                self._tell([f"{text}; the arms hold where they are"])

    def _take(self, topic: str, message: Mapping[str, Any], now: float, due: float) -> None:
        follow, word = self.twins.hear(topic, message, now)
        self._tell([word] if word else [])
        if follow is not None:
            self._loop.post(follow)
            with self._lock:
                self._waiting.setdefault(follow.arm, due)

    def _name_the_unheard(self) -> None:
        if self._named or time.monotonic() - self._started < FIRST_WORD_S:
            return
        self._named = True
        for name, twin in self.twins.twins.items():
            if not twin.heard:
                self._tell([f"{name}: nothing heard of it yet; it stands where the rig starts"])

    # ------------------------------------------------------------------ other threads

    def _live(self, topic: str, message: Mapping[str, Any]) -> None:
        now = time.monotonic()
        self._take(topic, message, now, now)

    def _read(self) -> None:
        """Read the bag ahead of the loop, no more than AHEAD messages."""
        bag = self._bag
        try:
            for heard in bag.messages(self.twins.topics) if bag is not None else ():
                if not self._put(heard):
                    return
            self._put(None)
        except TrocarError as error:
            self._put(error)

    def _put(self, item: Heard | TrocarError | None) -> bool:
        while not self._closing.is_set():
            try:
                self._queue.put(item, timeout=0.2)
            except queue.Full:
                continue
            return True
        return False

    def _advance(self) -> None:
        """Take the next message from the reader."""
        try:
            found = self._queue.get(timeout=PATIENCE_S)
        except queue.Empty:
            found = TrocarError(f"{self._source.name}: could not be read within {PATIENCE_S:g} s")
        if isinstance(found, TrocarError):
            self._failure, found = found, None
        self._next = found

    # ------------------------------------------------------------------ what is said

    def _tell(self, words: Sequence[str]) -> None:
        for word in words:
            _log.warning("%s", word)

    def report(self) -> MirrorReport:
        """Return how the arms followed so far."""
        arms: dict[str, ArmReport] = {}
        for name, twin in self.twins.twins.items():
            lags = self._lags[name]
            arms[name] = ArmReport(
                twin.heard,
                round(twin.rate, 2),
                round(1e3 * lags.median, 3),
                round(1e3 * lags.largest, 3),
                twin.gaps,
                twin.clipped,
                twin.refused,
            )
        firsts = [t.first for t in self.twins.twins.values() if t.first is not None]
        lasts = [t.last for t in self.twins.twins.values() if t.last is not None]
        lasted = max(lasts) - min(firsts) if firsts and lasts else 0.0
        return MirrorReport(self._source.name, lasted, arms, tuple(self.twins.missing))

    def page(self) -> str:
        """Return a table for the page: each arm, how often it is heard, how late it is."""
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{self._state(name)}</td>"
            f"<td>{arm.rate_hz:.0f} Hz</td><td>{arm.lag_ms_median:.1f} ms</td></tr>"
            for name, arm in self.report().arms.items()
        )
        name = self._source.name if self._bag is None else Path(self._source.name).name
        head = "<tr><th></th><th>state</th><th>rate</th><th>lag</th></tr>"
        return (
            f'<div data-trocar="mirror"><b>mirrors {escape(name)}</b>'
            f"<table>{head}{rows}</table></div>"
        )

    def _state(self, name: str) -> str:
        twin = self.twins.twins[name]
        if not twin.heard:
            return "not heard yet"
        if self.over.is_set():
            return "over, holds"
        return '<b class="bad">silent, holds</b>' if twin.silent else "follows"
