"""Images of the cameras for all subscribers: drawn in a thread of its own, of the newest snapshot.

loop's thread --Order, if a subscriber and an image are due--> LatestOnly --Shot--> clients

Neither the physics nor a client ever waits for an image: a snapshot that is not drawn yet when the
next one comes is dropped, and counted.
"""

from __future__ import annotations

import io
import logging
import os
import sys
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.errors import InputError, OvertakenError, TrocarError, UnknownNameError
from trocar.live.loop import Loop
from trocar.live.state import PATIENT, Elapsed
from trocar.rendering.latest_only import InTurn, LatestOnly

if TYPE_CHECKING:
    from trocar.cameras.records import Calibration
    from trocar.simulation import World
    from trocar.simulation.cameras import CameraRecord
    from trocar.simulation.records import Snapshot

_log = logging.getLogger("trocar")

#: Default rate of images [Hz]. Source: the cameras of the da Vinci; paper, section 3.4.
RATE_HZ = 60.0
#: Tolerance of an image's time [s]. Source: as the core's beat.
SLACK_S = 1e-6
#: Consecutive snapshots that may be of another build, as after a tool exchange. Source: our own
#: choice.
MOST_REFUSED = 5
#: Interval of "rendering is slower" warnings [s]. Source: our own choice.
COMPLAIN_S = 30.0
#: Time limit of the last picture when drawing ends [s]. Source: our own choice.
FAREWELL_S = 5.0
#: Real-time factor below which drawing takes time from the arms. Source: our own choice: the
#: factor of a loop that keeps time is measured within 0.01.
BEHIND = 0.97
Format = Literal["jpeg", "png"]
FORMATS: tuple[str, ...] = get_args(Format)
Picture = NDArray[np.uint8]
#: Images that a client requests beside colours, now: {camera: "depth", "ids"}.
Beside = Callable[[], Mapping[str, Collection[str]]]
#: Takes a frame and an eye (0 left, 1 right); returns that eye's picture with overlays.
Overlay = Callable[[Any, int], Picture]

#: Quality of JPEG. Source: our own choice; 640x480 of an endoscope's view take about 40 kB.
QUALITY = 85
#: Compression level of PNG: quickly rather than small. Source: our own choice.
LEVEL = 1
#: Packed pictures that are kept: both eyes of two cameras. Source: our own choice.
KNOWN = 4
#: Longest time that a snapshot waits to be drawn [s]. Source: our own choice: images are taken with
#: states, every 4.5 ms, and drawing is not to wait long for the next one.
SOON_S = 0.005
#: Smoothing factor of the mean drawing time. Source: our own choice.
LEARNT = 0.1
#: Niceness of the drawing threads. Source: our own choice; see nice(2).
NICE = 5


class Packer:
    """Pack pictures as files; in one thread only.

    Pillow lets other threads run while it packs into a file, and not while it packs into memory:
    a tick of a millisecond would wait for it. So it gets a file that lies in memory.

    A read-only picture that comes again is not packed again.

    Args:
        format: "jpeg" or "png"

    Raises:
        UnknownNameError: another format
    """

    def __init__(self, format: str = "jpeg") -> None:  # noqa: A002  the word of sensor_msgs
        if format not in FORMATS:
            raise UnknownNameError("image format", format, FORMATS)
        self.format = format
        self._options = {"quality": QUALITY} if format == "jpeg" else {"compress_level": LEVEL}
        self._file: IO[bytes] | None = None
        self._known: deque[tuple[Picture, bytes]] = deque(maxlen=KNOWN)

    def pack(self, picture: Picture) -> bytes:
        """Return a picture (h, w, 3) or (h, w) as the bytes of a file."""
        if picture.flags.writeable:
            return self._packed(picture)
        for known, data in self._known:
            if known is picture:
                return data
        data = self._packed(picture)
        self._known.append((picture, data))
        return data

    def _packed(self, picture: Picture) -> bytes:
        image = Image.fromarray(picture)
        file = self._begun()
        image.save(file, self.format, **self._options)
        size = file.tell()
        file.seek(0)
        return file.read(size)

    def _begun(self) -> IO[bytes]:
        if self._file is None:
            self._file = _file_in_memory()
            weakref.finalize(self, self._file.close)
        self._file.seek(0)
        return self._file


