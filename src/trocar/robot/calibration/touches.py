"""Readings of an arm's own joints while its tip touches known points, or its board is seen.

A TOML file names the arms and the points of a block, and a CSV file beside it holds a row for each
touch (arm, point, joint positions) or for each view of a board on the tip (arm, joint positions,
pose of the board in the camera).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.table import read_table
from trocar.errors import TracksError
from trocar.geometry import transform
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.robot.calibration.track_csv import UNIT_TOLERANCE, CsvRows, csv_rows, read_text

Array = NDArray[np.float64]

POSE_COLUMNS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")

#: Readings this far beyond a limit are in other units. Source: our own choice, ten times what
#: joints are off. [rad or m]
BEYOND = 0.2


@dataclass(frozen=True, eq=False)
class TouchReadings:
    """Readings of one arm.

    Attributes:
        arm: its description
        q: joint positions, 0 for a jaw or gripper, (n, n_joints) [rad or m]
        points: the touched points in the block, (n, 3) [m]; None: a board was seen
        names: of the touched points
        boards: T_camera_board of each view, (n, 4, 4); None: points were touched
        lines: of the CSV file
        tip: the touching tip in the arm's tip frame, (3,) [m]; None: unknown
    """

    arm: ArmDescription
    q: Array
    points: Array | None
    names: tuple[str, ...]
    boards: Array | None
    lines: tuple[int, ...]
    tip: Array | None


def read_touches(path: str | Path) -> dict[str, TouchReadings]:
    """Read the readings of all arms, {name of the arm: its own}.

    Raises:
        DescriptionError: the TOML file is broken
        TracksError: the CSV file is, with line, what was got and what is allowed
    """
    table = read_table(Path(path).expanduser())
    table.check_schema(", of touches")
    beside = Path(path).expanduser().parent / table.text("readings")
    rows = table.optional_table("points")
    points: dict[str, Array] = {}
    for name in rows.entries():
        row = rows.table(name)
        points[name] = row.vector("xyz", 3, "length")
        row.done()
    arms: dict[str, tuple[ArmDescription, Array | None]] = {}
    named = table.table("arms")
    for name in named.entries():
        row = named.table(name)
        tip = row.vector("tip", 3, "length") if row.has("tip", "length") else None
        arms[name] = load_arm(row.text("description")), tip
        row.done()
    table.done()
    return _readings(csv_rows(str(beside), read_text(beside)[0]), arms, points)


def _readings(
    rows: CsvRows,
    arms: Mapping[str, tuple[ArmDescription, Array | None]],
    points: Mapping[str, Array],
) -> dict[str, TouchReadings]:
    if len(rows.cells) < 2:
        raise TracksError(rows.file, "has no readings; allowed: a header and a row for each")
    head = [cell.strip() for cell in rows.cells[0]]
    body = rows.part(1)
    if "arm" not in head:
        raise rows.error("has no column arm; allowed: arm, point, and a column for each joint", 0)
    posed = set(POSE_COLUMNS) <= set(head)
    if posed == ("point" in head):
        raise rows.error(
            "needs a column point (touches) or the columns "
            f"{','.join(POSE_COLUMNS)} (views of a board), not both",
            0,
        )
    padded = [cells + [""] * (len(head) - len(cells)) for cells in body.cells]
    owners = [cells[head.index("arm")].strip() for cells in padded]
    for index, owner in enumerate(owners):
        if owner not in arms:
            raise body.error(f"arm: got {owner!r}; allowed: {', '.join(arms)}", index)
    found: dict[str, TouchReadings] = {}
    for name, (arm, tip) in arms.items():
        mine = [i for i, owner in enumerate(owners) if owner == name]
        own = CsvRows(rows.file, [body.lines[i] for i in mine], [padded[i] for i in mine])
        if not mine:
            raise TracksError(rows.file, f"no row of arm {name}; allowed: readings of each arm")
        q = _positions(own, head, arm)
        touched = () if posed else _touched(own, head, points)
        found[name] = TouchReadings(
            arm=arm,
            q=q,
            points=None if posed else np.stack([points[point] for point in touched]),
            names=touched,
            boards=_boards(own, head) if posed else None,
            lines=tuple(own.lines),
            tip=tip,
        )
    return found


def _positions(rows: CsvRows, head: list[str], arm: ArmDescription) -> Array:
    """Return joint positions, (n, n_joints), within or near the limits."""
    needed = [joint.name for joint in arm.joints[: arm.own_joints]]
    missing = [name for name in needed if name not in head]
    if missing:
        raise rows.error(f"columns missing: {', '.join(missing)}; needed: {', '.join(needed)}", 0)
    values = rows.numbers([head.index(name) for name in needed], needed)
    if np.isnan(values).any():
        row, column = np.argwhere(np.isnan(values))[0]
        raise rows.error(f"{needed[column]} is blank; allowed: a position in rad or m", int(row))
    q = np.zeros((len(values), len(arm.joints)))
    q[:, : len(needed)] = values
    for index, joint in enumerate(arm.joints[: arm.own_joints]):
        beyond = (q[:, index] < joint.lower - BEYOND) | (q[:, index] > joint.upper + BEYOND)
        if beyond.any():
            row = int(np.argmax(beyond))
            raise rows.error(
                f"{joint.name}: got {q[row, index]:g}; allowed: {joint.lower:g} to"
                f" {joint.upper:g} (rad, or m of joints that slide)",
                row,
            )
    return q


def _touched(rows: CsvRows, head: list[str], points: Mapping[str, Array]) -> tuple[str, ...]:
    named = tuple(cells[head.index("point")].strip() for cells in rows.cells)
    for index, point in enumerate(named):
        if point not in points:
            raise rows.error(f"point: got {point!r}; allowed: {', '.join(points)}", index)
    return named


def _boards(rows: CsvRows, head: list[str]) -> Array:
    values = rows.numbers([head.index(name) for name in POSE_COLUMNS], POSE_COLUMNS)
    length = np.linalg.norm(values[:, 3:], axis=1)
    wrong = ~(np.abs(length - 1.0) <= UNIT_TOLERANCE) | np.isnan(values).any(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise rows.error(
            f"the board's pose has a blank value or a quaternion of norm {length[row]:.4g};"
            f" allowed: seven numbers, norm 1 within {UNIT_TOLERANCE:g}",
            row,
        )
    turns = matrix_from_quaternion(values[:, 3:] / length[:, None])
    return transform(turns, values[:, :3])
