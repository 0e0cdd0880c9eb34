"""Stitches through soft tissue: successes, errors, forces, closure and speed, over many seeds.

Each seed draws the wound's place (+-15 mm, +-20 deg), its stiffness (x 0.5 to 2) and the needle's
place (+-3 mm, +-20 deg), seen with 1 mm and 5 deg, in the jaws with 0.2 mm and 0.5 deg.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.suturing_scenes import suturing_scene
from trocar.errors import DivergedError, InputError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import transform
from trocar.learning.evaluation import wilson
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.tasks import run_episode
from trocar.tasks.scenes.suturing import Suturing
from trocar.tasks.suturing.planning import TipWorkspace

#: Ways of a jaw in each episode of random motion, and its speed: that of a stitch. Source: our own
#: choice. [m/s]
MOVES, RANDOM_M_S = 5, 0.1
#: Steps of MuJoCo alone that are timed after each episode. Source: our own choice.
BARE = 1000

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A case of the benchmark.

    Attributes:
        stitches, needle, tissue: as of `suturing_scene`
        noise: by that of the others
        share: of the seeds
        success: share of successes that is the goal; None: none is set
    """

    stitches: int = 1
    needle: str = ""
    tissue: str = "phantom"
    noise: float = 1.0
    share: float = 1.0
    success: float | None = None


#: Each case by its name. Source: our own choice.
CASES: dict[str, Case] = {
    "one": Case(success=0.96),
    "noisy": Case(noise=2.5, success=0.85),
    "36mm-half in skin": Case(needle="36mm-half", tissue="skin", share=0.1),
    "24mm-3/8 in phantom": Case(needle="24mm-3/8", share=0.1),
    "17mm-half in soft": Case(needle="17mm-half", tissue="soft", share=0.1),
    "four": Case(stitches=4, share=0.2, success=0.90),
}
#: Episodes of random motion by seeds of the others, and their case.
RANDOM, MANY = "random", 4


def suturing(
    episodes: int,
    watch: Callable[[str], None],
    only: Sequence[str] = (),
    kept: Path | None = None,
) -> list[Figure]:
    """Return the figures of all cases.

    Args:
        episodes: seeds of one stitch
        watch: receives progress
        only: cases that are run; none: all
        kept: file with a JSON document for each episode, to which they are added; those that are
            in it are not run again

    Raises:
        InputError: a case that is not known
    """
    for name in only:
        if name not in (*CASES, RANDOM):
            raise InputError(f"--case: got {name}; allowed: {', '.join((*CASES, RANDOM))}")
    rows: list[Row] = []
    if kept is not None and kept.exists():
        rows = [json.loads(line) for line in kept.read_text().splitlines()]

    def note(row: Row) -> None:
        rows.append(row)
        watch(f"{row['case']}: seed {row['seed']}: {row['end']}")
        if kept is not None:
            with kept.open("a") as file:
                file.write(json.dumps(row) + "\n")

    found: list[Figure] = []
    for name, case in CASES.items():
        if only and name not in only:
            continue
        seeds = range(max(1, round(case.share * episodes)))
        task: Suturing | None = None
        for seed in seeds:
            if not any((row["case"], row["seed"]) == (name, seed) for row in rows):
                task = task or _task(case)
                note({"case": name, "seed": seed, **_sewn(task, seed)})
        found += figures(name, case, [r for r in rows if r["case"] == name and r["seed"] in seeds])
    if not only or RANDOM in only:
        task = None
        for seed in range(MANY * episodes):
            if not any((row["case"], row["seed"]) == (RANDOM, seed) for row in rows):
                task = task or Suturing(suturing_scene())
                note({"case": RANDOM, "seed": seed, **_random_motion(task, seed)})
        moved = [r for r in rows if r["case"] == RANDOM and r["seed"] < MANY * episodes]
        speed = f"{1e3 * RANDOM_M_S:g} mm/s"
        words = f"{len(moved)} episodes of {MOVES} ways at {speed} with a jaw in tissue"
        bad = sum(row["end"] != "done" for row in moved)
        deep = max(row["deepest_mm"] for row in moved)
        found += [
            Figure("random motion: divergences", bad, "", upper=0.0, source=words),
            Figure("random motion: deepest dent", deep, "mm", source=words),
        ]
    return found


def _task(case: Case) -> Suturing:
    task = Suturing(suturing_scene(case.stitches, case.needle, case.tissue))
    task.noise = task.noise.scaled(case.noise)
    return task


def _sewn(task: Suturing, seed: int) -> Row:
    """Return the result of an episode, and the processor time of it and of its physics [s]."""
    step, spent = task.world.step, [0.0]

    def timed(n: int = 1) -> None:
        begin = time.process_time()
        step(n)
        spent[0] += time.process_time() - begin

    begin = time.process_time()
    task.world.step = timed
    try:
        episode = run_episode(task, seed)
    finally:
        task.world.step = step
    return {
        "end": episode.reason,
        "success": episode.success,
        "time_s": episode.time_s,
        "cpu_s": time.process_time() - begin,
        "physics_s": spent[0],
        "mujoco_us": _bare_us(task.world),
        "psm_us": _bare_us(_psm()),
        "stitches": [asdict(score) for score in task.watch.scores],
    }


