"""Frames drawn in a thread of their own, always of the newest snapshot."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import cast

from trocar.errors import InputError, TrocarError
from trocar.rendering.frames import StereoFrame
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import Snapshot

_log = logging.getLogger("trocar")

Draw = Callable[[Snapshot, Mapping[str, CameraRecord]], StereoFrame]
#: A snapshot that is this much early is in time. Source: rounding of sums of periods. [s]
SLACK_S = 1e-9
#: How long ending may take: a frame that is being drawn is drawn to its end [s].
FAREWELL_S = 10.0


class Stream:
    """Takes snapshots where the world is stepped, and draws them elsewhere.

    A snapshot that is not drawn yet when the next one is due is dropped and counted; nothing waits
    in a queue, and the world never waits.

    Args:
        world: stepped by whoever has it
        draw: makes a frame
        rate_hz: frames a simulated second

    Attributes:
        made, dropped: frames drawn; snapshots that were overtaken before

    Raises:
        InputError: the rate is not above 0
    """

    def __init__(self, world: World, draw: Draw, rate_hz: float) -> None:
        if not isinstance(rate_hz, (int, float)) or not 0.0 < rate_hz < float("inf"):
            raise InputError(f"rate_hz: got {rate_hz!r}; allowed: above 0")
        self._world, self._draw, self._period = world, draw, 1.0 / rate_hz
        self._changed = threading.Condition()
        self._order: tuple[Snapshot, Mapping[str, CameraRecord]] | None = None
        self._newest: StereoFrame | None = None
        self._failure: TrocarError | None = None
        self._over = False
        self._due = world.time
        self.made = self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="endoscope", daemon=True)
        self._leave: Callable[[], None] = lambda: None

    def __enter__(self) -> Stream:
        self._thread.start()
        self._look()
        self._leave = self._world.observe(self._look, every=5)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    @property
    def newest(self) -> StereoFrame | None:
        """The newest frame, None before the first.

        Raises:
            TrocarError: why no more are drawn
        """
        with self._changed:
            self._check()
            return self._newest

    def wait(self, after: StereoFrame | None = None, timeout_s: float = 10.0) -> StereoFrame:
        """Return a frame that is newer than another one, or the first.

        Raises:
            TrocarError: there is none after the timeout, or why no more are drawn
        """

        def fresh() -> bool:
            frame = self._newest
            return self._failure is not None or (frame is not None and frame is not after)

        with self._changed:
            if not self._changed.wait_for(fresh, timeout_s):
                raise TrocarError(f"no new picture after {timeout_s:g} s; was the world stepped?")
            self._check()
            return cast(StereoFrame, self._newest)

    def stop(self) -> None:
        """Draw no more; the newest frame stays."""
        self._leave()
        with self._changed:
            self._over = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join(FAREWELL_S)

    # ------------------------------------------------------------------ inside

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _look(self) -> None:
        """Take a snapshot when one is due; called where the world is stepped."""
        time = self._world.time
        if self._due - self._period <= time + SLACK_S < self._due:  # else it was reset
            return
        self._due = time + self._period - (time - self._due) % self._period
        order = self._world.snapshot(arms=False), self._world.cameras()
        with self._changed:
            self.dropped += self._order is not None
            self._order = order
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._over or self._order is not None)
                order, self._order = self._order, None
                if self._over or order is None:
                    return
            try:
                frame = self._draw(*order)
            except Exception as problem:  # noqa: BLE001  told to whoever asks for a frame
                self._fail(problem)
                return
            with self._changed:
                self._newest = frame
                self.made += 1
                self._changed.notify_all()

    def _fail(self, problem: Exception) -> None:
        if not isinstance(problem, TrocarError):
            _log.exception("no more pictures")
        told = problem if isinstance(problem, TrocarError) else TrocarError(repr(problem))
        with self._changed:
            self._failure = told
            self._changed.notify_all()
