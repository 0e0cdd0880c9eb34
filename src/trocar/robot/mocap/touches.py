"""Simulated readings of arms that touch the points of a block, or hold a board before a camera."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription
from trocar.descriptions.table import toml_text
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rotation_vector, quaternion_from_matrix
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import pose
from trocar.kinematics.jacobian import jacobian_spatial
from trocar.outputs import check_file, write_text
from trocar.robot.mocap.simulate import random_pose, random_rotations

Array = NDArray[np.float64]

#: The block: the corners of a cuboid. Source: our own choice. [m]
BLOCK_M = (0.06, 0.05, 0.04)
#: Postures begin this part of a joint's range around its middle. Source: our own choice.
SHARE = 0.6
#: Joints are solved to this, in so many steps. Source: our own choice. [m]
REACHED_M, STEPS = 1e-12, 60
#: A board sits on the tip within this of it along each axis. Source: our own choice. [m]
ON_TIP_M = 0.05


@dataclass(frozen=True)
class TouchSettings:
    """Settings of simulated readings.

    Attributes:
        count: of each arm
        noise_m: of the touched place or the board's position along each axis [m]
        noise_rad: of the board's rotation about each axis [rad]
        offset_rad, offset_m: joints read wrong by up to this [rad], [m]
        boards: whether a board is held before a camera, instead of a block touched
        seed: of everything random
    """

    count: int = 30
    noise_m: float = 2e-4
    noise_rad: float = 1e-3
    offset_rad: float = 0.02
    offset_m: float = 0.002
    boards: bool = False
    seed: int = 0


def write_touches(
    path: str | Path,
    arms: Mapping[str, tuple[str, ArmDescription]],
    settings: TouchSettings,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write PATH, the CSV file beside it that it names, and the truth in PATH.truth.json.

    Args:
        path: of the TOML file
        arms: {name: (how its description is called, itself)}
        settings: how readings are made
        overwrite: replace files that exist

    Returns:
        the truth: poses of the bases in the block or the camera, joint offsets

    Raises:
        InputError: settings that cannot be used, or a file that cannot be written
    """
    if not 4 <= settings.count <= 10000:
        raise InputError(f"count: got {settings.count}; allowed: 4 to 10000 readings of each arm")
    if min(settings.noise_m, settings.noise_rad, settings.offset_rad, settings.offset_m) < 0.0:
        raise InputError("noise and offsets: got a negative one; allowed: 0 or more")
    if settings.seed < 0:
        raise InputError(f"seed: got {settings.seed}; allowed: an integer of 0 or more")
    file, table, beside = (
        check_file(one, overwrite)
        for one in (path, Path(path).with_suffix(".csv"), f"{path}.truth.json")
    )
    rng = np.random.default_rng(settings.seed)
    signs = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T
    points = {f"P{i + 1}": corner * BLOCK_M for i, corner in enumerate(signs.astype(float))}
    columns = list(
        dict.fromkeys(j.name for _, a in arms.values() for j in a.joints[: a.own_joints])
    )
    more = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz") if settings.boards else ("point",)
    lines = [",".join(["arm", *more, *columns])]
    truth: dict[str, Any] = {}
    for name, (_, arm) in arms.items():
        made, rows = _readings(arm, points, settings, rng)
        truth[name] = made
        for first, q in rows:
            read = dict(zip((j.name for j in arm.joints), q, strict=True))
            cells = [name, *first, *(f"{read[c]:.9g}" if c in read else "" for c in columns)]
            lines.append(",".join(cells))
    tip = {} if settings.boards else {"tip_m": [0.0, 0.0, 0.0]}
    document = {
        "schema": 1,
        "readings": f"{file.stem}.csv",
        "arms": {name: {"description": called, **tip} for name, (called, _) in arms.items()},
        "points": None
        if settings.boards
        else {name: {"xyz_m": point.tolist()} for name, point in points.items()},
    }
    write_text(file, toml_text(document), overwrite)
    write_text(table, "\n".join([*lines, ""]), overwrite)
    write_text(beside, json.dumps(truth, indent=2) + "\n", overwrite)
    return truth


