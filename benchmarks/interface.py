"""Rates, lateness, latency and processor time of a simulator, as its clients measure them.

A simulator and its clients run in processes of their own; rates and times are medians of several
runs, losses the most of any. First, in this process, the cost of making the states is measured.
"""

from __future__ import annotations

import importlib.util
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.served import Served, served
from trocar.descriptions.catalogue import DATA
from trocar.errors import InputError, TrocarError, UnknownNameError
from trocar.live.loop import Loop
from trocar.robot.verification.figures import Figure
from trocar.ros import Core
from trocar.ros.core import Batch
from trocar.ros.sample import CONTACTS
from trocar.ros.transports.memory import MemoryTransport
from trocar.ros.transports.websocket.server import encode
from trocar.simulation import World

#: Time of a subscription, and runs. Source: the project's own goal: medians of three runs. [s]
DURATION_S, RUNS = 10.0, 3
RATE_HZ, FAST_HZ = 220.0, 1000.0
#: Images of both eyes, and their rate. Source: the project's own goal.
CAMERA_HZ, PRESET = 60.0, "dvrk_sd_640x480"
EYES = ("endoscope/left/image_raw", "endoscope/right/image_raw")
#: Time until arms are at rest and the first image is drawn. Source: our own choice. [s]
COME_TO_REST_S = 8.0
STATES = ("measured_js", "setpoint_js", "measured_cp", "local/measured_cp")
#: Blocks of 20 mm that lie on the table beside each other, four in a row. Source: the project's
#: own goal; the table is the rig's.
OBJECTS = 20
BLOCK = """
[[prop]]
name = "block{k}"
movable = true
mass_g = 10.0
xyz_mm = [{x}, {y}, 810.0]
source = "our own choice"
shape = [{{ kind = "box", center_mm = [0, 0, 0], size_mm = [20, 20, 20] }}]
"""
PSM1 = [f"PSM1/{state}" for state in STATES]
ARMS = [f"{arm}/{s}" for arm in ("PSM1", "PSM2", "PSM3", "ECM", "MTML", "MTMR") for s in STATES]
BUSY = [*ARMS, *(f"scene/block{k}/measured_cp" for k in range(OBJECTS))]
#: Commands of a run whose answers are timed, and subscribers that come and are killed. Source: our
#: own choice; the project's own goal.
COMMANDS, PASSERS_BY = 40, 24
#: Largest lateness of a message, share of late ones, latency, processor time, least real-time
#: factor. Source: the project's own goals. [s, %, ms, cores]
LATE_S, MOST_LATE_PERCENT, MOST_LATENCY_MS, MOST_CORES, LEAST_FACTOR = 0.002, 1.0, 3.0, 1.0, 0.995
#: Commands a second of a flood, growth of the simulator's memory, and the share of messages that
#: have to be counted, since ends are cut off. Source: the project's own goal. [1/s, MB]
FLOOD_HZ, MOST_GROWN_MB, COUNTED = 10_000.0, 20.0, 0.99
#: Periods in which every state is made, warm-up periods, the rate (tf's, so that it is among them),
#: and the time limit. Source: our own choice; the project's own goal. [Hz, ms]
PERIODS, WARM_UP, TF_HZ, MOST_STATES_MS = 300, 20, 50.0, 1.5

Stamps = NDArray[np.int64]


@dataclass(frozen=True)
class Arrivals:
    """One or several streams of messages.

    Attributes:
        received, lost, late: counts of messages
        worst_s: largest lateness [s]
        factor: stamped time over the time in which it came, of the slowest stream
    """

    received: int
    lost: int
    late: int
    worst_s: float
    factor: float

    @property
    def late_percent(self) -> float:
        """Share of late messages [%]."""
        return 100.0 * self.late / max(self.received, 1)


def arrivals(stamped: Stamps, received: Stamps, rate_hz: float, late_s: float = LATE_S) -> Arrivals:
    """Compare one stream with its absolute schedule: message k is due k periods after the first.

    The promptest message sets the beginning of the schedule, so a constant delay is not lateness,
    and a growing one is. The stamp of a message gives its k.

    Args:
        stamped: header stamps in order of arrival, (n,) [ns]
        received: arrival times by a clock of the subscriber's, (n,) [ns]
        rate_hz: of the stream
        late_s: bound of lateness [s]
    """
    if len(stamped) < 2:
        return Arrivals(len(stamped), 0, 0, 0.0, 0.0)
    period = 1e9 / rate_hz
    index = np.rint((stamped - stamped[0]) / period).astype(np.int64)
    behind = received - received[0] - index * period
    behind -= behind.min()
    lost = int(index.max() - index.min()) + 1 - len(np.unique(index))
    factor = float((stamped[-1] - stamped[0]) / max(received[-1] - received[0], 1))
    late = int((behind > 1e9 * late_s).sum())
    return Arrivals(len(stamped), lost, late, float(behind.max()) * 1e-9, factor)


