"""Cost of the core's verbs and readings, in physics steps of a PSM."""

from __future__ import annotations

import copy
import itertools
import os
import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.overlay import Overlay
from trocar.descriptions.overlay_records import ClosurePatch, FramePatch
from trocar.geometry import matrix_from_rotation_vector, rpy_from_matrix
from trocar.geometry.se3 import inverse, transform
from trocar.modeling.build import build
from trocar.robot.verification.figures import Figure
from trocar.simulation import Batch, World
from trocar.simulation.jaw import Jaw
from trocar.simulation.world import INTEGRATION

Array = NDArray[np.float64]
Action = Callable[[], object]

#: Rounds of interleaved measurements, and calls of each in a round; medians count.
ROUNDS = 15
CALLS = 60
#: The unit: a warm step of a PSM whose joints follow a sine of this size and angle a step.
SWING_RAD, STEP_RAD = 0.2, 0.01
#: An environment step at 50 Hz.
ENVIRONMENT_STEPS = 20
BATCH = 64
THREADS = 2
#: Largest offset of axes of the calibrated arm [m, rad]. Source: our own choice.
SKEW_M, SKEW_RAD = 5e-4, 0.0035


def core(watch: Callable[[str], None] | None = None) -> list[Figure]:
    """Measure verbs, readings, resets, second worlds, the solver and a batch against `mj_step`.

    The unit of "PSM steps" is a warm `mj_step` of the rig `psm` that follows a sine, measured in
    the same rounds.
    """
    found: list[Figure] = []
    goals = {
        "psm": (0.25, 0.4, 0.45, 2.0, 2.0),
        "full_cart": (0.25, 0.4, 0.8, 3.5, 3.0),
        "calibrated psm": (None, None, None, 12.0, None),
    }
    for name, limits in goals.items():
        if watch is not None:
            watch(f"verbs of {name}")
        found += _verbs(name, limits)
    for rig, reset_ms, second in (("psm", 0.05, 1.0), ("full_cart", 0.3, 3.7)):
        if watch is not None:
            watch(f"worlds of {rig}")
        found += _worlds(rig, reset_ms, second)
    for rig, most in (("psm", 18.0), ("two_psm_ecm", 10.0), ("full_cart", 10.0)):
        if watch is not None:
            watch(f"environment of {rig}")
        found.append(_environment(rig, most))
    if watch is not None:
        watch("solver")
    found += _solver()
    if watch is not None:
        watch("batch")
    return [*found, _batch()]


def _plain(rig: str, **options: Any) -> World:
    """Return a world without identified drives, which cost by themselves (`benchmarks drives`)."""
    return World(rig, dynamics="cad", **options)


def _verbs(name: str, limits: Sequence[float | None]) -> list[Figure]:
    calibrated = name == "calibrated psm"
    world, unit = (
        _plain("psm", calibration=skewed_psm()) if calibrated else _plain(name),
        _moving(_plain("psm"), SWING_RAD),
    )
    world.step(100)
    arm = world.arm("PSM1")
    q = np.array([0.1, 0.1, 0.13, 0.1, 0.1, 0.1])
    arm.servo_jp(q)
    T = arm.setpoint_cp().matrix
    actions: dict[str, Action] = {
        "servo_jp": lambda: arm.servo_jp(q),
        "measured_js": arm.measured_js,
        "measured_cp": arm.measured_cp,
        "servo_cp": lambda: arm.servo_cp(T),
        "measured_cf": arm.body.measured_cf,
    }
    for _ in range(5000):  # the commands that a recording would repeat are kept until then
        arm.servo_jp(q)
    own = world.mj_model, mujoco.MjData(world.mj_model)
    mujoco.mj_setState(*own, world.save().row, INTEGRATION)
    more: dict[str, Action] = {"step": lambda: mujoco.mj_step(*own), "snapshot": world.snapshot}
    cost = _in_turn({"unit": unit, **actions, **more})
    found = [
        Figure(f"{name}: {verb}", cost[verb] / cost["unit"], "PSM steps", limit)
        for verb, limit in zip(actions, limits, strict=True)
    ]
    snapshot, limit = cost["snapshot"] / cost["step"], 0.5 if name == "full_cart" else None
    return [*found, Figure(f"{name}: snapshot", snapshot, f"steps of {name}", limit)]


