"""What other programs see of a running simulator: rates, lateness, latency, processor time.

A simulator and a subscriber run in processes of their own; rates and
times are medians of several runs, losses the most of any. First, in this process, what making the
states costs.
"""

from __future__ import annotations

import importlib.util
import statistics
import subprocess
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from trocar.apps.benchmarks.figure import Figure
from trocar.apps.benchmarks.subscribers import (
    WAYS,
    Heard,
    arrived,
    listened,
    read,
    serving,
    started,
    told,
)
from trocar.descriptions.catalogue import DATA
from trocar.errors import InputError, UnknownNameError
from trocar.interfaces.crtk import Core
from trocar.interfaces.crtk.scene import CONTACTS
from trocar.interfaces.crtk.transport import Batch
from trocar.interfaces.crtk.transports.memory import MemoryTransport
from trocar.interfaces.crtk.transports.websocket.parcel import PACKING
from trocar.interfaces.loop import Loop
from trocar.simulation import World

#: How long streams are listened to. Source: our own choice. [s]
DURATION_S = 10.0
#: How often each is. Source: the project's own goal: medians of three runs.
RUNS = 3
RATE_HZ, FAST_HZ = 220.0, 1000.0
ARMS = ("PSM1", "PSM2", "PSM3", "ECM", "MTML", "MTMR")
#: Images of both eyes, what they are beside each state, and how often they come. Source: the
#: project's own goal.
CAMERA_HZ, PRESET = 60.0, "dvrk_sd_640x480"
#: The first image takes a second, and arms that settle are drawn anew now and then. Source: our own
#: choice. [s]
COME_TO_REST_S = 8.0
#: Share of what would come or go in a time if nothing was lost: ends are cut off.
CAME = 0.99
#: Periods before those that are measured. Source: our own choice.
WARM_UP = 20
EYES = ("endoscope/left/image_raw", "endoscope/right/image_raw")
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
#: Commands whose answer is timed in a run. Source: our own choice.
COMMANDS = 40
#: Subscribers that come and are killed. Source: the project's own goal.
PASSERS_BY = 24
#: Source: the project's own goals.
MOST_LATE_PERCENT, MOST_LATENCY_MS, MOST_CORES, LEAST_FACTOR = 1.0, 3.0, 1.0, 0.995
#: Commands a second of a flood, and by how much the simulator's memory may grow. Source: the
#: project's own goal; our own choice: every queue is bounded. [1/s, MB]
FLOOD_HZ, MOST_GROWN_MB = 10_000.0, 20.0
#: Periods in which every state is made, at the rate of tf so that it is among them, and how long
#: that may take. Source: our own choice; the project's own goal. [Hz, ms]
PERIODS, TF_HZ, MOST_STATES_MS = 300, 50.0, 1.5


def interface(
    transports: Sequence[str] = ("websocket",),
    duration_s: float = DURATION_S,
    watch: Callable[[str], None] | None = None,
) -> list[Figure]:
    """Measure what a subscriber in a second process sees.

    Args:
        transports: "websocket", "ros1", "ros2"; for ROS 1 a master has to run at
            ROS_MASTER_URI
        duration_s: how long streams are listened to [s]
        watch: told what is measured next

    Raises:
        UnknownNameError: no such transport
        TrocarError: the simulator or the subscriber failed
    """
    for name in transports:
        if name not in WAYS:
            raise UnknownNameError("transport", name, WAYS)
        module, cure = WAYS[name].module
        if module and importlib.util.find_spec(module) is None:
            raise InputError(f"--transport {name}: no module {module!r} here; {cure}")
    parts = {
        "six arms and 20 objects at 220 Hz": _streams,
        "one arm at 1 kHz": _fast,
        "images beside them": _images,
        "commands": _answers,
        "subscribers that vanish": _vanishing,
        "a flood of commands": _flooded,
    }
    if watch is not None:
        watch("all state topics of the full cart")
    found = [state_topics()]
    for name in transports:
        for what, measure in parts.items():
            if watch is not None:
                watch(f"{name}: {what}")
            found += measure(name, duration_s)
    return found