def together(streams: list[Arrivals]) -> Arrivals:
    """Return the sum of streams; a silent one has a factor of 0."""
    return Arrivals(
        sum(s.received for s in streams),
        sum(s.lost for s in streams),
        sum(s.late for s in streams),
        max((s.worst_s for s in streams), default=0.0),
        min((s.factor for s in streams), default=0.0),
    )


@dataclass(frozen=True)
class Transport:
    """A simulator and clients over one transport.

    Attributes:
        name: of the transport
        words: options of `trocar sim`
        address: regular expression of the line that the simulator prints when it serves
        module, cure: what has to be importable, and how to install it
        environment: variables of both processes
        images: suffix of topics of images
    """

    name: str
    words: tuple[str, ...]
    address: str
    module: str = "websockets"
    cure: str = ""
    environment: Mapping[str, str] = field(default_factory=dict[str, str])
    images: str = ""

    def serve(self, *words: str) -> AbstractContextManager[Served]:
        """Run a simulator with these options until the block ends."""
        return served(["--no-page", *self.words, *words], self.address, self.environment)

    def start(self, what: str, *words: str) -> subprocess.Popen[str]:
        """Start a program of `client`."""
        return subprocess.Popen(
            [sys.executable, "-m", "benchmarks.client", what, self.name, *words],
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[1],
            env={**os.environ, **self.environment},
        )

    def run(self, what: str, *words: str) -> Any:
        """Run a program of `client` and return its result."""
        return result(self.start(what, *words))

    def listen(
        self, server: Served, rate_hz: float, topics: Sequence[str], duration_s: float
    ) -> tuple[Arrivals, Arrivals]:
        """Measure the arrivals at a subscriber, and the lateness of a process that only sleeps."""
        sleeper = self.start("sleep", f"{rate_hz:g}", f"{duration_s:g}")
        heard = self.run("listen", server.address, f"{duration_s:g}", *topics)
        return arrived(heard, rate_hz), arrived(result(sleeper), rate_hz)


TRANSPORTS = {
    each.name: each
    for each in (
        Transport("websocket", ("--websocket-port", "0"), r"ws://\S+", images="/compressed"),
        Transport(
            "ros1",
            ("--no-websocket", "--ros1"),
            r"https?://\S+",
            "rospy",
            "start a rosmaster and use the Python of `make ros1-venv` (docs/ros.md)",
        ),
        Transport(
            "ros2",
            ("--no-websocket", "--ros2", "dds"),
            r"ROS 2.*",
            "cyclonedds",
            "install the extra: pip install 'trocar[ros2]'",
            {
                "CYCLONEDDS_URI": "<General><Interfaces><NetworkInterface address='127.0.0.1'"
                " multicast='true'/></Interfaces></General>"
            },
        ),
    )
}


def result(process: subprocess.Popen[str]) -> Any:
    """Wait for a program and return its output.

    Raises:
        TrocarError: it failed
    """
    out, _ = process.communicate()
    if process.returncode != 0:
        raise TrocarError(f"the client ended with exit code {process.returncode}")
    return json.loads(out)


def arrived(
    heard: Mapping[str, Sequence[Sequence[int]]], rate_hz: float, late_s: float = LATE_S
) -> Arrivals:
    """Judge streams, {topic: (stamp, arrival) of each message [ns]}, together."""
    streams = [np.array(pairs, dtype=np.int64).reshape(-1, 2).T for pairs in heard.values()]
    return together([arrivals(stamps, came, rate_hz, late_s) for stamps, came in streams])


