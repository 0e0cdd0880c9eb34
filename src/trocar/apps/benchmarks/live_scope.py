"""The endoscope while the cart runs in real time: what comes of 60 pairs a second, and when."""

from __future__ import annotations

import gc
import queue
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trocar.apps.benchmarks.arrivals import arrivals
from trocar.apps.benchmarks.figure import Figure
from trocar.apps.benchmarks.onlookers import browser, looking
from trocar.apps.benchmarks.swinging import swing
from trocar.descriptions.cameras import load_stereo_camera
from trocar.errors import TrocarError
from trocar.interfaces.crtk import Core
from trocar.interfaces.crtk.transport import Batch
from trocar.interfaces.loop import SERVER_TICK_S, Loop
from trocar.interfaces.pictures import Pictures
from trocar.interfaces.shots import Shot
from trocar.interfaces.viewer import serve
from trocar.rendering import Renderer, Series, StereoFrame
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import Snapshot

#: How long. Source: the project's own goal. [s]
LIVE_S = 60.0
RIG, POSE, PRESET, RATE_HZ = "full_cart", "work", "dvrk_sd_640x480", 60.0
#: Source: the project's own goals.
MOST_LATE_PERCENT, MOST_CORES, LEAST_FACTOR, MOST_BEYOND_MS = 1.0, 1.2, 0.995, 5.0
#: What a program listens to: both eyes and their lenses, and where they are.
EYES = tuple(f"endoscope/{eye}/image_raw" for eye in ("left", "right"))
WANTED = frozenset((*EYES, "endoscope/left/camera_info", "endoscope/right/camera_info", "tf"))
#: For all to be made, for a browser to come, to leave it alone then. Source: our own choice. [s]
READY_S, PATIENCE_S, SETTLE_S = 60.0, 60.0, 5.0
#: So many pictures for the page, and somebody looks at it. Source: our own choice.
WARM = 10
#: How long a thread may keep others waiting, as `trocar sim` has it [s].
SWITCH_S = 0.0001


class Listener:
    """A transport that notes when each pair of images is handed to it, and keeps none.

    Attributes:
        asks: whether it listens
        came: {stamp: arrival [s]}
    """

    name, packing = "listener", None

    def __init__(self) -> None:
        self.asks = False
        self.came: dict[tuple[int, int], float] = {}

    def start(self, core: Core) -> None:
        """Wait until it is to listen."""

    def wanted(self) -> frozenset[str]:
        """Return what is listened to."""
        return WANTED if self.asks else frozenset()

    def send(self, batch: Batch) -> None:
        """Note the arrival of a pair."""
        for topic, message in batch:
            if topic.name == EYES[-1]:
                self.came[message["header"]["stamp"]] = time.perf_counter()

    def close(self) -> None:
        """Nothing is open."""


class Stopwatch:
    """Draws as a series does, and notes when pictures were asked for and how long each took.

    Attributes:
        drawn: {stamp: (when its snapshot was taken, how long it was drawn)} [s]
    """

    def __init__(self, loop: Loop) -> None:
        self._loop, self._took_s = loop, 0.0
        self.drawn: dict[tuple[int, int], tuple[float, float]] = {}

    def open(self) -> Stopwatch:
        """Open the graphics library, in the thread that draws."""
        ask = self._loop.ask
        self._series = Series(
            Renderer(lambda: ask(lambda w: (w.snapshot(arms=False).build, w.shapes())).result())
        )
        return self

    def render(
        self,
        snapshot: Snapshot,
        cameras: Mapping[str, CameraRecord],
        camera: str,
        *,
        beside: Collection[str] = (),
    ) -> StereoFrame:
        """Draw."""
        begun = time.perf_counter()
        frame = self._series.render(snapshot, cameras, camera, beside=beside)
        self._took_s = time.perf_counter() - begun
        return frame

    def close(self) -> None:
        """Let go of the graphics library."""
        self._series.close()

    def wanted(self) -> tuple[str, ...]:
        """Ask for nothing."""
        return ()

    def take(self, shot: Shot) -> None:
        """Note what was drawn for others."""
        if shot.stamp is not None:
            self.drawn[shot.stamp] = shot.asked_s, self._took_s


@dataclass(frozen=True, eq=False)
class Run:
    """The cart as it runs: its loop and pictures, what is noted, and where its page is."""

    loop: Loop
    pictures: Pictures
    listener: Listener
    stopwatch: Stopwatch
    url: str