def _file_in_memory() -> IO[bytes]:
    """Return a file with a descriptor where the system has such files, else a plain buffer."""
    make = getattr(os, "memfd_create", None)
    return io.BytesIO() if make is None else os.fdopen(make("trocar-picture"), "r+b", buffering=0)


class ImageRenderer(Protocol):
    """A renderer that is made, used and closed in one thread."""

    def render(
        self,
        snapshot: Snapshot,
        cameras: Mapping[str, CameraRecord],
        camera: str,
        *,
        beside: Collection[str] = (),
    ) -> Any:
        """Draw a camera: a frame with `left` and `right` (h, w, 3), `right` or None.

        Args:
            snapshot, cameras: of one moment
            camera: name of the one that is drawn
            beside: "depth", "ids": arrays that the frame has beside colours
        """
        ...

    def close(self) -> None:
        """Release the graphics library."""
        ...


@dataclass(frozen=True, eq=False)
class Order:
    """The world at one moment, and the cameras to draw.

    Attributes:
        stamp: of the messages' headers (s, ns), None without messages
        asked_s: wall time of the snapshot [s]
        snapshot, cameras: bodies and cameras, of one moment
        wanted: names of the subscribed cameras
        beside: {camera: "depth", "ids"}: images that are drawn beside colours
    """

    stamp: tuple[int, int] | None
    asked_s: float
    snapshot: Snapshot
    cameras: Mapping[str, CameraRecord]
    wanted: frozenset[str]
    beside: Mapping[str, Collection[str]] = field(default_factory=dict[str, Collection[str]])


class Shot:
    """The picture of one camera at one moment.

    Attributes:
        camera: its name
        record: its pose and its lenses, as in `World.cameras`
        frame: the picture or two, as the renderer made them
        stamp: of the messages' headers (s, ns), None without messages
        asked_s: wall time of the snapshot [s]
    """

    def __init__(
        self, camera: str, order: Order, frame: Any, packer: Packer, overlay: Overlay | None = None
    ) -> None:
        self.camera, self.record, self.frame = camera, order.cameras[camera], frame
        self.stamp, self.asked_s, self._packer = order.stamp, order.asked_s, packer
        self._overlay = overlay
        self._overlaid: dict[str, Picture] = {}
        self._packed: dict[tuple[str, bool], bytes] = {}

    @property
    def format(self) -> str:
        """Format of `packed`: "jpeg" or "png"."""
        return self._packer.format

    def eye(self, eye: str, *, overlaid: bool = False) -> Picture:
        """Return the picture of an eye, (h, w, 3); a camera with one has it on the left.

        Args:
            eye: "left" or "right"
            overlaid: with overlays, if there are any

        Raises:
            InputError: the overlay is no image of this size
        """
        if not overlaid or self._overlay is None:
            return self.frame.right if eye == "right" else self.frame.left
        if eye not in self._overlaid:
            picture = np.asarray(self._overlay(self.frame, int(eye == "right")))
            if picture.dtype != np.uint8 or picture.shape != self.frame.left.shape:
                raise InputError(
                    f"overlay: got an image of {picture.dtype} {picture.shape}; allowed: uint8"
                    f" {self.frame.left.shape}, as the frame has"
                )
            picture.setflags(write=False)
            self._overlaid[eye] = picture
        return self._overlaid[eye]

    @property
    def calibration(self) -> Calibration:
        """Calibration of the picture, without distortion where the picture has none."""
        return self.frame.calibration

    def packed(self, eye: str, *, overlaid: bool = False) -> bytes:
        """Return the picture of an eye as a file's bytes, packed once for all clients."""
        found = self._packed.get((eye, overlaid))
        if found is None:
            picture = self.eye(eye, overlaid=overlaid)
            found = self._packed[eye, overlaid] = self._packer.pack(picture)
        return found


def shots(
    renderer: ImageRenderer, order: Order, packer: Packer, overlay: Overlay | None = None
) -> Iterator[Shot]:
    """Draw the cameras of an order, one after the other.

    Raises:
        OvertakenError: the world was compiled anew since the order
        TrocarError: as of the renderer
    """
    for camera in sorted(order.wanted & order.cameras.keys()):
        beside = order.beside.get(camera, ())
        frame = renderer.render(order.snapshot, order.cameras, camera, beside=beside)
        yield Shot(camera, order, frame, packer, overlay)