def interface(
    transports: Sequence[str], duration_s: float, watch: Callable[[str], None]
) -> list[Figure]:
    """Measure what a client in a second process sees.

    Args:
        transports: names of TRANSPORTS; for ROS 1 a master has to run at ROS_MASTER_URI
        duration_s: time of each subscription [s]
        watch: called with what is measured next

    Raises:
        UnknownNameError: no such transport
        TrocarError: the simulator or the client failed
    """
    for name in transports:
        if name not in TRANSPORTS:
            raise UnknownNameError("transport", name, TRANSPORTS)
        module, cure = TRANSPORTS[name].module, TRANSPORTS[name].cure
        if importlib.util.find_spec(module) is None:
            raise InputError(f"--transport {name}: no module {module!r} here; {cure}")
    parts = {
        "six arms and 20 objects at 220 Hz": _streams,
        "one arm at 1 kHz": _fast,
        "images beside them": _images,
        "commands": _answers,
        "subscribers that vanish": _vanishing,
        "a flood of commands": _flooded,
    }
    watch("all state topics of the full cart")
    found = [state_topics()]
    for name in transports:
        for what, measure in parts.items():
            watch(f"{name}: {what}")
            found += measure(TRANSPORTS[name], duration_s)
    return found


def state_topics(periods: int = PERIODS) -> Figure:
    """Measure the median time of making and encoding every state of the full cart.

    Args:
        periods: publication periods that are measured
    """
    loop = Loop(World("full_cart"), speed="max", tick_s=1.0 / TF_HZ)
    core, sink = Core(loop, rate_hz=TF_HZ), _Encoder()
    core.attach(sink)
    core.begin()
    states = (t.name for t in core.topics.values() if t.rate in ("state", "tf"))
    sink.want(*(name for name in states if name != CONTACTS))  # the cart touches nothing
    took: list[float] = []
    for _ in range(WARM_UP + periods):
        loop.tick()
        before = time.perf_counter()
        core.publish_waiting()
        took.append(time.perf_counter() - before)
    core.close()
    loop.close()
    name = f"all {len(sink.states)} state topics of the full cart, made and written as JSON"
    return Figure(name, 1e3 * statistics.median(took[WARM_UP:]), "ms a period", MOST_STATES_MS)


class _Encoder(MemoryTransport):
    """Encodes messages as the WebSocket does, and sends none."""

    def __init__(self) -> None:
        super().__init__([])
        self.states: set[str] = set()

    def send(self, batch: Batch) -> None:
        for topic, message in batch:
            encode(topic.type, message)
            if topic.rate != "event":
                self.states.add(topic.name)


