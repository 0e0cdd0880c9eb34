"""How many stereo pictures a second: ours beside those of MuJoCo's own renderer, and live."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from trocar.apps.benchmarks.figure import Figure
from trocar.apps.benchmarks.live_scope import LIVE_S, live
from trocar.apps.benchmarks.swinging import INSTRUMENTS, MOVE
from trocar.descriptions.cameras import load_stereo_camera
from trocar.rendering import Channels, Look, Renderer
from trocar.rendering.reference import Reference
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import Snapshot

#: Pairs a second without a graphics card, and with one, of these presets. Source: the project's own
#: goals.
GOALS: Mapping[str, float] = {
    "dvrk_sd_640x480": 70.0,
    "hd_1280x720": 38.0,
    "hd_1920x1080": 30.0,
}
CARD_GOALS: Mapping[str, float] = {"hd_1280x720": 1000.0}
#: Ours over MuJoCo's at the first of them; all of depth, ids and colour over colour alone.
LEAST_RATIO, MOST_MORE = 3.5, 1.3
#: Triangles that a view may have. Source: the project's own goal.
MOST_TRIANGLES = 20_000
#: What moves, and so often a picture of it is taken: nothing can be kept from one to the next.
RIG, POSE, SNAPSHOTS, APART = "full_cart", "work", 16, 16
#: Pictures that one renderer draws before the next has its turn. Source: our own choice.
IN_A_ROW = 7
#: How long each picture is measured. Source: our own choice. [s]
DURATION_S = 4.0

Draw = Callable[[int], object]


def scope(
    duration_s: float = DURATION_S,
    watch: Callable[[str], None] | None = None,
    live_s: float = LIVE_S,
    onlooker: str | None = None,
) -> list[Figure]:
    """Measure the endoscope of the full cart, in motion, with its meshes.

    Both draw the same snapshots, with a shadow map of 1024 and one sample a pixel.

    Args:
        duration_s: how long each size is measured [s]
        watch: told what is measured next
        live_s, onlooker: of the live part: how long it is [s], and as of `live`

    Raises:
        MissingExtraError: the extra `scope` is not installed
        TrocarError: there is no OpenGL
    """
    tell = watch or (lambda _: None)
    world = World(RIG)
    snapshots, record = in_motion(world)
    found: list[Figure] = []
    for preset in GOALS:
        tell(f"stereo pictures, {preset}")
        eyes = load_stereo_camera(preset)
        found += sizes(world, snapshots, record.seeing(eyes), preset, duration_s)
    found += live(live_s, tell, onlooker)
    return found


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
    cameras = {record.name: record}
    shapes = world.shapes()
    plain, whole = (
        Renderer(
            lambda: (snapshots[0].build, shapes), channels, Look(shadow_size=1024, exposure=0.0)
        )
        for channels in (Channels(), Channels(depth=True, ids=True))
    )
    draws: dict[str, Draw] = {
        "ours": lambda k: plain.render(snapshots[k], cameras, record.name),
        "with depth and ids": lambda k: whole.render(snapshots[k], cameras, record.name),
    }
    rig = record.calibration
    judge = Reference(world.rig, rig.eyes[0].size)
    draws["MuJoCo"] = lambda k: _by_mujoco(judge, snapshots[k], record)
    taken = timed(draws, duration_s)
    judge.close()
    goals = GOALS if plain.on_processor else CARD_GOALS
    ours = 1.0 / taken["ours"]
    yield Figure(f"{preset}: pairs, {plain.driver}", ours, "1/s", goals.get(preset), True)
    yield Figure(f"{preset}: pairs, MuJoCo's renderer", 1.0 / taken["MuJoCo"], "1/s")
    least = LEAST_RATIO if preset == next(iter(GOALS)) else None
    yield Figure(f"{preset}: ours over MuJoCo's", taken["MuJoCo"] / taken["ours"], "", least, True)
    more = taken["with depth and ids"] / taken["ours"]
    yield Figure(f"{preset}: time with depth and ids, over colour alone", more, "", MOST_MORE)
    yield Figure(f"{preset}: triangles in view", plain.triangles, "", MOST_TRIANGLES)
    plain.close()
    whole.close()


def timed(draws: Mapping[str, Draw], duration_s: float) -> dict[str, float]:
    """Return the median time of each, all taking turns so that a slow moment hits each [s]."""
    for draw in draws.values():
        draw(0)
    taken: dict[str, list[float]] = {name: [] for name in draws}
    end = time.perf_counter() + duration_s
    while time.perf_counter() < end or min(map(len, taken.values())) < 3:
        for name, draw in draws.items():
            for k in range(IN_A_ROW + 1):
                begun = time.perf_counter()
                draw(k)
                if k:  # the first finds the processor's memory full of another's picture
                    taken[name].append(time.perf_counter() - begun)
    return {name: statistics.median(times) for name, times in taken.items()}


def _by_mujoco(judge: Reference, snapshot: Snapshot, record: CameraRecord) -> list[np.ndarray]:
    now = record.at(snapshot)
    judge.place(snapshot)
    return [
        judge.colour(T, eye) for T, eye in zip(now.T_world_eyes, now.calibration.eyes, strict=True)
    ]