def state_topics(periods: int = PERIODS) -> Figure:
    """Measure how long making and writing every state of the full cart takes, nothing sent.

    Args:
        periods: how many are measured; the median counts
    """
    loop = Loop(World("full_cart"), speed="max", tick_s=1.0 / TF_HZ)
    core, sink = Core(loop, rate_hz=TF_HZ), _Written()
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


class _Written(MemoryTransport):
    """Writes messages as the WebSocket does, and throws them away."""

    packing = PACKING

    def __init__(self) -> None:
        super().__init__([])
        self.states: set[str] = set()

    def send(self, batch: Batch) -> None:
        for topic, message in batch:
            if not isinstance(message, bytes):
                PACKING.encode(topic.type, message)
            if topic.rate != "event":
                self.states.add(topic.name)


def _streams(transport: str, duration_s: float) -> list[Figure]:
    seen: list[Heard] = []
    cores: list[float] = []
    topics = [f"{arm}/{state}" for arm in ARMS for state in STATES]
    topics += [f"scene/block{k}/measured_cp" for k in range(OBJECTS)]
    with (
        TemporaryDirectory() as folder,
        serving(transport, "--rig", busy_rig(folder), "--rate", f"{RATE_HZ:g}") as server,
    ):
        for _ in range(RUNS):
            before, began = server.processor_s(), time.monotonic()
            seen.append(listened(transport, server, RATE_HZ, topics, duration_s))
            cores.append((server.processor_s() - before) / (time.monotonic() - began))
    name = f"{transport}: "
    return [
        *_judged(f"{name}6 arms, {OBJECTS} objects at 220 Hz", seen),
        Figure(
            f"{name}real-time factor",
            _median(told.factor for told, _ in seen),
            "",
            LEAST_FACTOR,
            True,
        ),
        Figure(f"{name}processor of the server", statistics.median(cores), "cores", MOST_CORES),
    ]


def _images(transport: str, duration_s: float) -> list[Figure]:
    """Listen to both eyes beside all states, three times as long."""
    topics = [f"{arm}/{state}" for arm in ARMS for state in STATES]
    topics += [f"scene/block{k}/measured_cp" for k in range(OBJECTS)]
    eyes = [eye + WAYS[transport].images for eye in EYES]
    options = ("--rate", f"{RATE_HZ:g}", "--camera-rate", f"{CAMERA_HZ:g}", "--preset", PRESET)
    with (
        TemporaryDirectory() as folder,
        serving(transport, "--rig", busy_rig(folder), *options) as server,
    ):
        told("listen", transport, server.address, f"{COME_TO_REST_S:g}", *eyes)
        before, began = server.processor_s(), time.monotonic()
        words = (server.address, f"{RUNS * duration_s:g}", *topics, *eyes)
        heard = told("listen", transport, *words)
        cores = (server.processor_s() - before) / (time.monotonic() - began)
    seen = arrived({eye: heard.pop(eye) for eye in eyes}, CAMERA_HZ, 1.0 / CAMERA_HZ)
    states = arrived(heard, RATE_HZ)
    expected = len(eyes) * CAMERA_HZ * RUNS * duration_s
    name = f"{transport}: 2 images of 640 x 480 at 60 Hz beside them, at rest"
    return [
        Figure(f"{name}: came", seen.received, "images", CAME * expected, True),
        Figure(f"{name}: lost, or late by a period", seen.lost + seen.late, "images", 0.0),
        Figure(f"{name}: states lost", states.lost, "messages", 0.0),
        Figure(f"{name}: real-time factor", states.factor, "", LEAST_FACTOR, True),
        Figure(f"{name}: processor of the server", cores, "cores"),
    ]