def busy_rig(folder: str, data: Path = DATA) -> str:
    """Write a rig of six arms, setup joints and twenty objects, and return its path.

    Args:
        folder: to write into
        data: descriptions of the tree that has to read it
    """
    text = (data / "rigs" / "full_cart_mtm.toml").read_text(encoding="utf-8")
    for k in range(OBJECTS):
        text += BLOCK.format(k=k, x=-80.0 + 40.0 * (k % 4), y=1800.0 + 40.0 * (k // 4))
    path = Path(folder) / "busy.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def _streams(transport: Transport, duration_s: float) -> list[Figure]:
    seen: list[tuple[Arrivals, Arrivals]] = []
    cores: list[float] = []
    with (
        TemporaryDirectory() as folder,
        transport.serve("--rig", busy_rig(folder), "--rate", f"{RATE_HZ:g}") as server,
    ):
        for _ in range(RUNS):
            before, began = server.processor_s(), time.monotonic()
            seen.append(transport.listen(server, RATE_HZ, BUSY, duration_s))
            cores.append((server.processor_s() - before) / (time.monotonic() - began))
    name, factor = f"{transport.name}: ", statistics.median(told.factor for told, _ in seen)
    return [
        *_judged(f"{name}6 arms, {OBJECTS} objects at 220 Hz", seen),
        Figure(f"{name}real-time factor", factor, "", lower=LEAST_FACTOR),
        Figure(f"{name}processor of the server", statistics.median(cores), "cores", MOST_CORES),
    ]


def _fast(transport: Transport, duration_s: float) -> list[Figure]:
    with transport.serve("--rig", "psm", "--rate", f"{FAST_HZ:g}") as server:
        seen = [transport.listen(server, FAST_HZ, PSM1, duration_s) for _ in range(RUNS)]
    return _judged(f"{transport.name}: one arm at 1 kHz", seen)


def _judged(name: str, runs: list[tuple[Arrivals, Arrivals]]) -> list[Figure]:
    late, woken = (
        statistics.median(run.late_percent for run in kind) for kind in zip(*runs, strict=True)
    )
    return [
        Figure(f"{name}: lost", max(run.lost for run, _ in runs), "messages", 0.0),
        Figure(f"{name}: late by more than 2 ms", late, "%", MOST_LATE_PERCENT),
        Figure(f"{name}: a process that only sleeps wakes as late", woken, "%"),
    ]


def _images(transport: Transport, duration_s: float) -> list[Figure]:
    """Listen to both eyes beside all states, three times as long."""
    eyes = [eye + transport.images for eye in EYES]
    options = ("--rate", f"{RATE_HZ:g}", "--camera-rate", f"{CAMERA_HZ:g}", "--preset", PRESET)
    with (
        TemporaryDirectory() as folder,
        transport.serve("--rig", busy_rig(folder), *options) as server,
    ):
        transport.run("listen", server.address, f"{COME_TO_REST_S:g}", *eyes)
        before, began = server.processor_s(), time.monotonic()
        heard = transport.run("listen", server.address, f"{RUNS * duration_s:g}", *BUSY, *eyes)
        cores = (server.processor_s() - before) / (time.monotonic() - began)
    seen = arrived({eye: heard.pop(eye) for eye in eyes}, CAMERA_HZ, 1.0 / CAMERA_HZ)
    states = arrived(heard, RATE_HZ)
    least = COUNTED * len(eyes) * CAMERA_HZ * RUNS * duration_s
    name = f"{transport.name}: 2 images of 640 x 480 at 60 Hz beside them, at rest"
    return [
        Figure(f"{name}: came", seen.received, "images", lower=least),
        Figure(f"{name}: lost, or late by a period", seen.lost + seen.late, "images", 0.0),
        Figure(f"{name}: states lost", states.lost, "messages", 0.0),
        Figure(f"{name}: real-time factor", states.factor, "", lower=LEAST_FACTOR),
        Figure(f"{name}: processor of the server", cores, "cores"),
    ]


def _answers(transport: Transport, _: float) -> list[Figure]:
    with transport.serve("--rig", "psm", "--rate", f"{FAST_HZ:g}") as server:
        took = [transport.run("answers", server.address, str(COMMANDS)) for _ in range(RUNS)]
    median = statistics.median(statistics.median(run) for run in took)
    name = f"{transport.name}: command to first measured motion, median"
    return [Figure(name, 1e3 * median, "ms", MOST_LATENCY_MS)]


def _vanishing(transport: Transport, duration_s: float) -> list[Figure]:
    """Listen while others subscribe to the same topics and are killed."""
    with transport.serve("--rig", "full_cart", "--rate", f"{RATE_HZ:g}") as server:
        watcher = transport.start("listen", server.address, f"{duration_s:g}", *PSM1)
        others: list[subprocess.Popen[str]] = []
        try:
            for _ in range(PASSERS_BY):
                others.append(transport.start("listen", server.address, "60", *PSM1))
                time.sleep(duration_s / PASSERS_BY)
                if len(others) > 2:
                    others.pop(0).kill()
            heard = result(watcher)
        finally:
            for other in (watcher, *others):
                other.kill()
    name = f"{transport.name}: {PASSERS_BY} subscribers come and are killed: lost by another one"
    return [Figure(name, arrived(heard, RATE_HZ).lost, "messages", 0.0)]


def _flooded(transport: Transport, duration_s: float) -> list[Figure]:
    """Listen while another client sends more commands than can be carried out."""
    with transport.serve("--rig", "psm", "--rate", f"{RATE_HZ:g}") as server:
        watcher = transport.start("listen", server.address, f"{duration_s:g}", *PSM1)
        before = server.memory_mb()
        try:
            sent = transport.run("flood", server.address, f"{FLOOD_HZ:g}", f"{duration_s:g}")
            heard = result(watcher)
        finally:
            watcher.kill()
        grown = server.memory_mb() - before
    seen = arrived(heard, RATE_HZ)
    name = f"{transport.name}: a flood of commands"
    return [
        Figure(f"{name}: sent", sent, "1/s", lower=COUNTED * FLOOD_HZ),
        Figure(f"{name}: states lost by another one", seen.lost, "messages", 0.0),
        Figure(f"{name}: real-time factor", seen.factor, "", lower=LEAST_FACTOR),
        Figure(f"{name}: memory of the server grew by", grown, "MB", MOST_GROWN_MB),
    ]
