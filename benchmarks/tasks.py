"""Success, time, forces and speed of policies of scenes, over many seeds."""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import mujoco
import numpy as np
from scipy.stats import t as student

from trocar.descriptions.catalogue import load_scene, names
from trocar.errors import InputError
from trocar.learning.evaluation import CONFIDENCE, wilson
from trocar.learning.policies import PolicyFile
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.tasks import Episode, make_task, run_episode, task_names
from trocar.tasks.play import scripted

EPISODES = 50
#: Modules of scenes that benchmarks of their own measure.
APART = ("suturing", "vision")
#: Physics steps that measure the machine after each episode. Source: our own choice, 50 ms or less.
BARE_STEPS = 3000
#: Least share of successes: with one arm, and with two. Source: our own goals; the real dVRK has
#: 94.1 % in peg transfer (Hwang et al., IROS 2020).
ONE_ARM, TWO_ARMS = 0.99, 0.95
#: Least speed, times real time, and most time of a peg transfer. Source: our own goals; the real
#: dVRK takes 8.1 s (Hwang et al., IROS 2020).
ONE_SPEED, TWO_SPEED, TRANSFER_S = 15.0, 8.0, 8.1


def own_scenes() -> tuple[str, ...]:
    """Return the built-in scenes; `benchmarks suturing` and `vision` measure theirs."""
    named = {name: load_scene(name).task for name in names("scenes")}
    modules, apart = task_names(), tuple(f"trocar.tasks.scenes.{one}" for one in APART)
    return tuple(name for name, task in named.items() if modules.get(task) not in apart)


def tasks(
    scenes: Sequence[str],
    episodes: int,
    watch: Callable[[str], None],
    file: Path | None = None,
    *,
    policy: Path | None = None,
    trust: str | None = None,
) -> list[Figure]:
    """Return the figures of scenes, with seeds from 0 on.

    When none is named, of that of the policy, else of all built-in ones, and what an object costs
    that is asleep or awake.

    Args:
        scenes, episodes, watch: names, number of each, and function that reports progress
        file: keeps each episode as a line of JSON; those that it has are not run again
        policy: file of a policy; None: each scene's own one
        trust: not None: the policy may be unpickled
    """
    own = None if policy is None else PolicyFile(policy, trust is not None)
    if own is not None and not scenes:
        if not own.scene:
            raise InputError(f"--policy: {policy} is for any scene; allowed: with --scene")
        scenes = (own.scene,)
    found: list[Figure] = []
    for name in scenes or own_scenes():
        if own is not None:
            own.check(load_scene(name))
        watch(f"{name}, {episodes} episodes")
        found += figures(*_episodes(name, episodes, file, own))
    return found if scenes else [*found, *asleep_and_awake()]


def _episodes(
    name: str, episodes: int, file: Path | None, policy: PolicyFile | None
) -> tuple[list[Episode], float, float]:
    """Run the episodes of a scene that a file lacks; return the arguments of `figures`, of all."""
    script, who = (scripted, "scripted") if policy is None else (policy.script, policy.name)
    known: dict[int, tuple[Episode, float, float]] = {}
    if file is not None and file.exists():
        called = load_scene(name).name
        for line in file.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            theirs = row.pop("policy", "scripted") == who
            if theirs and row["scene"] == called and row["seed"] < episodes:
                cpu_s, step_s = row.pop("cpu_s"), row.pop("step_s")
                known[row["seed"]] = Episode(**row), cpu_s, step_s
    task = make_task(name) if len(known) < episodes else None
    for seed in range(episodes):
        if task is not None and seed not in known:
            begin = time.process_time()
            one = run_episode(task, seed, script=script)
            cpu_s, step_s = time.process_time() - begin, bare_step()
            known[seed] = one, cpu_s, step_s
            if file is not None:
                with file.open("a", encoding="utf-8") as out:
                    row = {**asdict(one), "cpu_s": cpu_s, "step_s": step_s, "policy": who}
                    out.write(json.dumps(row) + "\n")
    results, times, steps = zip(*(known[seed] for seed in range(episodes)), strict=True)
    return list(results), sum(times), float(np.median(steps))