def busy_rig(folder: str) -> str:
    """Write a rig of six arms, setup joints and twenty objects, and return its path."""
    text = (DATA / "rigs" / "full_cart_mtm.toml").read_text(encoding="utf-8")
    for k in range(OBJECTS):
        text += BLOCK.format(k=k, x=-80.0 + 40.0 * (k % 4), y=1800.0 + 40.0 * (k // 4))
    path = Path(folder) / "busy.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def _fast(transport: str, duration_s: float) -> list[Figure]:
    topics = [f"PSM1/{state}" for state in STATES]
    with serving(transport, "--rig", "psm", "--rate", f"{FAST_HZ:g}") as server:
        seen = [listened(transport, server, FAST_HZ, topics, duration_s) for _ in range(RUNS)]
    return _judged(f"{transport}: one arm at 1 kHz", seen)


def _answers(transport: str, _: float) -> list[Figure]:
    with serving(transport, "--rig", "psm", "--rate", f"{FAST_HZ:g}") as server:
        took = [told("answers", transport, server.address, str(COMMANDS)) for _ in range(RUNS)]
    median = statistics.median(statistics.median(run) for run in took)
    name = f"{transport}: command to first measured motion, median"
    return [Figure(name, 1e3 * median, "ms", MOST_LATENCY_MS)]


def _vanishing(transport: str, duration_s: float) -> list[Figure]:
    """Listen while others subscribe to the same and are killed."""
    topics = [f"PSM1/{state}" for state in STATES]
    with serving(transport, "--rig", "full_cart", "--rate", f"{RATE_HZ:g}") as server:
        watcher = started("listen", transport, server.address, f"{duration_s:g}", *topics)
        others: list[subprocess.Popen[str]] = []
        try:
            pause = duration_s / PASSERS_BY
            for _ in range(PASSERS_BY):
                others.append(started("listen", transport, server.address, "60", *topics))
                time.sleep(pause)
                if len(others) > 2:
                    others.pop(0).kill()
            heard = read(watcher)
        finally:
            for other in (watcher, *others):
                other.kill()
    seen = arrived(heard, RATE_HZ)
    name = f"{transport}: {PASSERS_BY} subscribers come and are killed: lost by another one"
    return [Figure(name, seen.lost, "messages", 0.0)]


def _flooded(transport: str, duration_s: float) -> list[Figure]:
    """Listen while somebody sends more commands than anybody can obey."""
    topics = [f"PSM1/{state}" for state in STATES]
    with serving(transport, "--rig", "psm", "--rate", f"{RATE_HZ:g}") as server:
        watcher = started("listen", transport, server.address, f"{duration_s:g}", *topics)
        before = server.memory_mb()
        try:
            sent = told("flood", transport, server.address, f"{FLOOD_HZ:g}", f"{duration_s:g}")
            heard = read(watcher)
        finally:
            watcher.kill()
        grown = server.memory_mb() - before
    seen = arrived(heard, RATE_HZ)
    name = f"{transport}: a flood of commands"
    return [
        Figure(f"{name}: sent", sent, "1/s", CAME * FLOOD_HZ, True),
        Figure(f"{name}: states lost by another one", seen.lost, "messages", 0.0),
        Figure(f"{name}: real-time factor", seen.factor, "", LEAST_FACTOR, True),
        Figure(f"{name}: memory of the server grew by", grown, "MB", MOST_GROWN_MB),
    ]


def _judged(name: str, runs: list[Heard]) -> list[Figure]:
    late, woken = (_median(run.late_percent for run in kind) for kind in zip(*runs, strict=True))
    return [
        Figure(f"{name}: lost", max(run.lost for run, _ in runs), "messages", 0.0),
        Figure(f"{name}: late by more than 2 ms", late, "%", MOST_LATE_PERCENT),
        Figure(f"{name}: a process that only sleeps wakes as late", woken, "%"),
    ]


def _median(values: Iterable[float]) -> float:
    return float(statistics.median(values))
