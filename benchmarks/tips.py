"""Tips of instruments without markers, where kinematics has them some millimetres off."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from benchmarks.needle_stage import small_error
from trocar.cameras import StereoCalibration
from trocar.descriptions import load_rig
from trocar.errors import InputError
from trocar.geometry import inverse, matrix_from_rotation_vector, transform
from trocar.rendering import Endoscope, Look
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.tasks.vision import find_tip
from trocar.tasks.vision.instruments import instrument_masks

Array = NDArray[np.float64]

#: Images of a robot, and its hand-eye error. Source: the prototypes' 3.3 mm.
IMAGES, SHIFT_M, TURN_DEG = 12, 0.0033, 1.0
#: The filtered fix is the median of the corrections of so many images. Source: our own choice.
FILTERED = 5
#: How far the tip goes about its start, and the wrist's turns. [m, rad]
RANGE_M, RANGE_RAD = np.array([0.012, 0.010, 0.006]), 0.3
#: A point of the jaws ahead of the tip's frame. [m]
AHEAD_M = 0.005
SOURCE = "the project's goals; 640x480, noise 0.03 of white, hand-eye 3.3 mm and 1 deg off"


def tips(seeds: int, watch: Callable[[str], None]) -> list[Figure]:
    """Find the tip of a PSM in images of both styles."""
    found: list[Figure] = []
    for style in ("plain", "surgical"):
        world = World(load_rig("training"), dynamics="cad")
        look = Look(style, noise=0.03)
        scope = Endoscope(world, preset="dvrk_sd_640x480", ids=True, look=look)
        single: list[Array] = []
        filtered: list[Array] = []
        missed = 0
        for seed in range(seeds):
            watch(f"tips, {style}, robot {seed + 1} of {seeds}")
            rows = one_robot(world, scope, seed)
            missed += IMAGES - len(rows)
            single += [errors(row[0], row) for row in rows]
            for k in range(FILTERED - 1, len(rows)):
                last = rows[k - FILTERED + 1 : k + 1]
                correction = np.median([row[0] - row[1] for row in last], axis=0)
                filtered.append(errors(rows[k][1] + correction, rows[k]))
        scope.close()
        for name, values, goals in (
            ("one image", np.array(single), (None, None, None)),
            (f"median of {FILTERED}", np.array(filtered), (2.0, 7e-4, 5.0)),
        ):
            pixels, shift = values.T
            found += [
                Figure(f"tips, {style}, {name}: median", float(np.median(pixels)), "px", goals[0],
                       source=SOURCE),
                Figure(f"tips, {style}, {name}: place, median", float(np.median(shift)), "m",
                       goals[1], shown="mm", source=SOURCE),
                Figure(f"tips, {style}, {name}: 90 %", float(np.percentile(pixels, 90)), "px",
                       goals[2], source=SOURCE),
            ]  # fmt: skip
        found.append(
            Figure(f"tips, {style}: images without", missed / (seeds * IMAGES), "", source=SOURCE)
        )
    return found


def one_robot(world: World, scope: Endoscope, seed: int) -> list[tuple[Array, Array, Array, Array]]:
    """Return found, believed and true places in the left eye's frame (3,), and 3x3 K of it."""
    rng = np.random.default_rng(seed)
    world.reset(0)
    arm = world.arms["PSM1"]
    q, start = arm.joints.positions(), arm.measured_cp("world").matrix
    camera = world.camera("endoscope").T_world_camera
    error: Array | None = None
    rows: list[tuple[Array, Array, Array, Array]] = []
    for _ in range(IMAGES):
        turn = matrix_from_rotation_vector(RANGE_RAD * rng.uniform(-1.0, 1.0, 3))
        goal = transform(turn @ start[:3, :3], start[:3, 3] + RANGE_M * rng.uniform(-1.0, 1.0, 3))
        local = inverse(world.reference_pose("PSM1")) @ goal
        q[:-1] = arm.local.inverse_kinematics(local, q[:-1])
        q[-1] = rng.uniform(0.0, 0.6)
        world.set_state("PSM1", q)
        frame = scope.capture()
        eyes, right = frame.calibration, frame.right
        assert isinstance(eyes, StereoCalibration) and right is not None  # noqa: S101
        to_left = inverse(frame.T_world_camera[0])
        truth = (to_left @ arm.measured_cp("world").matrix @ [0.0, 0.0, AHEAD_M, 1.0])[:3]
        if error is None:  # constant, as that of a hand-eye calibration
            error = small_error(rng, truth, SHIFT_M, TURN_DEG)
        believed = error @ np.append(truth, 1.0)
        mount = eyes.mounts[0]
        there = scope.render(
            world.snapshot(), world.cameras(),
            T_world_camera=camera @ mount @ inverse(error) @ inverse(mount),
        )  # fmt: skip
        with suppress(InputError):  # not found, or out of view
            fix = find_tip(
                eyes, frame.left, right, there.eyes, instrument_masks(there, "PSM1"), believed[:3]
            )
            rows.append((fix.point, believed[:3], truth, eyes.left.K))
    return rows


def errors(point: Array, row: tuple[Array, Array, Array, Array]) -> Array:
    """Return by how much a place is off in the left image [px] and in space [m], (2,)."""
    _, _, truth, K = row
    off = K @ point / point[2] - K @ truth / truth[2]
    return np.array([np.linalg.norm(off), np.linalg.norm(point - truth)], dtype=np.float64)