def skewed_psm() -> Overlay:
    """Return a PSM with no axis of its linkage as drawn: its loops are no parallelograms."""
    rng, mechanism = np.random.default_rng(0), load_arm("psm").mechanism
    frames: dict[str, FramePatch] = {}
    for frame in mechanism.frames:
        if frame.name.startswith("pitch_"):
            off = SKEW_M * rng.uniform(-1.0, 1.0, 3)
            tilt = matrix_from_rotation_vector(SKEW_RAD * rng.uniform(-1.0, 1.0, 3))
            turn = rpy_from_matrix(frame.before[:3, :3] @ tilt)
            frames[frame.name] = FramePatch(frame.before[:3, 3] + off, turn)
    closures = {c.name: ClosurePatch(c.point_a, c.point_b, slides=True) for c in mechanism.closures}
    return Overlay("psm", "general", frames, closures)


def _worlds(rig: str, reset_ms: float, second: float) -> list[Figure]:
    world, rounds, calls = _plain(rig), 5, 3
    # Parts of a compiled description stay in caches, so each is compiled once, as in a first world.
    fresh = iter([load_rig(rig) for _ in range(rounds * (calls + 1))])
    cost = _in_turn(
        {
            "reset": world.reset,
            "compile": lambda: build(next(fresh)),
            "world": lambda: World(world.model),
        },
        rounds,
        calls,
    )
    return [
        Figure(f"{rig}: reset", 1e3 * cost["reset"], "ms", reset_ms),
        Figure(f"{rig}: a second world", 1e3 * cost["world"], "ms", second),
        Figure(f"{rig}: a second world / compiling", cost["world"] / cost["compile"], ""),
    ]


def _environment(rig: str, most: float) -> Figure:
    """Set every joint, step 20 ms, read joints and tips; how much of it is not `mj_step`."""
    world = _plain(rig)
    arms = [arm for arm in world.arms.values() if arm.description.type != "SUJ"]
    model, data = world.mj_model, mujoco.MjData(world.mj_model)
    goals = {arm.name: arm.setpoint_js().position for arm in arms}

    def environment() -> None:
        for arm in arms:
            arm.servo_jp(goals[arm.name])
        world.step(ENVIRONMENT_STEPS)
        for arm in arms:
            arm.measured_js()
            arm.measured_cp()

    def bare() -> None:
        mujoco.mj_setState(model, data, world.save().row, INTEGRATION)
        mujoco.mj_step(model, data, ENVIRONMENT_STEPS)

    cost = _in_turn({"environment": environment, "bare": bare}, calls=10)
    share = 100.0 * (1.0 - cost["bare"] / cost["environment"])
    return Figure(f"{rig}: Python's share of a 50 Hz step", share, "%", most)


def _solver() -> list[Figure]:
    """Compare steps that start from the solver's last solution with steps that do not."""
    carts = {welded: _plain("full_cart", setup_joints=welded) for welded in ("braked", "locked")}
    asleep = _plain("pegs")
    asleep.step(1000)
    cases = {
        "full_cart": (carts["braked"], 1.0 / 1.04),
        "full_cart, setup joints locked": (carts["locked"], 1.0 / 1.3),
        "pegs, all objects asleep": (asleep, 0.85),
        "pegs, a block in the jaws": (holding_a_block(), 0.65),
    }
    steps: dict[str, Action] = {}
    for name, (world, _) in cases.items():
        cold = copy.copy(world.mj_model)
        cold.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
        steps[name], steps[f"{name}, cold"] = _moving(world), _moving(world, model=cold)
    cost = _in_turn(steps)
    found: list[Figure] = []
    for name, (_, goal) in cases.items():
        other = "full_cart, cold" if name.startswith("full_cart") else f"{name}, cold"
        found.append(Figure(f"{name}: a step / {other}", cost[name] / cost[other], "", goal))
    return found


