"""Stereo pictures a second: ours beside MuJoCo's own renderer, and live beside real time."""

from __future__ import annotations

import gc
import os
import queue
import shutil
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.interface import arrivals
from benchmarks.mujoco_renderer import Reference
from trocar.descriptions.cameras import load_stereo_camera
from trocar.errors import TrocarError
from trocar.geometry.se3 import transform_points
from trocar.live.images import Pictures, Shot
from trocar.live.loop import SERVER_TICK_S, Loop
from trocar.rendering import Channels, Look, Renderer, Series, StereoFrame
from trocar.rendering.look import vignette_of
from trocar.robot.verification.figures import Figure
from trocar.ros import Core
from trocar.ros.core import Batch
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import DrawnSurface, Snapshot
from trocar.tasks import make_task, scene_with
from trocar.viewer import serve

#: Sizes, and pairs a second with a graphics card. Source: the project's own goals.
PRESETS = "dvrk_sd_640x480", "hd_1280x720", "hd_1920x1080"
CARD_GOALS: Mapping[str, float] = {"dvrk_sd_640x480": 1000.0}
#: Goals: pairs a second over MuJoCo's; time with depth and ids over colour alone; surgical over
#: plain style, with tissue all over the picture; triangles in view. Source: the project's own
#: goals.
LEAST_RATIO: Mapping[str, float] = {"dvrk_sd_640x480": 3.5, "hd_1920x1080": 2.2}
MOST_MORE, MOST_SURGICAL, MOST_TRIANGLES = 1.3, 2.0, 20_000
#: Tissue: distance ahead of the camera, half its edge [m], and vertices along it.
TISSUE_M, HALF_M, VERTICES = 0.1, 0.08, 80
#: Scenes with tissue: least pairs a second in the surgical style, and in a cavity, over the plain
#: style on the table; pictures, and commands of the policy between them. Source: the project's own
#: goals.
SCENES, LEAST_STYLE, LEAST_CAVITY, DRIVEN = ("needle-pick", "suturing"), 0.5, 0.4, 8
#: Cart in motion: snapshots, and steps between them, so that no picture is reused.
RIG, POSE, SNAPSHOTS, APART = "full_cart", "work", 16, 16
INSTRUMENTS, MOVE, TURN_S = (
    ("PSM1", "PSM2", "PSM3"),
    np.array([0.05, 0.05, -0.005, 0.6, 0.3, -0.3]),
    0.5,
)
#: Pictures that one renderer draws in a row. Source: our own choice.
IN_A_ROW = 7
#: Time of each size, and of the live part [s]. Source: our own choice; the project's own goal.
DURATION_S, LIVE_S = 4.0, 60.0
LIVE_PRESET, LIVE_HZ = "dvrk_sd_640x480", 60.0
#: Goals of the live part [%, cores, -, ms, 1/s]. Source: the project's own goals.
MOST_LATE_PERCENT, MOST_CORES, LEAST_FACTOR, MOST_BEYOND_MS = 1.0, 1.5, 0.995, 5.0
LEAST_PAIRS = 45.0
#: Subscriptions of the live part: both eyes, their lenses and their frames.
EYES = tuple(f"endoscope/{eye}/image_raw" for eye in ("left", "right"))
TOPICS = frozenset((*EYES, "endoscope/left/camera_info", "endoscope/right/camera_info", "tf"))
#: Time limits of the server and of the browser, and settling time of the browser [s].
READY_S, PATIENCE_S, SETTLE_S = 60.0, 60.0, 5.0
#: Pictures after which the browser counts as a client. Source: our own choice.
WARM = 10
#: Thread switch interval, as `trocar sim` has it [s].
SWITCH_S = 0.0001
#: Names of browsers. Source: Debian's, Fedora's and Google's packages.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
    "--window-size=860,700",
)

Draw = Callable[[int], object]


def scope(
    duration_s: float = DURATION_S,
    watch: Callable[[str], None] = lambda _: None,
    live_s: float = LIVE_S,
    onlooker: str | None = None,
) -> list[Figure]:
    """Measure the endoscope of the full cart, in motion, with its meshes.

    Both renderers draw the same snapshots, with equal shadow maps and one sample a pixel.

    Args:
        duration_s: time of each size [s]
        watch: called with what is measured next
        live_s, onlooker: time of the live part [s], and its onlooker as of `live`

    Raises:
        MissingExtraError: the extra `scope` is not installed
        TrocarError: there is no OpenGL
    """
    world = World(RIG)
    snapshots, record = in_motion(world)
    found: list[Figure] = []
    for preset in PRESETS:
        watch(f"stereo pictures, {preset}")
        eyes = load_stereo_camera(preset)
        found += sizes(world, snapshots, record.seeing(eyes), preset, duration_s)
    for name in SCENES:
        watch(f"looks of {name}")
        found += looks(name, duration_s)
    return found + live(live_s, watch, onlooker)


