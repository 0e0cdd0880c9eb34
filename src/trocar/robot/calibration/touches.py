"""Readings of an arm's own joints while its tip touches known points, or its board is seen.

A TOML file names the arms and the points of a block, and a CSV file beside it holds a row for each
touch (arm, point, joint positions) or for each view of a board on the tip (arm, joint positions,
pose of the board in the camera). The joint positions of touches may come from a recording of the
arms: a row then has the time of its touch in their place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.table import read_table
from trocar.errors import InputError, LogError, TracksError, UnknownNameError
from trocar.geometry import transform
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.recording import is_recording, open_recording
from trocar.robot.calibration.track_csv import UNIT_TOLERANCE, CsvRows, csv_rows, read_text
from trocar.robot.recordings import ArmMotion, ReadSettings, read_arm_motion
from trocar.robot.recordings.read import arms_in

Array = NDArray[np.float64]

POSE_COLUMNS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")

#: Readings this far beyond a limit are in other units. Source: our own choice, ten times what
#: joints are off. [rad or m]
BEYOND = 0.2

#: Joints of a touch are the mean over this long on either side of its time [s]. Source: our own
#: choice; 20 samples at 100 Hz, shorter than a hand rests.
REST_S = 0.1
#: Joints that range over more than this meanwhile have moved [rad], [m]. Source: our own choice;
#: either moves a tip 0.2 m from the remote centre by 0.2 mm, as precisely as points are touched.
MOVED_RAD, MOVED_M = 1e-3, 2e-4
#: A clock that begins farther from 0 than this counts from a date: times of touches may then be
#: seconds since the first sample, too [s]. Source: our own choice; no session lasts three years.
DATE_S = 1e8
#: Step at which trocar's own recordings are read [s]. Source: our own choice, 200 Hz.
OWN_STEP_S = 0.005


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
        understood: what was read of a recording, in words; "" without one
    """

    arm: ArmDescription
    q: Array
    points: Array | None
    names: tuple[str, ...]
    boards: Array | None
    lines: tuple[int, ...]
    tip: Array | None
    understood: str = ""