class PictureClient(Protocol):
    """Receives pictures."""

    def wanted(self) -> Collection[str]:
        """Return the cameras that are requested now; called in the loop's thread: be quick."""
        ...

    def take(self, shot: Shot) -> None:
        """Receive a picture of a requested camera; called in the drawing thread."""
        ...


class DrawSchedule:
    """Decide in the loop's thread when to draw, from how long the drawing thread takes.

    Attributes:
        owed: whether a picture was due and is not drawn yet
    """

    def __init__(self) -> None:
        self.owed = False
        self._usual_s = 0.0
        self._began: float | None = None

    def starts(self, due: bool, free: bool = True) -> bool:
        """Decide whether to draw a picture now.

        Args:
            due: whether the next one is due since the last call
            free: whether none waits to be drawn
        """
        self.owed = self.owed or due
        taken = self.owed and free and self._soon_free()
        self.owed = self.owed and not taken
        return taken

    def begin(self) -> None:
        """Note that drawing begins."""
        self._began = time.perf_counter()

    def end(self) -> None:
        """Note that it is done."""
        began, self._began = self._began, None
        if began is not None:
            self._usual_s += LEARNT * (time.perf_counter() - began - self._usual_s)

    def _soon_free(self) -> bool:
        began = self._began
        return began is None or self._usual_s - (time.perf_counter() - began) < SOON_S