def _readings(
    arm: ArmDescription,
    points: Mapping[str, Array],
    settings: TouchSettings,
    rng: np.random.Generator,
) -> tuple[dict[str, Any], list[tuple[list[str], Array]]]:
    """Return the truth of one arm, and (cells of point or board, joint readings) of each row."""
    own = arm.own_joints
    offsets = np.zeros(len(arm.joints))
    for index in range(1, own):  # of the first joint an offset is a turn of the base
        slides = arm.joints[index].kind == "prismatic"
        most = settings.offset_m if slides else settings.offset_rad
        offsets[index] = rng.uniform(-most, most)
    middle = np.mean([[j.lower, j.upper] for j in arm.joints], axis=1)
    middle[own:] = 0.0
    centre = pose(arm.mechanism, middle)[:3, 3]
    turn = random_rotations(rng, 1)[0]
    # T_reference_base: the block's middle is where the tip is in the middle of the ranges
    base = transform(turn, 0.5 * np.array(BLOCK_M) - turn @ centre)
    board = random_pose(rng, ON_TIP_M)
    rows: list[tuple[list[str], Array]] = []
    while len(rows) < settings.count:
        q = _posture(arm, middle, rng)
        if settings.boards:
            seen = base @ pose(arm.mechanism, q) @ board
            turned = matrix_from_rotation_vector(rng.normal(scale=settings.noise_rad, size=3))
            place = seen[:3, 3] + rng.normal(scale=settings.noise_m, size=3)
            values = [*place, *quaternion_from_matrix(seen[:3, :3] @ turned)]
            first = [f"{value:.9g}" for value in values]
        else:
            name = list(points)[len(rows) % len(points)]
            touched = points[name] + rng.normal(scale=settings.noise_m, size=3)
            goal = (inverse(base) @ np.append(touched, 1.0))[:3]
            reached = reach(arm, q, goal)
            if reached is None:
                continue
            q, first = reached, [name]
        rows.append((first, q - offsets))
    names = [joint.name for joint in arm.joints[1:own]]
    truth = {
        "T_reference_base": base.tolist(),
        "offsets": dict(zip(names, offsets[1:own].tolist(), strict=True)),
    }
    if settings.boards:
        truth["T_tip_board"] = board.tolist()
    return truth, rows


def _posture(arm: ArmDescription, middle: Array, rng: np.random.Generator) -> Array:
    """Return random joint positions around the middle of the ranges."""
    q = middle.copy()
    for index, joint in enumerate(arm.joints[: arm.own_joints]):
        half = min(0.5 * SHARE * (joint.upper - joint.lower), 1.0)
        q[index] += rng.uniform(-half, half)
    return q


def reach(
    arm: ArmDescription, q: Array, goal: Array, tip: Array | None = None, joints: int | None = None
) -> Array | None:
    """Return the nearest joint positions with a point of the tip at a goal, None beyond the limits.

    Args:
        arm: whose tip reaches
        q: joint positions to begin with, (n_joints,) [rad or m]
        goal: in the arm's reference frame, (3,) [m]
        tip: the point in the tip's frame, (3,) [m]; None: its origin
        joints: so many of the first move; None: all but the jaw
    """
    own = arm.own_joints if joints is None else joints
    point = np.append(np.zeros(3) if tip is None else tip, 1.0)
    for _ in range(STEPS):
        at = (pose(arm.mechanism, q) @ point)[:3]
        if np.linalg.norm(goal - at) < REACHED_M:
            break
        jacobian = jacobian_spatial(arm.mechanism, q)
        # columns give the twist about the reference's origin: the point's own velocity from it
        moves = jacobian[:3] + np.cross(jacobian[3:].T, at).T
        step = np.linalg.lstsq(moves[:, :own], goal - at, rcond=1e-6)[0]
        q = q.copy()
        q[:own] += step * min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
    inside = all(
        joint.lower <= value <= joint.upper
        for joint, value in zip(arm.joints[: arm.own_joints], q, strict=False)
    )
    off = float(np.linalg.norm(goal - (pose(arm.mechanism, q) @ point)[:3]))
    return q if inside and off < 1e-9 else None