def in_motion(world: World) -> tuple[list[Snapshot], CameraRecord]:
    """Return the cart at some moments of a motion, and its endoscope."""
    world.reset(pose=POSE)
    for name in INSTRUMENTS:
        arm = world.arm(name)
        arm.move_jp(arm.setpoint_js().position + MOVE)
    snapshots = []
    for _ in range(SNAPSHOTS):
        world.step(APART)
        snapshots.append(world.snapshot(arms=False))
    return snapshots, world.camera("endoscope")


def sizes(
    world: World,
    snapshots: list[Snapshot],
    record: CameraRecord,
    preset: str,
    duration_s: float,
) -> Iterator[Figure]:
    """Compare both renderers at one size."""
    cameras, shapes = {record.name: record}, world.shapes()
    plain, whole = (
        Renderer(lambda: (snapshots[0].build, shapes), channels, Look(exposure=0.0))
        for channels in (Channels(), Channels(depth=True, ids=True))
    )
    look, size = Look(exposure=-1.5), record.calibration.eyes[0].size
    alike, surgical = (
        Renderer(lambda: (snapshots[0].build, shapes), None, each)
        for each in (look, replace(look, style="surgical"))
    )
    over = [shot._replace(drawings=(tissue(record.at(shot)),)) for shot in snapshots]
    judge = Reference(world.rig, size, look.shadow_map(size[0], hard=True))

    def by_mujoco(k: int) -> list[np.ndarray]:
        now = record.at(snapshots[k])
        judge.place(snapshots[k])
        eyes = zip(now.T_world_eyes, now.calibration.eyes, strict=True)
        return [judge.colour(T, eye) for T, eye in eyes]

    taken = timed(
        {
            "ours": lambda k: plain.render(snapshots[k], cameras, record.name),
            "with depth and ids": lambda k: whole.render(snapshots[k], cameras, record.name),
            "MuJoCo": by_mujoco,
            "plain": lambda k: alike.render(over[k], cameras, record.name),
            "surgical": lambda k: surgical.render(over[k], cameras, record.name),
        },
        duration_s,
    )
    judge.close()
    goal = None if plain.on_processor else CARD_GOALS.get(preset)
    yield Figure(f"{preset}: pairs, {plain.driver}", 1.0 / taken["ours"], "1/s", lower=goal)
    begun = time.process_time()
    for shot in snapshots:
        plain.render(shot, cameras, record.name)
    spent = (time.process_time() - begun) / SNAPSHOTS
    yield Figure(f"{preset}: processor time of a pair", spent, "s", shown="ms")
    yield Figure(f"{preset}: pairs, MuJoCo's renderer", 1.0 / taken["MuJoCo"], "1/s")
    least = LEAST_RATIO.get(preset)
    ratio = taken["MuJoCo"] / taken["ours"]
    yield Figure(f"{preset}: ours over MuJoCo's", ratio, "", lower=least)
    more = taken["with depth and ids"] / taken["ours"]
    yield Figure(f"{preset}: time with depth and ids, over colour alone", more, "", MOST_MORE)
    style = taken["surgical"] / taken["plain"]
    yield Figure(f"{preset}: time in the surgical style, over plain", style, "", MOST_SURGICAL)
    yield Figure(f"{preset}: triangles in view", plain.triangles, "", MOST_TRIANGLES)
    for renderer in (plain, whole, alike, surgical):
        renderer.close()


def looks(name: str, duration_s: float) -> Iterator[Figure]:
    """Compare the looks of a scene with tissue, on its table and in a cavity, at one size."""
    eyes = load_stereo_camera(PRESETS[0])
    draws: dict[str, Draw] = {}
    with ExitStack() as stack:
        for look, place in (("plain", "table"), ("surgical", "table"), ("surgical", "cavity")):
            task = make_task(scene_with(name, {"surroundings": place}))
            task.reset(0)
            policy = task.policy()
            world, shots = task.world, [task.world.snapshot(arms=False)]
            while len(shots) < DRIVEN:
                for _ in range(DRIVEN):
                    task.command(next(policy))
                shots.append(world.snapshot(arms=False))
            vignette = vignette_of(world.rig)
            given = Look(look, exposure=0.0, vignette=vignette)  # type: ignore[arg-type]
            shapes = shots[0].build, world.shapes()
            renderer = Renderer(lambda shapes=shapes: shapes, None, given)
            stack.callback(renderer.close)
            cameras = {"endoscope": world.camera("endoscope").seeing(eyes)}
            draws[f"{look}, {place}"] = lambda k, r=renderer, s=shots, c=cameras: r.render(
                s[k], c, "endoscope"
            )
        # What else the processor does then counts for none of them.
        clock = time.process_time if renderer.on_processor else time.perf_counter
        taken = timed(draws, duration_s, clock)
    plain, *others = taken.items()
    for (what, took), least in zip(others, (LEAST_STYLE, LEAST_CAVITY), strict=True):
        yield Figure(f"{name}: pairs, {what} over {plain[0]}", plain[1] / took, "", lower=least)