def live(
    duration_s: float = LIVE_S,
    watch: Callable[[str], None] | None = None,
    onlooker: str | None = None,
) -> list[Figure]:
    """Run the cart in real time at 1 kHz, its page in a browser, while both eyes are drawn.

    A program beside it gets 640x480 at 60 Hz with camera_info and tf.

    Args:
        duration_s: how long [s]
        watch: told what is measured
        onlooker: path of a headless browser, "" for a program that looks at the page in its place;
            a browser that is installed when omitted

    Raises:
        MissingExtraError: the extra `scope` is not installed
        TrocarError: there is no OpenGL, or nobody came
    """
    if onlooker is None:
        onlooker = browser() or ""
    who = Path(onlooker).name or "a program in place of a browser"
    if watch is not None:
        watch(f"real time with pictures, {who} looks at the page")
    with running() as run, looking(run.url, onlooker):
        be_looked_at(run, who)
        return list(measured(run, duration_s, who))


@contextmanager
def running() -> Iterator[Run]:
    """Serve the cart as `trocar sim` does, to a page and a program."""
    world = World(RIG)
    world.reset(pose=POSE)
    loop, listener = Loop(world, tick_s=SERVER_TICK_S), Listener()
    stopwatch = Stopwatch(loop)
    eyes = {"endoscope": load_stereo_camera(PRESET)}
    pictures = Pictures(loop, stopwatch.open, RATE_HZ, calibrations=eyes)
    core = Core(loop, camera_rate_hz=RATE_HZ, clock="sim", pictures=pictures)
    core.attach(listener)
    urls: queue.SimpleQueue[str] = queue.SimpleQueue()
    with ExitStack() as stack:
        stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_S)
        stack.enter_context(closing(pictures))
        pictures.start()
        stack.enter_context(closing(core))
        core.start()
        pictures.add(stopwatch)
        page = threading.Thread(
            target=serve,
            args=(world,),
            kwargs={"port": 0, "loop": loop, "pictures": pictures, "on_ready": urls.put},
            daemon=True,
        )
        page.start()
        stack.callback(page.join)
        stack.enter_context(closing(loop))
        try:
            url = urls.get(timeout=READY_S)
        except queue.Empty:
            raise TrocarError(f"the page was not served within {READY_S:g} s") from None
        gc.collect()
        stack.callback(gc.unfreeze)
        gc.freeze()
        yield Run(loop, pictures, listener, stopwatch, url)


def be_looked_at(run: Run, who: str) -> None:
    """Wait until somebody looks at the page, and all that happens once is over."""
    end, before = time.monotonic() + PATIENCE_S, run.pictures.made
    while run.pictures.made < before + WARM:
        if run.pictures.failure:
            raise TrocarError(run.pictures.failure)
        if time.monotonic() > end:
            raise TrocarError(f"{who}: did not look at {run.url} within {PATIENCE_S:g} s")
        time.sleep(0.1)
    run.listener.asks = True  # nobody else looked so far
    time.sleep(SETTLE_S)


def measured(run: Run, duration_s: float, who: str) -> Iterator[Figure]:
    """Count what comes for a while."""
    run.listener.came.clear()
    dropped, used = run.pictures.dropped, time.process_time()
    begun, then = time.perf_counter(), world_time(run.loop)
    swing(run.loop, begun + duration_s)
    passed, simulated = time.perf_counter() - begun, world_time(run.loop) - then
    cores = (time.process_time() - used) / passed
    dropped = run.pictures.dropped - dropped
    came = dict(run.listener.came)
    stamps = np.array([10**9 * s + ns for s, ns in came], dtype=np.int64)
    arrived = np.array(list(came.values()))
    seen = arrivals(stamps, np.rint(1e9 * arrived).astype(np.int64), RATE_HZ, 1.0 / RATE_HZ)
    known = [stamp for stamp in came if stamp in run.stopwatch.drawn]
    drawn = np.array([run.stopwatch.drawn[stamp] for stamp in known]).reshape(-1, 2)
    beyond = np.array([came[stamp] for stamp in known]) - drawn.sum(axis=1)
    late = 100.0 * (seen.late + dropped) / max(seen.received + dropped, 1)
    what = f"live, 640x480 at {RATE_HZ:g} Hz, {who} looks"
    yield Figure(f"{what}: real-time factor", simulated / passed, "", LEAST_FACTOR, True)
    yield Figure(f"{what}: pairs", seen.received / passed, "1/s")
    yield Figure(f"{what}: dropped, or late by a period", late, "%", MOST_LATE_PERCENT)
    yield Figure(f"{what}: drawing, median", 1e3 * _median(drawn[:, 1]), "ms")
    name = f"{what}: capture to publish beyond drawing, median"
    yield Figure(name, 1e3 * _median(beyond), "ms", MOST_BEYOND_MS)
    yield Figure(f"{what}: processor", cores, "cores", MOST_CORES)


def world_time(loop: Loop) -> float:
    """Return the simulated time of the newest state [s]."""
    return loop.ask(lambda world: world.time).result()


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else float("nan")
