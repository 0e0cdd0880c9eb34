"""An ECM that centres an object by visual servoing, on pixels with noise and latency."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import StereoCalibration
from trocar.cameras.lens import project
from trocar.geometry import inverse
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.tasks.vision import ServoSettings, VisualServo

Array = NDArray[np.float64]

#: Pictures a second, latency in pictures, noise of a pixel per axis. Source: the goals; noise as of
#: detectors.
RATE_HZ, LATENCY, NOISE_PX = 30.0, 1, 0.5
#: Period of commands, and where the arm begins [rad, m].
PERIOD_S, START = 0.005, (0.1, 0.2, 0.12, 0.0)
SOURCE = "the project's goals; pixels with 0.5 px of noise, 30 Hz, one picture late"


@dataclass(frozen=True, eq=False)
class Run:
    """Times (n,) [s], offsets from the middle (n, 2) [px], depths (n,) [m]; RCM error [m]."""

    times: Array
    offset: Array
    depth: Array
    rcm: float


def run(start_px: tuple[float, float], speed: float, seconds: float, seed: int = 0) -> Run:
    """Let an ECM centre an object that starts at a pixel, 0.1 m deep, and moves to and fro."""
    rng = np.random.default_rng(seed)
    world = World("ecm", collisions=False)
    arm = world.arm("ECM")
    world.set_state("ECM", np.array(START))
    camera = world.rig.cameras[0]
    eyes = camera.calibration
    assert isinstance(eyes, StereoCalibration)  # noqa: S101  of the rig "ecm"
    base = world.reference_pose("ECM")
    T_world_camera = world.camera(camera.name).T_world_camera
    mount = inverse(base @ arm.forward_kinematics(np.array(START)).matrix) @ T_world_camera
    servo = VisualServo(arm.description, eyes, mount @ eyes.mounts[0], ServoSettings(0.1))
    f = eyes.left.K[0, 0]
    first = (T_world_camera @ np.array([*(0.1 / f * np.array(start_px)), 0.1, 1.0]))[:3]
    along = T_world_camera[:3, :3] @ [0.8, 0.6, 0.0]
    late: deque[tuple[float, float, Array, Array, Array]] = deque()
    rows, rcm = [], 0.0
    steps, next_picture = round(PERIOD_S / world.timestep), 0.0
    for _ in range(round(seconds / PERIOD_S)):
        now = world.time
        swing = 0.02 * np.sin(speed / 0.02 * now)
        p = (inverse(world.camera(camera.name).T_world_camera) @ np.append(
            first + along * swing, 1.0))[:3]  # fmt: skip
        rows.append([now, *(f * p[:2] / p[2]), p[2]])
        rcm = max(rcm, world.health().rcm_error_m)
        q = arm.measured_js().position
        if now >= next_picture - 1e-9:
            next_picture += 1.0 / RATE_HZ
            pixels = [
                project((inverse(T) @ np.append(p, 1.0))[:3], eye.K, eye.distortion)
                + rng.normal(scale=NOISE_PX, size=2)
                for T, eye in zip(eyes.mounts, eyes.eyes, strict=True)
            ]
            late.append((now + LATENCY / RATE_HZ, now, q, pixels[0], pixels[1]))
        while late and late[0][0] <= now + 1e-9:
            _, stamp, then, left, right = late.popleft()
            servo.see(stamp, then, left, right)
        arm.servo_jv(servo.velocity(now, q))
        world.step(steps)
    found = np.array(rows)
    return Run(found[:, 0], found[:, 1:3], found[:, 3], rcm)


def servoing(seeds: int, watch: Callable[[str], None]) -> list[Figure]:
    """Centre an object from 200 px off, and follow one at 10 mm/s."""
    settle, over, steady, depth, follow, rcm = [], [], [], [], [], []
    for seed in range(seeds):
        watch(f"servoing, run {seed + 1} of {seeds}")
        angle = 2.0 * np.pi * seed / seeds
        way = np.array([np.cos(angle), np.sin(angle)])
        one = run((float(200.0 * way[0]), float(200.0 * way[1])), 0.0, 3.0, seed)
        size = np.linalg.norm(one.offset, axis=1)
        beyond = np.flatnonzero(size > 2.0)
        settle.append(one.times[beyond[-1]])
        over.append(max(0.0, -float((one.offset @ way).min())) / 2.0)
        last = one.times > 2.0
        steady.append(float(np.sqrt(np.mean(size[last] ** 2))))
        depth.append(abs(float(one.depth[last].mean()) - 0.1))
        moving = run((0.0, 0.0), 0.01, 5.0, seed)
        size = np.linalg.norm(moving.offset, axis=1)
        follow.append(float(size[moving.times > 1.5].max()))
        rcm.append(max(one.rcm, moving.rcm))
    return [
        Figure("servoing: within 2 px from 200 px off, worst", max(settle), "s", 1.2,
               source=SOURCE),
        Figure("servoing: overshoot, worst", max(over), "%", 5.0, source=SOURCE),
        Figure("servoing: steady, RMS, median", float(np.median(steady)), "px", 0.5,
               source=SOURCE),
        Figure("servoing: depth, worst", max(depth), "m", shown="mm", source=SOURCE),
        Figure("servoing: object at 10 mm/s, worst", max(follow), "px", 8.0, source=SOURCE),
        Figure("servoing: RCM error, worst", max(rcm), "m", shown="um", source=SOURCE),
    ]  # fmt: skip
