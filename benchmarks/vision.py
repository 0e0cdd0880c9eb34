"""Accuracy of camera calibrations from the endoscope's views of a board."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_rig
from trocar.geometry import inverse, log_transform
from trocar.robot.calibration.camera_views import BoardViews
from trocar.robot.calibration.hand_eye import Placed, calibrate_camera
from trocar.robot.mocap.views import SimulatedViews, ViewSettings, simulate_views
from trocar.robot.verification.figures import Figure

Array = NDArray[np.float64]

#: Offsets of joint readings are up to this. Source: the goals.
OFFSET_DEG = 0.2
#: Half of a 95 % interval, in standard deviations.
WITHIN = 1.96
SOURCE = "the project's goals; 20 views, corners 0.2 px, joints 0.02 deg and 35 um"


def hand_eye(seeds: int, watch: Callable[[str], None]) -> list[Figure]:
    """Calibrate simulated robots, with and without constant offsets of joint readings."""
    found: list[Figure] = []
    for what, offset, goals in (
        ("hand-eye", 0.0, (2e-4, 0.1)),
        ("hand-eye, offsets estimated", OFFSET_DEG, (3e-4, 0.25)),
    ):
        scopes, bases = [], []
        for seed in range(seeds):
            watch(f"{what}, robot {seed + 1} of {seeds}")
            made = simulated(seed, offset)
            result = calibrate_camera(as_views(made), np.radians(0.02), offset > 0.0)
            scopes.append(_missed(result.left, made.left_read))
            bases.append(_missed(result.bases["PSM1"], made.base_read))
        inside: list[float] = []
        for name, errors in (("T_ECM_camera", scopes), ("T_ECM_PSM", bases)):
            rows = np.array(errors)
            found += _figures(f"{what}: {name}", rows, goals)
            inside.append(float((np.abs(rows[:, 0]) < WITHIN * rows[:, 1]).mean()))
            found.append(
                Figure(f"{what}: {name}, in 95 % intervals", inside[-1], "", source=SOURCE)
            )
        both = float(np.mean(inside))
        found.append(
            Figure(f"{what}: both, in 95 % intervals", both, "", 0.98, 0.92, source=SOURCE)
        )
    named = 0
    for seed in range(seeds):
        watch(f"hand-eye, offsets named, robot {seed + 1} of {seeds}")
        result = calibrate_camera(as_views(simulated(seed, OFFSET_DEG)), np.radians(0.02))
        named += bool(result.warnings)
    found.append(
        Figure("hand-eye: robots whose offsets are named", named / seeds, "", source=SOURCE)
    )
    return found


def simulated(seed: int, offset_deg: float) -> SimulatedViews:
    """Return views of a board on PSM1."""
    settings = ViewSettings("PSM1", offset=float(np.radians(offset_deg)), seed=seed)
    return simulate_views(load_rig("two_psm_ecm"), settings)


def as_views(made: SimulatedViews) -> BoardViews:
    """Return the input of `trocar calibrate-camera` from them."""
    rig = load_rig("two_psm_ecm")
    count = len(made.pixels)
    return BoardViews(
        file="simulated",
        size=made.calibration.left.size,
        start=None,
        arms={name: rig.arm(name).arm for name in made.q},
        ecm="ECM",
        psms=("PSM1",),
        points=ViewSettings("PSM1").board.corners,
        names=tuple(f"{i:03d}" for i in range(count)),
        holders=(0,) * count,
        q=made.read,
        pixels=made.pixels,
    )


def _missed(found: Placed, truth: Array) -> Array:
    """Return the error of a pose and its standard deviations, (2, 6) [m, rad]."""
    error = log_transform(inverse(found.pose) @ truth)
    return np.stack([error, np.sqrt(np.diag(found.covariance))])


def _figures(what: str, errors: Array, goals: tuple[float, float]) -> list[Figure]:
    """Return figures of errors and their standard deviations, (seeds, 2, 6)."""
    shift = np.linalg.norm(errors[:, 0, :3], axis=1)
    turn = np.degrees(np.linalg.norm(errors[:, 0, 3:], axis=1))
    return [
        Figure(f"{what}, position, median", float(np.median(shift)), "m", goals[0], shown="mm",
               source=SOURCE),
        Figure(f"{what}, position, worst", float(shift.max()), "m", shown="mm", source=SOURCE),
        Figure(f"{what}, rotation, median", float(np.median(turn)), "deg", goals[1],
               source=SOURCE),
        Figure(f"{what}, rotation, worst", float(turn.max()), "deg", source=SOURCE),
    ]  # fmt: skip