def _bare_us(world: World) -> float:
    """Return the time of a step of MuJoCo alone from a world's state [us]."""
    model, data = world.mj_model, mujoco.MjData(world.mj_model)
    state = mujoco.mjtState.mjSTATE_INTEGRATION
    row = np.zeros(mujoco.mj_stateSize(model, state))
    mujoco.mj_getState(model, world.mj_data, row, state)
    mujoco.mj_setState(model, data, row, state)
    begin = time.process_time()
    mujoco.mj_step(model, data, BARE)
    return 1e6 * (time.process_time() - begin) / BARE


@cache
def _psm() -> World:
    """Return a PSM alone, by which machines are compared."""
    return World("psm")


def figures(name: str, case: Case, rows: Sequence[Row]) -> list[Figure]:
    """Return the figures of a case's episodes."""
    good = [row for row in rows if row["success"]]
    made = [stitch for row in good for stitch in row["stitches"]]
    low, high = wilson(len(good), len(rows))
    interval = f"95 % interval {100 * low:.1f} to {100 * high:.1f} % (Wilson), {len(rows)} seeds"
    share = len(good) / len(rows)
    found = [Figure(f"{name}: success", share, "", lower=case.success, source=interval)]
    if made:
        for key, what, unit, goal in (
            ("time_s", "time of a stitch", "s", 30.0),
            ("entry_mm", "entry error", "mm", 0.4),
            ("exit_mm", "exit error", "mm", 0.4),
            ("depth_mm", "depth error", "mm", 0.4),
            ("bites_mm", "difference of the bites", "mm", 0.5),
            ("gap_deep_mm", "gap at depth in the end", "mm", None),
            ("force_n", "largest force of tissue", "N", None),
            ("displacement_mm", "largest displacement of tissue", "mm", None),
            ("tension_n", "tension of the thread", "N", 2.0),
            ("press_n", "force of fingers on the surface", "N", None),
            ("slip_um", "slip in a jaw that holds", "um", 10.0),
            ("friction", "share of friction used", "", 0.8),
        ):
            values = np.array([one[key] for one in made])
            spread = f"median; 90 %: {np.quantile(values, 0.9):.2f}; largest {values.max():.2f}"
            found.append(
                Figure(f"{name}: {what}", float(np.median(values)), unit, upper=goal, source=spread)
            )
        gaps = np.array([one["gap_mm"] for one in made])
        closed = float((gaps <= 0.3).mean())
        note = f"stitches with 0.3 mm or less at the surface; largest {gaps.max():.2f} mm"
        found.append(Figure(f"{name}: closed", closed, "", lower=0.95, source=note))
        excess = max(one["excess_mm"] for one in made)
        found.append(
            Figure(f"{name}: thread too long by", excess, "mm", upper=0.5, source="largest")
        )
    for key, what, goals in (
        ("cpu_s", "speed with policy and scores", (5.0, 3.5)),
        ("physics_s", "speed of physics", (9.0, 5.0)),
    ):
        speed = sum(row["time_s"] for row in rows) / sum(row[key] for row in rows)
        note = "simulated time over processor time of whole episodes, one core"
        goal = goals[case.stitches > 1]
        found.append(Figure(f"{name}: {what}", speed, "", lower=goal, source=note))
    for key, what in (("mujoco_us", "the scene's"), ("psm_us", "a PSM's")):
        bare = float(np.median([row[key] for row in rows]))
        note = "MuJoCo alone, after each episode; median"
        found.append(Figure(f"{name}: {what} mj_step", bare, "us", source=note))
    unit = 1e-3 * sum(row["psm_us"] * row["time_s"] for row in rows)  # [s]
    for key, what in (("cpu_s", "with policy and scores"), ("physics_s", "of physics")):
        cost = sum(row[key] for row in rows) / unit
        note = "processor time over that of mj_step of a PSM, on any machine"
        found.append(Figure(f"{name}: a millisecond {what}", cost, "", source=note))
    return found


def _random_motion(task: Suturing, seed: int) -> Row:
    """Move a jaw at random in tissue; return whether it diverged, and the deepest dent."""
    world, deepest, end = task.world, 0.0, "done"
    tissue, size = task.tissue, task.tissue.tissue
    reach, arm = TipWorkspace(world, "PSM1"), world.arms["PSM1"]
    rng = np.random.default_rng([seed, 3])
    world.reset(seed)
    turn = rotation_z(rng.uniform(-0.5, 0.5)) @ np.diag([1.0, -1.0, -1.0])
    at = tissue.pose[:3, 3] + [0.0, 0.5 * size.width, 0.02]
    start, first = arm.joints.setpoints()[:-1], reach.all(transform(turn, at))[0]
    for k in range(100):
        arm.servo_jp(start + (k + 1) / 100 * (first - start))
        world.step(5)
    try:
        for _ in range(MOVES):
            away = rng.uniform(-1.0, 1.0, 3) * [0.4 * size.length, size.width, 0.006]
            goal = tissue.pose[:3, 3] + away + [0.0, 0.0, 0.0125]
            jaw = rng.uniform(-0.3, 0.6)
            for _ in range(round(float(np.linalg.norm(goal - at)) / (RANDOM_M_S * 0.005))):
                way = goal - at
                at = at + way * min(1.0, RANDOM_M_S * 0.005 / float(np.linalg.norm(way)))
                q = reach.near(transform(turn, at), arm.joints.setpoints()[:-1])
                if q is not None and arm.jaw is not None:
                    arm.servo_jp(q)
                    arm.jaw.servo_jp([jaw])
                world.step(5)
            deepest = min(deepest, float(tissue.displacements()[:, 2].min()))
    except DivergedError as problem:
        end = str(problem)
    return {"end": end, "deepest_mm": -1e3 * deepest}