def bare_step() -> float:
    """Return the processor time of MuJoCo's `mj_step` of a PSM that hangs by itself [s]."""
    model, data = _psm()
    begin = time.process_time()
    mujoco.mj_step(model, data, BARE_STEPS)
    return (time.process_time() - begin) / BARE_STEPS


@functools.cache
def _psm() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = World("psm", dynamics="cad").mj_model
    return model, mujoco.MjData(model)


def asleep_and_awake() -> list[Figure]:
    """Return the time of a step with a ring on its peg, asleep and awake, beside the arms alone."""
    task = make_task("peg-transfer")
    task.world.step(2000)
    model, data = task.world.mj_model, mujoco.MjData(task.world.mj_model)
    sleep, state = int(mujoco.mjtEnableBit.mjENBL_SLEEP), mujoco.mjtState.mjSTATE_INTEGRATION
    row = np.zeros(mujoco.mj_stateSize(model, state))
    mujoco.mj_getState(model, task.world.mj_data, row, state)
    took: dict[str, list[float]] = {"asleep": [], "awake": []}
    for _ in range(5):
        for name, times in took.items():
            flags = model.opt.enableflags
            model.opt.enableflags = flags | sleep if name == "asleep" else flags & ~sleep
            mujoco.mj_setState(model, data, row, state)
            mujoco.mj_step(model, data, 500)
            begin = time.process_time()
            mujoco.mj_step(model, data, 2000)
            times.append((time.process_time() - begin) / 2000.0)
            model.opt.enableflags = flags
    note = "one PSM, the ECM and a ring on its peg; median of 5"
    return [
        Figure(f"a step with the ring {name}", float(np.median(times)) * 1e6, "us", source=note)
        for name, times in took.items()
    ]


def figures(results: Sequence[Episode], cpu_s: float, step_s: float) -> list[Figure]:
    """Return the figures of a scene's episodes.

    Args:
        results: the episodes
        cpu_s: processor time that they took [s]
        step_s: that `bare_step` took between them [s]
    """
    name, count = results[0].scene, len(results)
    good = [one for one in results if one.success]
    low, high = wilson(len(good), count)
    alone = len(results[0].distance_m) == 1
    least = ONE_ARM if alone else TWO_ARMS
    interval = f"95 % interval {100 * low:.1f} to {100 * high:.1f} % (Wilson), {count} seeds"
    found = [Figure(f"{name}: success", len(good) / count, "", lower=least, source=interval)]
    if good:
        times = np.array([one.time_s for one in good])
        spread = 0.0
        if len(times) > 1:
            quantile = student.ppf(0.5 + CONFIDENCE / 2.0, len(times) - 1)
            spread = float(quantile * times.std(ddof=1) / np.sqrt(len(times)))
        note = f"mean of the successes, +- {spread:.2f} s (95 %)"
        found.append(Figure(f"{name}: time", float(times.mean()), "s", source=note))
        if "peg" in name:
            each = float(times.mean()) / results[0].goals
            found.append(Figure(f"{name}: time of a transfer", each, "s", upper=TRANSFER_S))
    grip = max(max(one.grip_n.values()) for one in results)
    force = max(max(one.force_n.values()) for one in results)
    drops = sum(one.drops for one in results)
    speed = sum(one.time_s for one in results) / cpu_s
    return [
        *found,
        Figure(f"{name}: drops", drops, "", source="all episodes"),
        Figure(
            f"{name}: largest force", force, "N", source="net contact force on an arm, at 50 Hz"
        ),
        Figure(f"{name}: largest grip", grip, "N", source="of the weaker finger on an object"),
        Figure(
            f"{name}: speed",
            speed,
            "",
            lower=ONE_SPEED if alone else TWO_SPEED,
            source="simulated time over processor time, one core, the policy included; meanwhile"
            f" mj_step of a PSM took {1e6 * step_s:.1f} us",
        ),
        Figure(
            f"{name}: a millisecond",
            1e-3 / speed / step_s,
            "",
            source="processor time over that of mj_step of a PSM, on any machine",
        ),
    ]