def read_touches(
    path: str | Path, recording: str | Path | None = None, how: ReadSettings | None = None
) -> dict[str, TouchReadings]:
    """Read the readings of all arms, {name of the arm: its own}.

    Args:
        path: of the TOML file
        recording: of all arms while they touched, of any kind that `read_arm_motion` reads or
            trocar's own; the CSV file has times of touches in place of joint positions
        how: how to read the recording; `of`, `topic` and `jaw` are for a single arm

    Raises:
        DescriptionError: the TOML file is broken
        TracksError: the CSV file is, with line, what was got and what is allowed
        LogError: the recording cannot be read, or lacks an arm
        InputError: settings that do not apply
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
    rows = csv_rows(str(beside), read_text(beside)[0])
    if recording is None:
        return _readings(rows, arms, points, None)
    names = {name: arm for name, (arm, _) in arms.items()}
    return _readings(rows, arms, points, _motions(recording, names, how or ReadSettings()))


def _readings(
    rows: CsvRows,
    arms: Mapping[str, tuple[ArmDescription, Array | None]],
    points: Mapping[str, Array],
    motions: Mapping[str, ArmMotion] | None,
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
    if posed and motions is not None:
        raise rows.error("has views of a board; allowed with a recording: arm, point, time", 0)
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
        motion = motions[name] if motions is not None else None
        q = _positions(own, head, arm) if motion is None else _rests(own, head, arm, name, motion)
        touched = () if posed else _touched(own, head, points)
        found[name] = TouchReadings(
            arm=arm,
            q=q,
            points=None if posed else np.stack([points[point] for point in touched]),
            names=touched,
            boards=_boards(own, head) if posed else None,
            lines=tuple(own.lines),
            tip=tip,
            understood=motion.understood() if motion is not None else "",
        )
    return found


def _positions(rows: CsvRows, head: list[str], arm: ArmDescription) -> Array:
    """Return joint positions, (n, n_joints), within or near the limits."""
    needed = [joint.name for joint in arm.joints[: arm.own_joints]]
    missing = [name for name in needed if name not in head]
    if missing:
        timed = " (times of touches need a recording, --from FILE)" if "time" in head else ""
        raise rows.error(
            f"columns missing: {', '.join(missing)}; needed: {', '.join(needed)}{timed}", 0
        )
    values = rows.numbers([head.index(name) for name in needed], needed)
    if np.isnan(values).any():
        row, column = np.argwhere(np.isnan(values))[0]
        raise rows.error(f"{needed[column]} is blank; allowed: a position in rad or m", int(row))
    return _within_limits(rows, arm, values)


def _within_limits(rows: CsvRows, arm: ArmDescription, values: Array) -> Array:
    """Return positions of all joints, (n, n_joints), of those of its own, (n, own_joints)."""
    q = np.zeros((len(values), len(arm.joints)))
    q[:, : arm.own_joints] = values
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


def _rests(
    rows: CsvRows, head: list[str], arm: ArmDescription, name: str, motion: ArmMotion
) -> Array:
    """Return the joint positions in which an arm rested at the times of its touches, (n, n_joints).

    Args:
        rows, head: of the arm
        arm, name: the arm
        motion: its own, as `_motions` has it
    """
    joints = arm.joints[: arm.own_joints]
    if typed := [joint.name for joint in joints if joint.name in head]:
        raise rows.error(f"has a column {typed[0]}; allowed with a recording: arm, point, time", 0)
    if "time" not in head:
        raise rows.error("has no column time; allowed with a recording: arm, point, time", 0)
    given = rows.numbers([head.index("time")], ["time"])[:, 0]
    if np.isnan(given).any():
        raise rows.error("time is blank; allowed: seconds", int(np.argmax(np.isnan(given))))
    since_start = (abs(motion.clock) > DATE_S) & (np.abs(given) < DATE_S)
    times = given - np.where(since_start, 0.0, motion.clock)
    columns = [motion.joints.index(joint.name) for joint in joints]
    most = np.array([MOVED_M if joint.kind == "prismatic" else MOVED_RAD for joint in joints])
    found = np.zeros((len(times), len(joints)))
    for row, time in enumerate(times):
        what = f"{name} at {given[row]:.12g} s"
        first, last = motion.times.min(), motion.times.max()
        if not first <= time <= last:
            shift = given[row] - time
            raise rows.error(
                f"{what}: outside {motion.file}; allowed: {first + shift:.12g} to"
                f" {last + shift:.12g} s",
                row,
            )
        near = motion.rows[np.abs(motion.times - time) <= REST_S, 0][:, columns]
        if len(near) < 2:
            raise rows.error(
                f"{what}: {motion.file} has {len(near)} samples within {REST_S:g} s of it; allowed:"
                " 2 or more",
                row,
            )
        moved = np.ptp(near, axis=0)
        if (moved > most).any():
            worst = int(np.argmax(moved / most))
            unit = "m" if joints[worst].kind == "prismatic" else "rad"
            raise rows.error(
                f"{what}: {joints[worst].name} moved by {moved[worst]:.3g} {unit} within"
                f" {REST_S:g} s of it; allowed: {most[worst]:g} {unit}",
                row,
            )
        found[row] = near.mean(axis=0)
    return _within_limits(rows, arm, found)


def _motions(
    recording: str | Path, arms: Mapping[str, ArmDescription], how: ReadSettings
) -> dict[str, ArmMotion]:
    """Read the motion of every arm, {name: motion}, times since the first sample of all arms.

    Raises:
        LogError, InputError: as for `read_touches`
    """
    single = how.of or how.topic or how.jaw
    if len(arms) > 1 and single:
        raise InputError(
            f"{single}: got it for {len(arms)} arms; allowed: --of, --topic and --jaw with one arm"
        )
    read = _own_motion if is_recording(recording) else _arm_motion
    found = {name: read(recording, name, arm, how, len(arms) == 1) for name, arm in arms.items()}
    begin = min(motion.clock + float(motion.times.min()) for motion in found.values())
    return {
        name: replace(motion, times=motion.times + (motion.clock - begin), clock=begin)
        for name, motion in found.items()
    }


def _arm_motion(
    recording: str | Path, name: str, arm: ArmDescription, how: ReadSettings, alone: bool
) -> ArmMotion:
    """Read the motion of the arm of a name; one that stands alone need not be named in the file."""
    of = how.of
    if of is None and how.topic is None:
        nameless = arms_in(recording, arm, how) == [""]
        if nameless and not alone:
            raise LogError(
                str(recording), f"names no arm; allowed: one of {name}, ..., or one arm alone"
            )
        of = None if nameless else name
    motion = read_arm_motion(recording, arm, replace(how, of=of))
    joints = [joint.name for joint in arm.joints[: arm.own_joints]]
    if missing := [joint for joint in joints if joint not in motion.recorded[0]]:
        raise LogError(motion.file, f"{name}: lacks {', '.join(missing)}; allowed: all joints")
    if motion.timed and how.rate_hz is not None:
        raise InputError(f"{motion.file}: has times; allowed without them only: --rate")
    return motion


def _own_motion(
    recording: str | Path, name: str, arm: ArmDescription, how: ReadSettings, _alone: bool
) -> ArmMotion:
    """Read the motion of the arm of a name in a recording of trocar's own."""
    recorded = open_recording(recording)
    label = how.of or name
    columns = recorded.columns(label)
    if columns is None:
        raise UnknownNameError("arm", label, recorded.arms, recorded.file)
    joints = tuple(joint.name for joint in arm.joints[: arm.own_joints])
    if missing := [joint for joint in joints if joint not in columns.joints]:
        raise LogError(recorded.file, f"{label}: lacks {', '.join(missing)}; allowed: all joints")
    states = recorded.states(columns, max(1, round(OWN_STEP_S / recorded.timestep)))
    order = [columns.joints.index(joint) for joint in joints]
    rows = np.stack([states.position, states.velocity, states.effort], axis=1)[:, :, order]
    every = frozenset(joints)
    numbers = np.arange(1, len(rows) + 1)
    return ArmMotion(
        recorded.file, label, joints, states.time, rows, (every, every, every), numbers
    )


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
