"""Scenes on MuJoCo Warp: speed, loops, grasps and memory on a GPU.

python -m benchmarks.learning_gpu --worlds 64,1024,4096,16384 --budget 540
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from trocar.descriptions import load_rig
from trocar.errors import DivergedError, MissingExtraError, TrocarError
from trocar.kinematics.forward import coordinates
from trocar.modeling.build import build, gpu_model
from trocar.modeling.options import ModelOptions
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.motions import CLOSE_S, GRIP, PEAK, SPEED_M_S, SPIN_RAD_S, Hand
from trocar.tasks.scenes.transfer import NeedlePick

if TYPE_CHECKING:
    from torch import Tensor

    from trocar.learning.warp_scene import WarpScene

#: A row: figure, value (None: not measured), unit, goal.
Row = tuple[str, float | None, str, str]
#: Actions of a scripted pick, and in a random run: held for so long, and the largest share of the
#: limits. Source: our own choice, as the batch's benchmark.
PICK_PERIODS, HELD_PERIODS, RANDOM = 160, 10, 0.5
#: Episodes of the random run [s]. Source: our own choice.
EPISODE_S = 2.0
#: Numbers of worlds of the curve.
CURVE = (64, 256, 1024, 4096, 16384)
NOT_MEASURED = "not measured: no CUDA device"
#: Figures without a device, with their goals. Source: issue 37; 345 k are Surgical Gym's.
GOALS = {
    "PSM closed-loop physics steps/s": ("/s", ">= 345000"),
    "scripted needle pick, 1,024 worlds": ("%", ">= 95"),
    "largest loop gap": ("um", "<= 0.2"),
    "env steps/s of 20 ms, needle-pick": ("/s", "printed"),
    "share of the wall outside physics": ("%", "printed"),
    "memory of a world": ("KiB", "printed"),
}


class PickScript:
    """The scripted needle pick of all worlds at once: over it, down, close, up, to the goal.

    Args:
        scene: needle-pick at the beginning of its episodes
    """

    def __init__(self, scene: WarpScene) -> None:
        import torch

        self._scene, self._arm = scene, scene.task.arms[0]
        readings, reach = scene.readings, Hand(scene.task, scene.task.arms[0]).reach
        needle, T = readings.objects["needle"], readings.targets[self._arm]
        at, (w, x, y, z) = needle[:, :3], needle[:, 3:].unbind(1)
        across = torch.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z)], 1)
        angle = torch.atan2(across[:, 1], across[:, 0]) - math.pi / 2
        self._turn = angle - math.pi * torch.round(angle / math.pi)  # a jaw has two such poses
        up = torch.tensor([0.0, 0.0, 1.0], dtype=at.dtype, device=at.device)
        point = at + (NeedlePick.GRASP_M + reach) * up
        point[:, :2] += NeedlePick.RADIUS_M * across
        start, over = T[:, :3, 3], point + NeedlePick.WAY_M * up
        end = over + readings.goals[:, 0] - (at + NeedlePick.WAY_M * up)
        self._points = torch.stack([start, over, point, point, over, end, end], 1)
        ways = self._points[:, 1:] - self._points[:, :-1]
        times = PEAK * (ways * ways).sum(-1).sqrt() / SPEED_M_S
        times[:, 0] = torch.maximum(times[:, 0], PEAK * self._turn.abs() / SPIN_RAD_S)
        times[:, 2], times[:, 5] = CLOSE_S, 1e9
        begin = torch.zeros_like(times[:, :1])
        self._ends = torch.cat([begin, times.clamp(min=PERIOD_S).cumsum(1)], 1)
        self._first = T[:, :3, :3].clone()

    def __call__(self) -> Tensor:
        """Return the actions of the next 20 ms, (n, 7)."""
        import torch

        from trocar.learning.torch_controller import rotation_matrices

        scene = self._scene
        T, now = scene.readings.targets[self._arm], scene.time[:, None] + PERIOD_S
        k = ((now >= self._ends).sum(1) - 1).clamp(0, 5)
        row = torch.arange(scene.n, device=T.device)
        a, b = self._ends[row, k], self._ends[row, k + 1]
        s = ((now[:, 0] - a) / (b - a)).clamp(0, 1)
        s = s**3 * (10 - 15 * s + 6 * s * s)
        leg = self._points[row, k + 1] - self._points[row, k]
        goal = self._points[row, k] + s[:, None] * leg
        turned = torch.where(k == 0, s, 1.0) * self._turn
        zero = torch.zeros_like(turned)
        R = rotation_matrices(torch.stack([zero, zero, turned], 1)) @ self._first
        off = R @ T[:, :3, :3].transpose(1, 2)
        spin = torch.stack(
            [off[:, 2, 1] - off[:, 1, 2], off[:, 0, 2] - off[:, 2, 0], off[:, 1, 0] - off[:, 0, 1]],
            1,
        )
        jaw = torch.where(k < 2, NeedlePick.OPENING, GRIP)
        way = (goal - T[:, :3, 3]) / PERIOD_S
        return torch.cat([way, 0.5 * spin / PERIOD_S, jaw[:, None]], 1)


def scripted_success(scene: WarpScene, periods: int = PICK_PERIODS) -> float:
    """Return the ratio of worlds in which the scripted pick ends with success."""
    script = PickScript(scene)
    for _ in range(periods):
        scene.command(script())
    return float(scene.success.double().mean())


def loop_gap(scene: WarpScene, worlds: int = 64) -> float:
    """Return the largest distance of points that loops join, in the first finite worlds [m]."""
    model, largest = scene.made.mj, 0.0
    data = mujoco.MjData(model)
    for row in scene.qpos[:worlds].double().cpu().numpy():
        if np.isfinite(row).all():
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            apart = data.site_xpos[scene.made.loops[:, 0]] - data.site_xpos[scene.made.loops[:, 1]]
            largest = max(largest, float(np.linalg.norm(apart, axis=1).max(initial=0.0)))
    return largest


def random_run(scene: WarpScene, seconds: float, periods: int = 400) -> dict[str, float]:
    """Time random actions, with resets, and physics alone.

    Args:
        scene: any
        seconds: of each of both timings, at most [s]
        periods: of each, at most
    """
    import torch

    sync = torch.cuda.synchronize if scene.device == "cuda" else lambda: None
    least, largest = scene.limits
    rng = torch.Generator(scene.device).manual_seed(1)
    action = torch.zeros(scene.n, len(least), dtype=torch.float64, device=scene.device)
    scene.command(action)
    sync()
    count, begun, broken = 0, time.perf_counter(), int(scene.broken_count)
    while count < periods and (not count or time.perf_counter() - begun < seconds):
        if count % HELD_PERIODS == 0:
            share = torch.rand(action.shape, generator=rng, device=scene.device)
            action = RANDOM * (least + (largest - least) * share)
        scene.command(action)
        ended = scene.success | scene.failed | (scene.time >= EPISODE_S)
        if bool(ended.any()):
            scene.reset(ended)
        count += 1
        if count % HELD_PERIODS == 0:
            sync()
    sync()
    wall = time.perf_counter() - begun
    laps, begun = 0, time.perf_counter()
    while laps < periods and (not laps or time.perf_counter() - begun < seconds / 3.0):
        scene.physics()
        laps += 1
        if laps % HELD_PERIODS == 0:
            sync()
    sync()
    alone = (time.perf_counter() - begun) / laps  # of 10 ms
    physics_steps = 0.01 / scene.timestep
    return {
        "env_steps_per_s": scene.n * count / wall,
        "physics_steps_per_s": scene.n * physics_steps / alone,
        "share_outside_physics": 1.0 - 2.0 * alone * count / wall,
        "broken": int(scene.broken_count) - broken,
        "overflows": int(scene.overflows.sum()),
        "gap_um": 1e6 * loop_gap(scene),
    }


def lone_arm(n: int, device: str, seconds: float, steps: int = 10) -> float:
    """Return the physics steps/s of n PSMs that hold a pose, without objects, at 1 ms.

    Args:
        n: number of worlds
        device: "cuda" or "cpu"
        seconds: of the timing, at most [s]
        steps: of a CUDA graph
    """
    import mujoco_warp
    import warp

    mjw: Any = mujoco_warp
    wp: Any = warp
    model = build(load_rig("psm"), ModelOptions(servo="position"))
    data = mujoco.MjData(model.mj)
    for place in model.rig.arms:
        at = coordinates(place.arm.mechanism, model.rig.poses["start"][place.name])
        for frame, value in zip(place.arm.mechanism.frames, at, strict=True):
            if frame.motion != "fixed":
                data.joint(f"{place.name}/{frame.name}").qpos = value
    data.ctrl[:] = model.joints.drive @ data.qpos
    copied = gpu_model(model)
    with wp.ScopedDevice("cuda:0" if device == "cuda" else "cpu"):
        on_device = mjw.put_model(copied)
        state = mjw.put_data(copied, data, nworld=n, nconmax=16, njmax=64)

        def run() -> None:
            for _ in range(steps):
                mjw.step(on_device, state)

        mjw.step(on_device, state)  # compiles
        if device == "cuda":
            with wp.ScopedCapture() as capture:
                run()
            launch = lambda: wp.capture_launch(capture.graph)  # noqa: E731
        else:
            launch = run
        launch()
        wp.synchronize()
        laps, begun = 0, time.perf_counter()
        while not laps or time.perf_counter() - begun < seconds:
            launch()
            laps += 1
            if laps % HELD_PERIODS == 0:
                wp.synchronize()
        wp.synchronize()
        rate = n * steps * laps / (time.perf_counter() - begun)
        if not np.isfinite(state.qpos.numpy()).all():
            raise DivergedError(float(state.time.numpy()[0]), "psm", None, f"in {n} worlds")
    return rate


def measurements(
    worlds: Sequence[int],
    budget: float,
    *,
    scenes: Sequence[str] = ("needle-pick", "needle-reach", "peg-transfer"),
    timesteps: Sequence[float] = (0.001,),
    device: str = "cuda",
    seconds: float = 10.0,
) -> Iterator[dict[str, Any]]:
    """Measure each scene in each number of worlds, until the budget is spent.

    Args:
        worlds: numbers of worlds; the scripted pick runs in the one nearest to 1,024
        budget: after which nothing new begins [s]
        scenes, timesteps: to measure; every scene with the first timestep comes first
        device: "cuda", or "cpu" to try the program
        seconds: of a timing [s]

    Yields:
        figures of one run, or its error

    Raises:
        InputError: the device is not there
    """
    import torch

    from trocar.learning.warp_scene import WarpScene, check_device

    check_device(device)
    born = time.perf_counter()
    pick_in = min(worlds, key=lambda n: abs(n - 1024))
    for n in worlds:
        if time.perf_counter() - born > budget:
            return
        rate = lone_arm(n, device, seconds / 3.0)
        yield {"scene": "psm", "timestep": 0.001, "worlds": n, "physics_steps_per_s": rate}
    for timestep in timesteps:
        for name in scenes:
            for n in worlds:
                if (begun := time.perf_counter()) - born > budget:
                    return
                row: dict[str, Any] = {"scene": name, "timestep": timestep, "worlds": n}
                try:
                    scene = WarpScene(name, n, device=device, timestep=timestep)
                    row["start_s"] = time.perf_counter() - begun
                    if name == "needle-pick" and n == pick_in:
                        row["scripted_success"] = scripted_success(scene)
                        row["scripted_broken"] = int(scene.broken_count)
                        row["scripted_gap_um"] = 1e6 * loop_gap(scene)
                        scene.reset()
                    row |= random_run(scene, seconds)
                    row["state_kib_per_world"] = scene.world_bytes / 1024.0
                    if device == "cuda":
                        free, total = torch.cuda.mem_get_info()
                        row["memory_gib"] = (total - free) / 2**30  # with what runs before left
                    del scene
                except (TrocarError, RuntimeError) as error:  # another size may fit
                    row["error"] = f"{type(error).__name__}: {error}"[:300]
                yield row


def rows(budget: float = 540.0) -> list[Row]:
    """Return the GPU's rows of `python -m benchmarks learning`; without one they are not measured.

    Args:
        budget: of all measurements [s]
    """
    try:
        import torch
    except ImportError as error:
        raise MissingExtraError("PyTorch", "gpu", "measuring scenes on a GPU") from error
    if not torch.cuda.is_available():
        return [
            (f"{figure} ({NOT_MEASURED})", None, unit, goal)
            for figure, (unit, goal) in GOALS.items()
        ]
    curve = list(measurements(CURVE, budget))
    good = [row for row in curve if "error" not in row]
    found: list[Row] = []
    for row in good:
        label = f"{row['scene']}, {row['worlds']} worlds, {1e3 * row['timestep']:g} ms"
        lone = row["scene"] == "psm"
        goal = ">= 345000" if lone and row["worlds"] == max(CURVE) else "printed"
        found.append((f"physics steps/s, {label}", row["physics_steps_per_s"], "/s", goal))
        if lone:
            continue
        found.append((f"env steps/s, {label}", row["env_steps_per_s"], "/s", "printed"))
        outside = 100.0 * row["share_outside_physics"]
        found.append((f"outside physics, {label}", outside, "%", "printed"))
        found.append((f"memory of a world, {label}", row["state_kib_per_world"], "KiB", "printed"))
        found.append((f"largest loop gap, {label}", row["gap_um"], "um", "<= 0.2"))
        found.append((f"worlds that broke, {label}", row["broken"], "", "printed"))
        if "scripted_success" in row:
            success = 100.0 * row["scripted_success"]
            found.append((f"scripted needle pick, {label}", success, "%", ">= 95"))
    return found


def main(words: Sequence[str] | None = None) -> int:
    """Print a line of JSON for each measurement, and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.learning_gpu", description=__doc__)
    parser.add_argument("--worlds", default="1024,4096,16384,64,256", help="numbers of worlds")
    parser.add_argument("--scenes", default="needle-pick,needle-reach,peg-transfer")
    parser.add_argument("--timesteps", default="0.001", help="of the physics [s]")
    parser.add_argument("--seconds", type=float, default=10.0, help="of a timing [s]")
    parser.add_argument("--budget", type=float, default=540.0, help="of all, at most [s]")
    parser.add_argument("--device", default="cuda", choices=("cuda", "cpu"))
    args = parser.parse_args(words)
    try:
        for row in measurements(
            [int(n) for n in args.worlds.split(",")],
            args.budget,
            scenes=args.scenes.split(","),
            timesteps=[float(step) for step in args.timesteps.split(",")],
            device=args.device,
            seconds=args.seconds,
        ):
            print(json.dumps(row), flush=True)
    except TrocarError as error:
        print(f"benchmarks.learning_gpu: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