def tissue(camera: CameraRecord) -> DrawnSurface:
    """Return a sheet of tissue that fills a camera's picture."""
    line = np.linspace(-HALF_M, HALF_M, VERTICES)
    x, y = np.meshgrid(line, line)
    bumps = TISSUE_M + 0.002 * np.sin(90.0 * x) * np.cos(70.0 * y)
    points = np.stack([x, y, bumps], axis=-1).reshape(-1, 3)
    a = (np.arange(VERTICES - 1)[:, None] * VERTICES + np.arange(VERTICES - 1)).ravel()
    b = a + VERTICES
    faces = np.concatenate([np.stack([a, b + 1, a + 1], 1), np.stack([a, b, b + 1], 1)])
    world = transform_points(camera.T_world_camera, points)
    return DrawnSurface("tissue", world, faces, material="tissue", rest=points)


def timed(
    draws: Mapping[str, Draw],
    duration_s: float,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Return the median time of each, in turn, so that a slow moment affects all [s]."""
    for draw in draws.values():
        draw(0)
    taken: dict[str, list[float]] = {name: [] for name in draws}
    end = time.perf_counter() + duration_s
    while time.perf_counter() < end or min(map(len, taken.values())) < 3:
        for name, draw in draws.items():
            for k in range(IN_A_ROW + 1):
                begun = clock()
                draw(k)
                if k:  # the first finds the caches full of another's picture
                    taken[name].append(clock() - begun)
    return {name: statistics.median(times) for name, times in taken.items()}


class Listener:
    """A transport that notes the arrival of each pair of images, and keeps none.

    Attributes:
        subscribed: whether it listens
        came: {stamp: arrival [s]}
    """

    name = "listener"

    def __init__(self) -> None:
        self.subscribed = False
        self.came: dict[tuple[int, int], float] = {}

    def start(self, core: Core) -> None:
        """Do nothing; `subscribed` switches it on."""

    def wanted(self) -> frozenset[str]:
        """Return the subscriptions."""
        return TOPICS if self.subscribed else frozenset()

    def send(self, batch: Batch) -> None:
        """Note the arrival of a pair."""
        for topic, message in batch:
            if topic.name == EYES[-1]:
                self.came[message["header"]["stamp"]] = time.perf_counter()

    def close(self) -> None:
        """Do nothing."""


class Stopwatch:
    """Draws as a series does, and notes when pictures were requested and how long each took.

    Attributes:
        drawn: {stamp: (time of its snapshot, time that drawing took)} [s]
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
        """Close the graphics library."""
        self._series.close()

    def wanted(self) -> tuple[str, ...]:
        """Request nothing."""
        return ()

    def take(self, shot: Shot) -> None:
        """Note a picture that was drawn for others."""
        if shot.stamp is not None:
            self.drawn[shot.stamp] = shot.asked_s, self._took_s


@dataclass(frozen=True, eq=False)
class Run:
    """The cart in real time: its loop, pictures, notes, and the address of its page."""

    loop: Loop
    pictures: Pictures
    listener: Listener
    stopwatch: Stopwatch
    url: str


def live(
    duration_s: float = LIVE_S,
    watch: Callable[[str], None] = lambda _: None,
    onlooker: str | None = None,
) -> list[Figure]:
    """Run the cart in real time at 1 kHz, its page in a browser, while both eyes are drawn.

    A program beside it gets 640x480 at 60 Hz with camera_info and tf.

    Args:
        duration_s: simulated and wall time [s]
        watch: called with what is measured
        onlooker: path of a headless browser, "" for a program that loads the page instead; an
            installed browser when omitted

    Raises:
        MissingExtraError: the extra `scope` is not installed
        TrocarError: there is no OpenGL, or the page was not loaded
    """
    if onlooker is None:
        onlooker = next((path for name in BROWSERS if (path := shutil.which(name))), "")
    who = Path(onlooker).name or "a program in place of a browser"
    watch(f"real time with pictures, {who} looks at the page")
    with running() as run, looking(run.url, onlooker):
        end, before = time.monotonic() + PATIENCE_S, run.pictures.made
        while run.pictures.made < before + WARM:
            if run.pictures.failure:
                raise TrocarError(run.pictures.failure)
            if time.monotonic() > end:
                raise TrocarError(f"{who}: did not load {run.url} within {PATIENCE_S:g} s")
            time.sleep(0.1)
        run.listener.subscribed = True  # nobody else looked so far
        time.sleep(SETTLE_S)
        return list(measured(run, duration_s, who))


@contextmanager
def running() -> Iterator[Run]:
    """Serve the cart as `trocar sim` does, to a page and a program."""
    world = World(RIG)
    world.reset(pose=POSE)
    loop, listener = Loop(world, tick_s=SERVER_TICK_S), Listener()
    stopwatch = Stopwatch(loop)
    eyes = {"endoscope": load_stereo_camera(LIVE_PRESET)}
    pictures = Pictures(loop, stopwatch.open, LIVE_HZ, calibrations=eyes)
    core = Core(loop, camera_rate_hz=LIVE_HZ, clock="sim", pictures=pictures)
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


@contextmanager
def looking(url: str, path: str = "") -> Iterator[None]:
    """Load a page in a browser until the block ends, or in a program without a path."""
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        words = (sys.executable, str(Path(__file__).with_name("spectator.py")), url)
        if path:
            root = ("--no-sandbox",) if hasattr(os, "geteuid") and os.geteuid() == 0 else ()
            words = (path, *FLAGS, *root, f"--user-data-dir={profile}", url)
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            yield
        finally:
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def swing(loop: Loop, end_s: float) -> None:
    """Move the instruments to and fro until `end_s`, a time of `perf_counter`."""
    home = loop.ask(lambda w: {k: w.arm(k).setpoint_js().position for k in INSTRUMENTS}).result()

    def send(world: World, way: float) -> None:
        for name, position in home.items():
            world.arm(name).move_jp(position + way * MOVE)

    away = 1.0
    while (left := end_s - time.perf_counter()) > 0.0:
        loop.ask(lambda world, way=away: send(world, way)).result()
        time.sleep(min(TURN_S, left))
        away = 1.0 - away


def measured(run: Run, duration_s: float, who: str) -> Iterator[Figure]:
    """Count what comes for a while."""
    run.listener.came.clear()
    dropped, used = run.pictures.dropped, time.process_time()
    begun, then = time.perf_counter(), run.loop.ask(lambda world: world.time).result()
    swing(run.loop, begun + duration_s)
    passed = time.perf_counter() - begun
    simulated = run.loop.ask(lambda world: world.time).result() - then
    cores = (time.process_time() - used) / passed
    dropped = run.pictures.dropped - dropped
    came = dict(run.listener.came)
    stamps = np.array([10**9 * s + ns for s, ns in came], dtype=np.int64)
    arrived = np.array(list(came.values()))
    seen = arrivals(stamps, np.rint(1e9 * arrived).astype(np.int64), LIVE_HZ, 1.0 / LIVE_HZ)
    known = [stamp for stamp in came if stamp in run.stopwatch.drawn]
    drawn = np.array([run.stopwatch.drawn[stamp] for stamp in known]).reshape(-1, 2)
    beyond = np.array([came[stamp] for stamp in known]) - drawn.sum(axis=1)
    drawing_ms, beyond_ms = (
        1e3 * float(np.median(values)) if len(values) else float("nan")
        for values in (drawn[:, 1], beyond)
    )
    late = 100.0 * (seen.late + dropped) / max(seen.received + dropped, 1)
    what = f"live, 640x480 at {LIVE_HZ:g} Hz, {who} looks"
    yield Figure(f"{what}: real-time factor", simulated / passed, "", lower=LEAST_FACTOR)
    yield Figure(f"{what}: pairs", seen.received / passed, "1/s", lower=LEAST_PAIRS)
    yield Figure(f"{what}: dropped, or late by a period", late, "%", MOST_LATE_PERCENT)
    yield Figure(f"{what}: drawing, median", drawing_ms, "ms")
    name = f"{what}: capture to publish beyond drawing, median"
    yield Figure(name, beyond_ms, "ms", MOST_BEYOND_MS)
    yield Figure(f"{what}: processor", cores, "cores", MOST_CORES)