class Pictures:
    """Draw the cameras of a loop's world for all clients.

    Args:
        loop: of the world
        open_renderer: makes the renderer, called in the drawing thread at the first picture
        rate_hz: pictures a second, above 0
        format: of packed pictures, "jpeg" or "png"
        calibrations: {camera: calibration in place of the rig's}
        worker: draws; `InTurn` where the simulation is to wait for each picture

    Attributes:
        led: whether a publisher sets the times, by `shoot`; otherwise every 1 / rate_hz
        overlay: draws into pictures of those clients that request overlays; set before `start`
        made, dropped: pictures drawn and handed on; those that were due and never drawn
        failure: the reason why nothing is drawn any more, "" while all is well
    """

    def __init__(
        self,
        loop: Loop,
        open_renderer: Callable[[], ImageRenderer],
        rate_hz: float = RATE_HZ,
        format: str = "jpeg",  # noqa: A002  the word of sensor_msgs
        calibrations: Mapping[str, Calibration] | None = None,
        worker: type[LatestOnly[Order]] | type[InTurn[Order]] = LatestOnly,
    ) -> None:
        if not 0.0 < rate_hz < float("inf"):
            raise InputError(f"camera rate: got {rate_hz:g} Hz; allowed: above 0")
        self._loop, self._open, self.rate_hz = loop, open_renderer, rate_hz
        self._packer = Packer(format)
        self._calibrations = dict(calibrations or {})
        self._clients: tuple[tuple[PictureClient, Beside], ...] = ()
        self._worker = worker(self._draw, "trocar-pictures", self._end)
        self._renderer: ImageRenderer | None = None
        self._schedule = DrawSchedule()
        self._unwatch: Callable[[], None] = lambda: None
        self._count = -1
        self._refused = 0
        self._complained = -COMPLAIN_S
        self.led = False
        self.overlay: Overlay | None = None
        self.made = self.dropped = 0
        self.failure = ""

    # ------------------------------------------------------------------ life

    def start(self) -> None:
        """Begin: draw when a client requests a camera."""
        self._unwatch = self._loop.watch(self)

    def close(self) -> None:
        """End, once the picture in hand is drawn."""
        self._unwatch()
        self._worker.close(FAREWELL_S)

    def add(self, client: PictureClient, beside: Beside = dict) -> Callable[[], None]:
        """Add a client, until the function that is returned is called.

        Args:
            client: receives pictures
            beside: called after its `wanted`
        """
        self._clients += ((client, beside),)

        def leave() -> None:
            self._clients = tuple(pair for pair in self._clients if pair[0] is not client)

        return leave

    # ------------------------------------------------------------------ the loop's thread

    def ticked(self, elapsed: Elapsed) -> None:  # noqa: ARG002  as every watcher
        """Have a picture drawn when one is due and no publisher sets the times."""
        count = int((self._loop.now + SLACK_S) * self.rate_hz)  # of the wall, also in a pause
        due, self._count = count != self._count, count
        if not self.led and self.takes(due):
            self.shoot(self._loop.world)

    def refused(self, command: object, reason: str) -> None:
        """Do nothing: cameras have no commands."""

    @property
    def behind(self) -> bool:
        """Whether the loop falls behind real time."""
        return 0.0 < self._loop.real_time_factor < BEHIND

    @property
    def waiting(self) -> bool:
        """Whether a snapshot waits to be drawn."""
        return self._worker.waiting

    @property
    def idle(self) -> bool:
        """Whether nothing is drawn now, and nothing waits for it."""
        return self._worker.idle

    def takes(self, due: bool) -> bool:
        """Decide whether to take a picture now; one that is owed when the next is due is dropped.

        Args:
            due: whether the next one is due since the last call
        """
        if due and self._schedule.owed:
            self._drop()
        return self._schedule.starts(due, free=not self._worker.waiting)

    @property
    def wanted(self) -> frozenset[str]:
        """Names of the cameras that clients request now."""
        if self.failure:
            return frozenset()
        return frozenset[str]().union(*(client.wanted() for client, _ in self._clients))

    def patience(self) -> int:
        """Return the number of ticks within which no picture is due."""
        return PATIENT if self.led else 1

    def cameras(self, world: World) -> dict[str, CameraRecord]:
        """Return the cameras of a world with the calibrations that replace the rig's."""
        found = world.cameras()
        for name, calibration in self._calibrations.items():
            if name in found:
                found[name] = found[name].seeing(calibration)
        return found

    def shoot(
        self,
        world: World,
        stamp: tuple[int, int] | None = None,
    ) -> Mapping[str, CameraRecord]:
        """Have the world drawn as it is now; return its cameras, none without a request.

        Args:
            world: of the loop
            stamp: of the messages' headers (s, ns)
        """
        wanted = self.wanted
        if not wanted:
            return {}
        beside: dict[str, set[str]] = {}
        for _, requested in self._clients:
            for camera, names in requested().items():
                beside.setdefault(camera, set()).update(names)
        now, snapshot = time.perf_counter(), world.snapshot(arms=False)
        order = Order(stamp, now, snapshot, self.cameras(world), wanted, beside)
        if self._worker.put(order):
            self._drop()
        return order.cameras

    def _drop(self) -> None:
        """Count a picture that was due and is not drawn; warn once in COMPLAIN_S."""
        self.dropped += 1
        now = time.perf_counter()
        if not self.led or not self.made:  # the viewer shows it itself; the first takes long
            return
        if now - self._complained > COMPLAIN_S:
            self._complained = now
            _log.warning(
                "rendering is slower than %g Hz: %d images dropped so far",
                self.rate_hz,
                self.dropped,
                extra={"in_status": True},  # the web viewer has it in the cameras' status line
            )

    # ------------------------------------------------------------------ the drawing thread

    def _draw(self, order: Order) -> None:
        """Draw an order and hand its pictures to the clients; after a failure do nothing."""
        if self.failure:
            return
        self._schedule.begin()
        try:
            if self._renderer is None:
                let_others_go_first()
                self._renderer = self._open()
            for shot in shots(self._renderer, order, self._packer, self.overlay):
                for client, _ in self._clients:
                    client.take(shot)
                self.made += 1
            self._refused = 0
        except CancelledError:  # the loop has ended, and answers no more
            pass
        except OvertakenError as problem:  # a tool was exchanged since the snapshot
            self._refused += 1
            self.dropped += 1
            if self._refused > MOST_REFUSED:
                self._fail(str(problem))
        except TrocarError as problem:
            self._fail(str(problem))
        except Exception as problem:  # noqa: BLE001  logged whole; the simulation goes on
            _log.exception("rendering stopped")
            self._fail(repr(problem))
        self._schedule.end()

    def _fail(self, reason: str) -> None:
        self.failure = reason
        _log.warning("no images: %s", reason)
        self._end()

    def _end(self) -> None:
        renderer, self._renderer = self._renderer, None
        if renderer is not None:
            renderer.close()


def let_others_go_first() -> None:
    """Make the calling thread, and those that it starts, less urgent than the physics.

    Without a graphics card drawing takes every core that it gets, and the loop would be late.
    """
    if sys.platform == "linux":  # elsewhere this would concern the whole process
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