def _moving(world: World, size: float = 0.02, model: mujoco.MjModel | None = None) -> Action:
    """Return a step of a world whose PSM1 yaws sinusoidally by `size` [rad] about its set-point."""
    model = model or world.mj_model
    data, count = mujoco.MjData(model), itertools.count()
    mujoco.mj_setState(model, data, world.save().row, INTEGRATION)
    yaw = 3 * world.joints.arms["PSM1"].rows.start
    middle = float(data.ctrl[yaw])

    def step() -> None:
        data.ctrl[yaw] = middle + size * np.sin(STEP_RAD * next(count))
        mujoco.mj_step(model, data)

    for _ in range(200):  # objects that a state wakes fall asleep again
        step()
    return step


def holding_a_block() -> World:
    """Return the rig `pegs` with a block in the jaws of PSM1, off the board."""
    world = _plain("pegs")
    arm, at = world.arm("PSM1"), world.object("block2").measured_cp().matrix[:3, 3]
    cart = world.reference_pose("PSM1")
    down = (cart @ arm.local.measured_cp().matrix)[:3, :3]

    def go(height: float) -> None:
        T = transform(down, at + np.array([0.0, 0.0, height]))
        arm.move_cp(arm.local.base_frame()[0] @ inverse(cart) @ T).wait(timeout_s=4.0)

    jaw = cast(Jaw, arm.jaw)
    jaw.move_jp([0.6]).wait(timeout_s=2.0)
    go(0.03)
    go(0.012)  # the jaw's axis is some 10 mm behind the ends of the fingers
    jaw.close().wait(timeout_s=2.0)
    go(0.03)
    world.step(500)
    return world


def _batch() -> Figure:
    """Compare a batch of PSMs with bare steps of as many worlds on as many threads."""
    world = _plain("psm")
    world.step(50)
    batch = Batch(world, BATCH, threads=THREADS)
    first = batch.setpoints.copy()
    rng = np.random.default_rng(0)
    size, phase = rng.uniform(0.02, 0.1, first.shape), rng.uniform(0.0, 6.0, first.shape)
    size[:, [name.endswith("insertion") for name in batch.names]] = 0.01
    data = [mujoco.MjData(world.mj_model) for _ in range(BATCH)]
    for one in data:
        mujoco.mj_setState(world.mj_model, one, world.save().row, INTEGRATION)
    counts = {"bare": 0, "batch": 0}

    def told(who: str) -> Array:
        counts[who] += 1
        return first + size * np.sin(0.05 * counts[who] + phase)

    def some(which: range, q: Array) -> None:
        for k in which:
            data[k].ctrl[0::3] = q[k]
            mujoco.mj_step(world.mj_model, data[k], ENVIRONMENT_STEPS)

    with ThreadPoolExecutor(THREADS) as pool:

        def bare() -> None:
            q = told("bare")
            parts = [range(k, BATCH, THREADS) for k in range(THREADS)]
            for part in [pool.submit(some, which, q) for which in parts]:
                part.result()

        cost = _in_turn(
            {"bare": bare, "batch": lambda: batch.step(told("batch"), ENVIRONMENT_STEPS)}, calls=1
        )
    name = f"batch of {BATCH} PSMs on {THREADS} of {os.cpu_count()} CPUs, against bare mj_step"
    return Figure(name, cost["bare"] / cost["batch"], "", lower=0.95)


def _in_turn(
    actions: dict[str, Action], rounds: int | None = None, calls: int | None = None
) -> dict[str, float]:
    """Return the median wall time of each action, measured in turn [s]."""
    spent: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(rounds or ROUNDS):
        for name, act in actions.items():
            act()
            for _ in range(calls or CALLS):
                before = time.perf_counter()
                act()
                spent[name].append(time.perf_counter() - before)
    return {name: statistics.median(times) for name, times in spent.items()}
