"""What the cameras see, for all who look: drawn in a thread of its own, of the newest snapshot.

loop's thread --snapshot, if somebody looks and a picture is due--> newest only --drawn--> takers

Neither the physics nor a taker ever waits for a picture: a snapshot that is not drawn yet when the
next one comes is dropped, and counted.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import CancelledError
from types import MappingProxyType
from typing import TYPE_CHECKING

from trocar.errors import InputError, OvertakenError, TrocarError
from trocar.interfaces.packing import Packer
from trocar.interfaces.priority import let_others_go_first
from trocar.interfaces.shots import Order, Renderer, Shot, Taker
from trocar.interfaces.shutter import Shutter

if TYPE_CHECKING:
    from trocar.cameras.records import Calibration
    from trocar.interfaces.loop import Loop
    from trocar.interfaces.state import Elapsed
    from trocar.simulation import World
    from trocar.simulation.cameras import CameraRecord

_log = logging.getLogger("trocar")

#: Source: the cameras of the da Vinci; paper, section 3.4. [Hz]
RATE_HZ = 60.0
#: A picture that is this much early is in time. Source: as the core's beat. [s]
SLACK_S = 1e-6
#: Snapshots in a row that may not be drawn: of a rig whose tool was exchanged meanwhile.
MOST_REFUSED = 5
#: That drawing is slow is said so often [s]. Source: our own choice.
COMPLAIN_S = 30.0
#: Ticks until a look at the clock, where somebody else says when. Source: our own choice.
PATIENT = 1000
#: How long ending may take: a picture that is being drawn is drawn to its end [s].
FAREWELL_S = 5.0


class Pictures:
    """Draws for all takers.

    Args:
        loop: whose world is drawn
        open_renderer: makes what draws, called in the drawing thread when somebody first looks
        rate_hz: how often, above 0
        format: of packed pictures, "jpeg" or "png"
        calibrations: {camera: what its eyes are like, other than the rig says}

    Attributes:
        led: whether somebody else says when, by `shoot`; otherwise it is every 1 / rate_hz
        made, dropped: pictures drawn and handed on; those that were due and never drawn
        failure: why nothing is drawn any more, "" while all is well
    """

    def __init__(
        self,
        loop: Loop,
        open_renderer: Callable[[], Renderer],
        rate_hz: float = RATE_HZ,
        format: str = "jpeg",  # noqa: A002  the word of sensor_msgs
        calibrations: Mapping[str, Calibration] | None = None,
    ) -> None:
        if not 0.0 < rate_hz < float("inf"):
            raise InputError(f"camera rate: got {rate_hz:g} Hz; allowed: above 0")
        self._loop, self._open, self.rate_hz = loop, open_renderer, rate_hz
        self._packer = Packer(format)
        self._calibrations = dict(calibrations or {})
        self._takers: tuple[Taker, ...] = ()
        self._order: Order | None = None
        self._changed = threading.Condition()
        self._stopping = self._drawing = False
        self._thread: threading.Thread | None = None
        self._shutter = Shutter()
        self._unwatch: Callable[[], None] = lambda: None
        self._count = -1
        self._refused = 0
        self._complained = -COMPLAIN_S
        self.led = False
        self.made = self.dropped = 0
        self.failure = ""

    # ------------------------------------------------------------------ life

    def start(self) -> None:
        """Begin: draw when somebody looks."""
        self._thread = threading.Thread(target=self._run, name="trocar-pictures", daemon=True)
        self._thread.start()
        self._unwatch = self._loop.watch(self)

    def close(self) -> None:
        """End, once the picture in hand is drawn."""
        self._unwatch()
        with self._changed:
            self._stopping = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(FAREWELL_S)
            self._thread = None

    def add(self, taker: Taker) -> Callable[[], None]:
        """Hand pictures to somebody as well, until the function that is returned is called."""
        self._takers += (taker,)

        def leave() -> None:
            self._takers = tuple(t for t in self._takers if t is not taker)

        return leave

    # ------------------------------------------------------------------ the loop's thread

    def ticked(self, elapsed: Elapsed) -> None:  # noqa: ARG002  as every watcher
        """Let a picture be drawn when one is due and nobody else says when."""
        count = int((self._loop.now + SLACK_S) * self.rate_hz)  # of the wall, also in a pause
        due, self._count = count != self._count, count
        if not self.led and self.takes(due):
            self.shoot(self._loop.world)

    def refused(self, command: object, reason: str) -> None:
        """Commands are none of the cameras' business."""

    @property
    def idle(self) -> bool:
        """Whether nothing is drawn now, and nothing waits for it."""
        with self._changed:
            return self._order is None and not self._drawing

    def takes(self, due: bool) -> bool:
        """Tell whether to take a picture now; one that is owed when the next is due is dropped.

        Args:
            due: whether the next one is due since the last call
        """
        if due and self._shutter.owed:
            self._drop()
        with self._changed:
            return self._shutter.takes(due, free=self._order is None)

    @property
    def wanted(self) -> frozenset[str]:
        """Names of the cameras that somebody looks through now."""
        if self.failure:
            return frozenset()
        return frozenset[str]().union(*(taker.wanted() for taker in self._takers))

    def patience(self) -> int:
        """Return in how many ticks a picture may be due."""
        return PATIENT if self.led else 1

    def cameras(self, world: World) -> dict[str, CameraRecord]:
        """Return the cameras of a world with the eyes that they are given here."""
        found = world.cameras()
        for name, calibration in self._calibrations.items():
            if name in found:
                found[name] = found[name].seeing(calibration)
        return found

    def shoot(
        self,
        world: World,
        stamp: tuple[int, int] | None = None,
        beside: Mapping[str, Collection[str]] = MappingProxyType({}),
    ) -> Mapping[str, CameraRecord]:
        """Let the world be drawn as it is now; return its cameras, none when nobody looks.

        Args:
            world: of the loop
            stamp: what headers say
            beside: {camera: what is wanted beside its colours: "depth", "ids"}
        """
        wanted = self.wanted
        if not wanted:
            return {}
        now, snapshot = time.perf_counter(), world.snapshot(arms=False)
        order = Order(stamp, now, snapshot, self.cameras(world), wanted, beside)
        with self._changed:
            overtaken, self._order = self._order is not None, order
            self._changed.notify()
        if overtaken:
            self._drop()
        return order.cameras

    def _drop(self) -> None:
        """Count a picture that was due and is not drawn, and say so once a while."""
        self.dropped += 1
        now = time.perf_counter()
        if not self.led or not self.made:  # the page says it itself; the first takes long
            return
        if now - self._complained > COMPLAIN_S:
            self._complained = now
            _log.warning(
                "drawing is slower than %g Hz: %d pictures were dropped so far",
                self.rate_hz,
                self.dropped,
            )

    # ------------------------------------------------------------------ the drawing thread

    def _run(self) -> None:
        renderer: Renderer | None = None
        let_others_go_first()
        try:
            while (order := self._next()) is not None:
                if renderer is None:
                    renderer = self._open()
                self._draw(renderer, order)
                self._shutter.end()
        except CancelledError:  # the loop has ended, and answers no more
            pass
        except TrocarError as problem:
            self._fail(str(problem))
        except Exception as problem:  # noqa: BLE001  logged whole; the simulation goes on
            _log.exception("nothing is drawn any more")
            self._fail(repr(problem))
        finally:
            if renderer is not None:
                renderer.close()

    def _next(self) -> Order | None:
        """Wait for the newest order; None when all is over."""
        with self._changed:
            self._drawing = False
            self._changed.wait_for(lambda: self._order is not None or self._stopping)
            order, self._order = self._order, None
            self._drawing = not self._stopping
            self._shutter.begin()
            return None if self._stopping else order

    def _draw(self, renderer: Renderer, order: Order) -> None:
        """Draw; what was overtaken by an exchange of a tool cannot be drawn any more."""
        try:
            for camera in sorted(order.wanted & order.cameras.keys()):
                beside = order.beside.get(camera, ())
                frame = renderer.render(order.snapshot, order.cameras, camera, beside=beside)
                shot = Shot(camera, order, frame, self._packer)
                for taker in self._takers:
                    taker.take(shot)
                self.made += 1
        except OvertakenError:
            self._refused += 1
            self.dropped += 1
            if self._refused > MOST_REFUSED:
                raise
        else:
            self._refused = 0

    def _fail(self, reason: str) -> None:
        self.failure = reason
        with self._changed:
            self._drawing, self._order = False, None
        _log.warning("no pictures: %s", reason)
